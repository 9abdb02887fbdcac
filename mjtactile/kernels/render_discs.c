/* Blurred discs and closed curves in an image, for the simulated camera only. Equations: docstrings
   of sim/rendering/renderer.py. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "optics.h"
#include "small_linalg.h"

#define RIM 32          /* points of a circle that are projected through glass and lens */
#define HARMONICS 15    /* harmonics that these points determine */
#define NEGLIGIBLE_PX 1e-6 /* amplitude below which a harmonic is neglected, px */
/* maximum number of nodes of a rim: more than the full length of the largest image needs */
#define MAX_NODES 1e5
#define FAR_PX 1e5      /* distance or size that is outside of every image, px */

/* Contribution of a curve point to the pixels around it, (bins, taps) and (bins, taps + 1): the
   pixel at i - taps / 2 + 1 from the point's whole pixel, for each part of a pixel. `across` is h,
   `down` the increase of its integral from row to row. */
typedef struct { long bins, taps; const float *across, *down; } Brush;

typedef struct { float *pixels; long height, width; } Canvas;

/* Part of the image that a curve can change, and in it the increase of coverage from each row to
   the next. */
typedef struct { long left, top, width, height, room; float *rise; } Patch;

typedef struct { double c[HARMONICS + 1][RIM], s[HARMONICS + 1][RIM]; } Waves;

/* rim points, px, and their bounds */
typedef struct { double x[RIM], y[RIM], x0, x1, y0, y1; } Rim;

typedef struct { double x_cos[HARMONICS + 1], x_sin[HARMONICS + 1], y_cos[HARMONICS + 1], y_sin[HARMONICS + 1];
                 int last; } Series;

/* Return the whole pixel of a position. `bin` is the part of a pixel beyond it, rounded to the
   nearest bin. */
static long split_pixel(double place, long bins, long *bin) {
    long rounded = (long)floor(place * bins + 0.5), pixel = (long)floor((double)rounded / bins);
    *bin = rounded - pixel * bins;
    return pixel;
}

/* Allocate the patch of a curve within these bounds, which may have no pixels. Returns 1 if memory
   runs out. */
static int allocate_patch(Patch *patch, const Canvas *image, const Brush *brush, double x0, double x1, double y0, double y1) {
    double reach = brush->taps / 2 + 2, low_x = floor(x0 - reach), low_y = floor(y0 - reach);
    double high_x = ceil(x1 + reach), high_y = ceil(y1 + reach);
    patch->width = patch->height = 0;
    /* also for NaN */
    if (!(high_x > 0 && high_y > 0 && low_x < image->width && low_y < image->height)) return 0;
    patch->left = (long)max_of(low_x, 0), patch->top = (long)max_of(low_y, 0);
    patch->width = (long)min_of(high_x, image->width) - patch->left;
    patch->height = (long)min_of(high_y, image->height) - patch->top;
    long size = patch->width * patch->height;
    if (size > patch->room) {
        free(patch->rise);
        patch->rise = malloc(size * sizeof *patch->rise);
        patch->room = patch->rise ? size : 0;
        if (!patch->rise) return 1;
    }
    memset(patch->rise, 0, size * sizeof *patch->rise);
    return 0;
}

static inline void dab(float *restrict row, long stride, const float *restrict across, const float *restrict down, long taps,
                       float weight) {
    for (long i = 0; i <= taps; i++, row += stride) {
        float rise = down[i] * weight;
        for (long j = 0; j < taps; j++) row[j] += rise * across[j];
    }
}

/* Add `weight` (dx) at the curve's point x, y. Contributions above the image are added to its first
   row. */
static void add_point(const Patch *patch, const Brush *brush, double x, double y, float weight) {
    long taps = brush->taps, bin_x, bin_y;
    if (!(fabs(x) < FAR_PX && fabs(y) < FAR_PX)) return;
    long u = split_pixel(x, brush->bins, &bin_x) - taps / 2 + 1 - patch->left;
    long v = split_pixel(y, brush->bins, &bin_y) - taps / 2 + 1 - patch->top;
    const float *across = brush->across + bin_x * taps, *down = brush->down + bin_y * (taps + 1);
    if (u >= 0 && v >= 0 && u + taps <= patch->width && v + taps < patch->height) {
        float *first = patch->rise + v * patch->width + u;
        if (taps == 8) dab(first, patch->width, across, down, 8, weight);
        else dab(first, patch->width, across, down, taps, weight);
        return;
    }
    for (long i = 0; i <= taps && v + i < patch->height; i++) {
        float *row = patch->rise + (v + i > 0 ? v + i : 0) * patch->width, rise = down[i] * weight;
        for (long j = u < 0 ? -u : 0; j < taps && u + j < patch->width; j++) row[u + j] += rise * across[j];
    }
}

/* Add the coverage, of either sign, to the image. */
static void accumulate_patch(const Patch *patch, const Canvas *image) {
    for (long v = 0; v < patch->height; v++) {
        const float *restrict rise = patch->rise + v * patch->width;
        float *restrict sum = patch->rise + (v + 1 < patch->height ? v + 1 : v) * patch->width;
        float *restrict pixels = image->pixels + (patch->top + v) * image->width + patch->left;
        for (long u = 0; u < patch->width; u++) pixels[u] += fabsf(rise[u]);
        if (v + 1 < patch->height)
            for (long u = 0; u < patch->width; u++) sum[u] += rise[u];
    }
}

int64_t fill_curve(int64_t count, const double *nodes, const double *weights, int64_t bins, int64_t taps, const float *across,
                   const float *down, int64_t height, int64_t width, float *coverage) {
    Brush brush = {bins, taps, across, down};
    Canvas image = {coverage, height, width};
    Patch patch = {0};
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int64_t k = 0; k < 2 * count; k++)
        low[k % 2] = min_of(nodes[k], low[k % 2]), high[k % 2] = max_of(nodes[k], high[k % 2]);
    if (allocate_patch(&patch, &image, &brush, low[0], high[0], low[1], high[1])) return NO_MEMORY;
    if (patch.height > 0) {
        for (int64_t k = 0; k < count; k++) add_point(&patch, &brush, nodes[2 * k], nodes[2 * k + 1], (float)weights[k]);
        accumulate_patch(&patch, &image);
    }
    free(patch.rise);
    return 0;
}

/* Compute the circle's points, and the waves that give their harmonics. */
static Waves make_waves(void) {
    Waves w;
    for (int m = 0; m <= HARMONICS; m++)
        for (int j = 0; j < RIM; j++) {
            double t = 2 * PI * (m * j % RIM) / RIM;
            w.c[m][j] = cos(t), w.s[m][j] = sin(t);
        }
    return w;
}

/* Project a disc's rim into the image, px. `x0` is NaN if the rim is not completely visible. */
static Rim projected_rim(const Camera *camera, const Waves *w, const double *p, const double *n, double radius) {
    /* tangents as in geometry.tangents */
    double sign = copysign(1, n[2]), h = -1 / (sign + n[2]), mixed = n[0] * n[1] * h;
    double a[3] = {1 + sign * n[0] * n[0] * h, sign * mixed, -sign * n[0]}, b[3] = {mixed, sign + n[1] * n[1] * h, -n[1]};
    Rim rim = {.x0 = INFINITY, .x1 = -INFINITY, .y0 = INFINITY, .y1 = -INFINITY};
    for (int j = 0; j < RIM; j++) {
        double c = radius * w->c[1][j], s = radius * w->s[1][j], uv[2];
        double at[3] = {p[0] + c * a[0] + s * b[0], p[1] + c * a[1] + s * b[1], p[2] + c * a[2] + s * b[2]};
        project(camera, at, uv);
        rim.x[j] = uv[0], rim.y[j] = uv[1];
        rim.x0 = min_of(uv[0], rim.x0), rim.x1 = max_of(uv[0], rim.x1), rim.y0 = min_of(uv[1], rim.y0), rim.y1 = max_of(uv[1], rim.y1);
        if (!isfinite(uv[0]) || !isfinite(uv[1])) return (Rim){.x0 = NAN};
    }
    if (rim.x1 - rim.x0 > FAR_PX || rim.y1 - rim.y0 > FAR_PX) return (Rim){.x0 = NAN};
    return rim;
}

static Series harmonics(const Waves *w, const Rim *rim) {
    Series f = {.last = 1};
    for (int m = 0; m <= HARMONICS && m < f.last + 3; m++) {
        double scale = (m ? 2.0 : 1.0) / RIM;
        for (int j = 0; j < RIM; j++) {
            f.x_cos[m] += w->c[m][j] * rim->x[j], f.x_sin[m] += w->s[m][j] * rim->x[j];
            f.y_cos[m] += w->c[m][j] * rim->y[j], f.y_sin[m] += w->s[m][j] * rim->y[j];
        }
        f.x_cos[m] *= scale, f.x_sin[m] *= scale, f.y_cos[m] *= scale, f.y_sin[m] *= scale;
        if (fabs(f.x_cos[m]) + fabs(f.x_sin[m]) + fabs(f.y_cos[m]) + fabs(f.y_sin[m]) > NEGLIGIBLE_PX && m > 0) f.last = m;
    }
    return f;
}

/* Add the disc's rim by the trapezoidal rule with K nodes. */
static void add_rim(const Patch *patch, const Brush *brush, const Series *f, long K) {
    double c1 = 1, s1 = 0, turn_c = cos(2 * PI / K), turn_s = sin(2 * PI / K), held;
    for (long k = 0; k < K; k++) {
        double x = f->x_cos[0], y = f->y_cos[0], dx = 0, c = 1, s = 0;
        for (int m = 1; m <= f->last; m++) {
            held = c * c1 - s * s1, s = s * c1 + c * s1, c = held;
            x += f->x_cos[m] * c + f->x_sin[m] * s, y += f->y_cos[m] * c + f->y_sin[m] * s;
            dx += m * (f->x_sin[m] * c - f->x_cos[m] * s);
        }
        add_point(patch, brush, x, y, (float)(dx * (2 * PI / K)));
        held = c1 * turn_c - s1 * turn_s, s1 = s1 * turn_c + c1 * turn_s, c1 = held;
    }
}

int64_t render_discs(int64_t n, const double *p_CM, const double *n_C, const double *radii, const double *camera_, double per_px,
                   int64_t bins, int64_t taps, const float *across, const float *down, int64_t height, int64_t width,
                   float *coverage) {
    Brush brush = {bins, taps, across, down};
    Canvas image = {coverage, height, width};
    Patch patch = {0};
    Camera camera;
    Waves waves = make_waves();
    memcpy(&camera, camera_, sizeof camera);
    for (int64_t i = 0; i < n; i++) {
        Rim rim = projected_rim(&camera, &waves, p_CM + 3 * i, n_C + 3 * i, radii[i]);
        /* the patch then holds no memory */
        if (allocate_patch(&patch, &image, &brush, rim.x0, rim.x1, rim.y0, rim.y1)) return NO_MEMORY;
        if (patch.height <= 0) continue;
        Series f = harmonics(&waves, &rim);
        double nodes = max_of(rim.x1 - rim.x0, rim.y1 - rim.y0) * PI * per_px;
        add_rim(&patch, &brush, &f, 8 * (long)ceil(max_of(min_of(nodes, MAX_NODES), 0) / 8) + 16);
        accumulate_patch(&patch, &image);
    }
    free(patch.rise);
    return 0;
}

void shade(int64_t count, double marker, double gain, const float *contrast, const float *light, float *coverage) {
    for (int64_t i = 0; i < count; i++) {
        float bare = 1 - min_float(coverage[i], 1);
        coverage[i] = ((float)marker + contrast[i] * bare) * (light[i] * (float)gain);
    }
}

void expose(int64_t count, const float *gray, const float *noise, double noise_dn, uint8_t *pixels) {
    float scale = (float)noise_dn;
    for (int64_t i = 0; i < count; i++) {
        float level = gray[i] + scale * noise[i];
        level = level > 0 ? min_float(level, 255) : 0;
        pixels[i] = (uint8_t)(int)(level + 0.5f);
    }
}

int64_t bilinear(int64_t rows, int64_t columns, int64_t channels, const double *grid, int64_t count, const double *places,
              double *out) {
    if (rows < 2 || columns < 2) return REFUSED;
    for (int64_t i = 0; i < count; i++) {
        const double u = clip(places[2 * i], 0, columns - 1), v = clip(places[2 * i + 1], 0, rows - 1);
        const int64_t left = (int64_t)min_of(u, columns - 2), top = (int64_t)min_of(v, rows - 2);
        const double right = u - left, down = v - top, *upper = grid + (top * columns + left) * channels;
        const double *lower = upper + columns * channels;
        for (int64_t k = 0; k < channels; k++) {
            const double above = upper[k] * (1 - right) + upper[channels + k] * right;
            const double below = lower[k] * (1 - right) + lower[channels + k] * right;
            out[channels * i + k] = above * (1 - down) + below * down;
        }
    }
    return 0;
}
