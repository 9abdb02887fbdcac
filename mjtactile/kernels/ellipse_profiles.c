/* Ellipses from profiles across their edges. Equations: docstring of sensing/image/profile_fit.py.

   K profiles cross each ellipse along its normals, with 17 samples each. Six filters evaluate a
   profile: the levels inside and outside, its area, its second moment, and the offset and blur of
   the edge. The last two are matched to a blurred edge. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

#define SAMPLES 17
#define ENDS 5           /* samples at each end, for the levels */
#define COARSE 24        /* profiles per marker in the first rounds */
#define COARSE_STEP 0.9  /* spacing of their samples, px */
#define COARSE_ROUNDS 4
/* change of the shape, px, below which the coarse rounds end; offsets by area are correct within
   2 px */
#define NEAR 1.5
#define PROFILES_MIN 32         /* minimum and (MOST) maximum number of profiles per marker */
#define PROFILES_MAX 160
#define SOFTEN_VARIANCE 0.4
/* variance of linear interpolation, px^2, mean over all positions */
#define BILINEAR_VARIANCE (1.0 / 6)

enum { INSIDE, OUTSIDE, AREA, SECOND, EDGE, BLUR, FILTERS };
#define WHOLE 24         /* samples, rounded up to whole vectors of eight */

typedef float Eight __attribute__((vector_size(32)));  /* all filters of one sample */
typedef float Two __attribute__((vector_size(8)));     /* neighbors in a row */

typedef struct {
    double step, start_blur, spacing, level_outlier, outlier_offsets, outlier_min,
        max_blur_variance, covariance_factor, motion_sd_fraction, sharpest;
} Settings;

_Static_assert(sizeof(Settings) == 10 * sizeof(double), "as in kernels.h");

typedef struct { const float *pixels; long height, width; } Image;

/* Directions (K) on the unit circle. A move of an ellipse is a combination of the functions c, s,
   c^2, 2 c s and s^2 of the direction. */
typedef struct { int count; double c[PROFILES_MAX], s[PROFILES_MAX], c2[PROFILES_MAX], s2[PROFILES_MAX]; } Fan;

typedef struct { double step, bank[FILTERS][SAMPLES], sums[FILTERS], rest_edge, rest_blur; Eight by_sample[SAMPLES]; } Filters;

/* Profiles of one marker: outward normals, |S^-1 e| = g, arc length per profile, and filter
   results. */
typedef struct { double det, mx[PROFILES_MAX], my[PROFILES_MAX], g[PROFILES_MAX], arc[PROFILES_MAX], read[FILTERS][PROFILES_MAX], inside[PROFILES_MAX], outside[PROFILES_MAX],
                 spread_in, spread_out; } Lines;

/* Values of all markers that are kept while the common values are estimated: KEPT rows of K numbers
   each. Whole `Lines` would need a megabyte, whose pages cost more time than the computation. */
enum { KEPT = 7 };

static void kept_rows(Lines *l, double *rows[KEPT]) {
    double *own[KEPT] = {l->mx, l->my, l->g, l->arc, l->inside, l->outside, l->read[EDGE]};
    memcpy(rows, own, sizeof own);
}

static void save_lines(Lines *l, int count, double *kept) {
    double *rows[KEPT];
    kept_rows(l, rows);
    for (int i = 0; i < KEPT; i++) memcpy(kept + i * count, rows[i], count * sizeof(double));
    kept += KEPT * count;
    kept[0] = l->det, kept[1] = l->spread_in, kept[2] = l->spread_out;
}

static void restore_lines(Lines *l, int count, const double *kept) {
    double *rows[KEPT];
    kept_rows(l, rows);
    for (int i = 0; i < KEPT; i++) memcpy(rows[i], kept + i * count, count * sizeof(double));
    kept += KEPT * count;
    l->det = kept[0], l->spread_in = kept[1], l->spread_out = kept[2];
}

static void init_fan(Fan *fan, int count) {
    fan->count = count;
    for (int k = 0; k < count; k++) {
        double t = 2 * PI * k / count;
        fan->c[k] = cos(t), fan->s[k] = sin(t), fan->c2[k] = cos(2 * t), fan->s2[k] = sin(2 * t);
    }
}

/* Make the filters for a sample spacing and a blur, px. EDGE and BLUR measure delta and dsigma in
   F(o) + delta phi + dsigma psi, with F = Phi(-o / sigma), phi = -dF/do and psi = dF/dsigma. One is
   even and the other is odd, so that they are independent. */
static void make_filters(Filters *f, double step, double sigma) {
    double narrow = sqrt(max_of(sigma * sigma - 2 * (SOFTEN_VARIANCE + BILINEAR_VARIANCE), 0.45 * 0.45)), along = 0, across = 0;
    memset(f, 0, sizeof *f);
    f->step = step;
    for (int j = 0; j < SAMPLES; j++) {
        double at = j - (SAMPLES - 1) / 2.0, o = at * step, z = o / sigma;
        double phi = exp(-0.5 * z * z) / sqrt(2 * PI) / sigma;
        f->bank[INSIDE][j] = j < ENDS ? 1.0 / ENDS : 0;
        f->bank[OUTSIDE][j] = j >= SAMPLES - ENDS ? 1.0 / ENDS : 0;
        f->bank[AREA][j] = 1, f->bank[SECOND][j] = at;
        f->bank[EDGE][j] = exp(-0.5 * square(o / narrow));
        f->bank[BLUR][j] = phi * z;
        along += f->bank[EDGE][j] * phi, across += square(phi * z);
    }
    for (int j = 0; j < SAMPLES; j++) {
        double z = (j - (SAMPLES - 1) / 2.0) * step / sigma, filled = 0.5 * erfc(z / sqrt(2));
        f->bank[EDGE][j] /= along, f->bank[BLUR][j] /= across;
        f->rest_edge += f->bank[EDGE][j] * filled, f->rest_blur += f->bank[BLUR][j] * filled;
        for (int i = 0; i < FILTERS; i++) {
            /* avoid denormal floats: they take a hundred cycles each on some processors */
            if (fabs(f->bank[i][j]) < 1e-12) f->bank[i][j] = 0;
            f->sums[i] += f->bank[i][j], f->by_sample[j][i] = (float)f->bank[i][j];
        }
    }
}

/* Return the response of EDGE to a small offset of 1 px if the actual blur is `blur`, px. */
static double edge_response(const Filters *f, double blur) {
    double sum = 0;
    for (int j = 0; j < SAMPLES; j++) sum += f->bank[EDGE][j] * exp(-0.5 * square((j - (SAMPLES - 1) / 2.0) * f->step / blur));
    return sum / (sqrt(2 * PI) * blur);
}

static void outline(Lines *l, const double *shape, const Fan *fan) {
    double p = shape[0], q = shape[1], s = shape[2], det = p * s - q * q, over = 1 / det;
    l->det = det;
    for (int k = 0; k < fan->count; k++) {
        double x = (s * fan->c[k] - q * fan->s[k]) * over, y = (p * fan->s[k] - q * fan->c[k]) * over;
        double g = sqrt(x * x + y * y);
        l->mx[k] = x / g, l->my[k] = y / g, l->g[k] = g, l->arc[k] = g * det * (2 * PI / fan->count);
    }
}

/* Apply the filters to a profile about (u, v) with samples (du, dv) apart, bilinear between the
   pixels. One pass adds each sample, from two pairs of pixels, to the sums of all filters. The sums
   stay in a register: in memory, each addition waits for the previous one. */
static void read_within(const Image *image, double u, double v, double du, double dv, const Filters *f, Eight *out) {
    const double reach = (SAMPLES - 1) / 2.0;
    const int left = (int)(u - fabs(du) * reach), top = (int)(v - fabs(dv) * reach), w = (int)image->width;
    /* float positions relative to this pixel are accurate to 1e-6 px */
    const float *pixels = image->pixels + (long)top * w + left;
    const float x0 = (float)(u - left - reach * du), y0 = (float)(v - top - reach * dv), dx = (float)du, dy = (float)dv;
    int place[WHOLE];
    float across[WHOLE], down[WHOLE];
    for (int j = 0; j < WHOLE; j++) {
        float x = max_float(x0 + j * dx, 0), y = max_float(y0 + j * dy, 0);
        int column = (int)x, row = (int)y;
        place[j] = row * w + column, across[j] = x - column, down[j] = y - row;
    }
    Eight sums = {0};
    for (int j = 0; j < SAMPLES; j++) {
        Two upper, lower;
        memcpy(&upper, pixels + place[j], sizeof upper);
        memcpy(&lower, pixels + place[j] + w, sizeof lower);
        upper += down[j] * (lower - upper);
        sums += (upper[0] + across[j] * (upper[1] - upper[0])) * f->by_sample[j];
    }
    *out = sums;
}

/* Apply the filters to a profile that extends beyond the image border, where border pixels are
   repeated. */
static void filter_at_border(const Image *image, double u, double v, double du, double dv, const Filters *f, Eight *out) {
    const long w = image->width, h = image->height;
    *out = (Eight){0};
    for (int j = 0; j < SAMPLES; j++) {
        double x = u + (j - (SAMPLES - 1) / 2.0) * du, y = v + (j - (SAMPLES - 1) / 2.0) * dv;
        x = x > 0 ? min_of(x, w - 1) : 0, y = y > 0 ? min_of(y, h - 1) : 0;  /* NaN becomes 0 */
        long i = (long)min_of(x, w - 2), k = (long)min_of(y, h - 2);
        const float *at = image->pixels + k * w + i;
        float a = (float)(x - i), b = (float)(y - k), upper = at[0] + a * (at[1] - at[0]);
        *out += (upper + b * (at[w] + a * (at[w + 1] - at[w]) - upper)) * f->by_sample[j];
    }
}

static void read_profiles(Lines *l, const Image *image, const double *center, const double *shape, const Fan *fan,
                          const Filters *f) {
    const double reach = f->step * (SAMPLES - 1) / 2.0;
    /* margin for rounding of positions in single precision */
    const double last_u = image->width - 1.001, last_v = image->height - 1.001;
    for (int k = 0; k < fan->count; k++) {
        double u = center[0] + shape[0] * fan->c[k] + shape[1] * fan->s[k], far_u = fabs(l->mx[k] * reach);
        double v = center[1] + shape[1] * fan->c[k] + shape[2] * fan->s[k], far_v = fabs(l->my[k] * reach);
        Eight sums;
        if (u - far_u >= 0 && u + far_u < last_u && v - far_v >= 0 && v + far_v < last_v)
            read_within(image, u, v, l->mx[k] * f->step, l->my[k] * f->step, f, &sums);
        else
            filter_at_border(image, u, v, l->mx[k] * f->step, l->my[k] * f->step, f, &sums);
        for (int i = 0; i < FILTERS; i++) l->read[i][k] = sums[i];
    }
}

/* Fit one level of the marker plus a light gradient across it, robustly. Returns the standard
   deviation of a profile's level about the fit. */
static double plane(const double *ends, double *fitted, const Fan *fan, double outlier) {
    int K = fan->count;
    double middle = 0, squares = 0, p0 = 0, p1 = 0, p2 = 0, left = 0;
    for (int k = 0; k < K; k++) middle += ends[k];
    middle /= K;
    for (int k = 0; k < K; k++) squares += square(ends[k] - middle);
    double bound = outlier * sqrt(squares / K) + 1e-3;
    for (int k = 0; k < K; k++) {
        double off = clip(ends[k] - middle, -bound, bound);
        p0 += off, p1 += 2 * fan->c[k] * off, p2 += 2 * fan->s[k] * off;
    }
    p0 /= K, p1 /= K, p2 /= K;
    for (int k = 0; k < K; k++) {
        double about = p0 + p1 * fan->c[k] + p2 * fan->s[k];
        fitted[k] = middle + about;
        left += square(clip(ends[k] - middle, -bound, bound) - about);
    }
    return sqrt(left / K);
}

static void fit_levels(Lines *l, const Fan *fan, double outlier) {
    l->spread_in = plane(l->read[INSIDE], l->inside, fan, outlier);
    l->spread_out = plane(l->read[OUTSIDE], l->outside, fan, outlier);
    /* without contrast there is no edge; the caller rejects such fits */
    for (int k = 0; k < fan->count; k++)
        if (fabs(l->inside[k] - l->outside[k]) < 1) l->inside[k] = l->outside[k] - 1;
}

/* Compute the move (w, V) of the ellipse that best fits the offsets `scaled` on the unit circle.
   The harmonics are orthogonal on K even directions. */
static void solve_even(const double *scaled, const Fan *fan, double *move) {
    int K = fan->count;
    double mean = 0, a = 0, b = 0;
    move[0] = move[1] = 0;
    for (int k = 0; k < K; k++) {
        mean += scaled[k], move[0] += 2 * scaled[k] * fan->c[k], move[1] += 2 * scaled[k] * fan->s[k];
        a += 2 * scaled[k] * fan->c2[k], b += 2 * scaled[k] * fan->s2[k];
    }
    mean /= K, a /= K, b /= K, move[0] /= K, move[1] /= K;
    move[2] = mean + a, move[3] = b, move[4] = mean - a;
}

/* Apply a move: center c + S w, and the shape whose square is that of S (I + V). `move` is in units
   of the local radius and limited to 0.4. */
static void apply_move(double *center, double *shape, const double *move) {
    double m[5], p = shape[0], q = shape[1], s = shape[2];
    for (int i = 0; i < 5; i++) m[i] = clip(move[i], -0.4, 0.4);
    double a = 1 + m[2], b = m[3], c = 1 + m[4];
    double A = p * a + q * b, B = p * b + q * c, C = q * a + s * b, D = q * b + s * c;
    double xx = A * A + B * B, xy = A * C + B * D, yy = C * C + D * D;
    double root = sqrt(max_of(xx * yy - xy * xy, 0)), scale = 1 / sqrt(max_of(xx + yy + 2 * root, 1e-12));
    center[0] += p * m[0] + q * m[1], center[1] += q * m[0] + s * m[1];
    shape[0] = (xx + root) * scale, shape[1] = xy * scale, shape[2] = (yy + root) * scale;
}

/* Move the ellipses close to the edges by area, and return the blur of the image, px. The window
   grows until it contains the blurred edge.

   The blur comes from the second moment of the profiles' deviation from a step. The integral of
   (F - [o < 0]) o do is (sigma^2 + d^2) / 2 for F = Phi(-(o - d) / sigma). */
static double converge_centers(const Image *image, long n, double *centers, double *shapes, const Settings *s, Lines *l, Fan *fan,
                               double *work, double *step) {
    const double step_moment = -(SAMPLES * SAMPLES - 1) / 8.0;  /* moment of [o < 0], in samples */
    Filters f;
    double sigma = s->start_blur;
    init_fan(fan, COARSE);
    *step = COARSE_STEP;
    for (int round = 0; round < COARSE_ROUNDS; round++) {
        double farthest = 0;
        make_filters(&f, *step, s->start_blur);
        for (long i = 0; i < n; i++) {
            double *shape = shapes + 3 * i, before[3], scaled[COARSE], move[5], squared = 0;
            memcpy(before, shape, sizeof before);
            outline(l, shape, fan);
            read_profiles(l, image, centers + 2 * i, shape, fan, &f);
            fit_levels(l, fan, s->level_outlier);
            for (int k = 0; k < COARSE; k++) {
                double over = 1 / (l->inside[k] - l->outside[k]);
                double delta = (l->read[AREA][k] - SAMPLES * l->outside[k]) * over - 0.5 * SAMPLES;
                squared += 2 * (l->read[SECOND][k] * over - step_moment) - delta * delta;
                scaled[k] = clip(delta * *step, -3, 3) * l->g[k];
            }
            work[i] = squared / COARSE;
            solve_even(scaled, fan, move);
            apply_move(centers + 2 * i, shape, move);
            for (int j = 0; j < 3; j++) farthest = max_of(fabs(shape[j] - before[j]), farthest);
        }
        /* 1/6: reduction of a smooth step's second moment by sampling, samples squared */
        sigma = sqrt(clip((upper_median(work, n) + 1.0 / 6) * square(*step), 0.75 * 0.75, 16));
        int wide = sigma > 0.27 * *step * SAMPLES / 2;
        if (farthest < NEAR && !wide) break;
        if (wide && *step < 3) *step *= 1.6;
    }
    return sigma;
}

/* Compute the covariance of (u, v, p, q, s) from that of (w, V): dc = S w and S^-1 dS + dS S^-1 = 2
   V. The solution is dS = (det(S) V + S V S) / trace(S). */
static void covariance_of_moves(const double M[5][5], const double *shape, double *cov) {
    double p = shape[0], q = shape[1], s = shape[2], over = 1 / (p + s), det = p * s - q * q;
    double qq = q * q * over, pq = p * q * over, qs = q * s * over;
    double L[5][5] = {{p, q, 0, 0, 0}, {q, s, 0, 0, 0}, {0, 0, (det + p * p) * over, 2 * pq, qq},
                      {0, 0, pq, (det + p * s) * over + qq, qs}, {0, 0, qq, 2 * qs, (det + s * s) * over}};
    sandwich5(L, &M[0][0], 5, cov);
}

/* Return the edge offset at profile k, px, due to a move (w, V). */
static double offset_of(const double *move, const Lines *l, const Fan *fan, int k) {
    double c = fan->c[k], s = fan->s[k];
    return (move[0] * c + move[1] * s + move[2] * c * c + 2 * move[3] * c * s + move[4] * s * s) / l->g[k];
}

/* Common values of the image: the blur tensor, px^2, and the gain and sums of the EDGE filter. The
   sums determine the effect of the levels on the offsets. */
typedef struct { double uu, uv, vv, gain, rest_edge, sum_edge; } Common;

/* Fit one blur tensor B to the image. Motion adds blur in one direction: the variance across an
   edge with normal m is m^T B m. Least squares use every fourth profile, with bounded variances.
   The remainder of each marker is defocus. */
static void blur_tensor(long count, const double *normals, const double *blurs, double bound, Common *common) {
    double N[3][3] = {{1e-9, 0, 0}, {0, 1e-9, 0}, {0, 0, 1e-9}}, r[3] = {0, 0, 0};
    for (long i = 0; i < count; i++) {
        double x = normals[2 * i], y = normals[2 * i + 1], a[3] = {x * x, 2 * x * y, y * y};
        double variance = min_of(square(blurs[i]), bound);
        for (int j = 0; j < 3; j++) {
            r[j] += a[j] * variance;
            for (int k = 0; k < 3; k++) N[j][k] += a[j] * a[k];
        }
    }
    for (int j = 0; j < 3; j++)  /* Gaussian elimination */
        for (int i = j + 1; i < 3; i++) {
            double factor = N[i][j] / N[j][j];
            for (int k = j; k < 3; k++) N[i][k] -= factor * N[j][k];
            r[i] -= factor * r[j];
        }
    common->vv = r[2] / N[2][2];
    common->uv = (r[1] - N[1][2] * common->vv) / N[1][1];
    common->uu = (r[0] - N[0][1] * common->uv - N[0][2] * common->vv) / N[0][0];
}

/* Move the ellipse by robust least squares to the edge offsets `delta` (K), px, along its normals.
   Also compute its covariance.

   An offset moves e on the unit circle by delta g = e . w + e^T V e, with w = S^-1 dc and V =
   sym(S^-1 dS). */
static void solve_ellipse(const Lines *l, const Fan *fan, const Settings *s, const double *delta, const Common *common,
                          double blur_variance, double *center, double *shape, double *cov, double *found, long n) {
    int K = fan->count;
    double scaled[PROFILES_MAX], left[PROFILES_MAX], weight[PROFILES_MAX], move[5], mean = 0, A[5][5] = {{0}}, r[5] = {0}, inverse[5][5];
    for (int k = 0; k < K; k++) scaled[k] = delta[k] * l->g[k];
    solve_even(scaled, fan, move);  /* unweighted: only to find outliers */
    for (int k = 0; k < K; k++) {
        left[k] = delta[k] - offset_of(move, l, fan, k);
        mean += fabs(left[k]);
    }
    double bound = max_of(s->outlier_offsets * mean / K, s->outlier_min);
    for (int k = 0; k < K; k++) {
        double c = fan->c[k], si = fan->s[k], b[5] = {c, si, c * c, 2 * c * si, si * si};
        weight[k] = l->arc[k] / (1 + square(square(left[k] / bound)));
        double w = weight[k] / square(l->g[k]);
        for (int i = 0; i < 5; i++) {
            r[i] += w * scaled[k] * b[i];
            for (int j = 0; j <= i; j++) A[i][j] += w * b[i] * b[j];
        }
    }
    invert_spd5(A, inverse);
    for (int i = 0; i < 5; i++) {
        move[i] = 0;
        for (int j = 0; j < 5; j++) move[i] += inverse[i][j] * r[j];
    }
    double total = 0, squares = 0, arc = 0, size = 0, in = 0, out = 0, over2 = 0, kappa = 0;
    for (int k = 0; k < K; k++) {
        double over = 1 / (l->inside[k] - l->outside[k]), rest = delta[k] - offset_of(move, l, fan, k);
        total += weight[k], squares += weight[k] * rest * rest, arc += l->arc[k], size += l->g[k];
        in += l->inside[k], out += l->outside[k], over2 += over * over;
        kappa = max_of(0.5 / (square(l->det) * l->g[k] * l->g[k] * l->g[k]), kappa);
    }
    apply_move(center, shape, move);
    arc /= K, size /= K, in /= K, out /= K, over2 /= K;
    double motion = hypot((common->uu - common->vv) / 2, common->uv) * kappa;
    /* Profiles have pixels in common. Neighbors at distance d correlate by the autocorrelation of
       softening and interpolation together, which is nearly Gaussian. The factor is the sum over
       all neighbors. */
    double shared = 1, variance = squares / total * (K / (K - 5.0));
    for (int j = 1; j < 5; j++) shared += 2 * exp(-square(arc * j) / (4 * (SOFTEN_VARIANCE + BILINEAR_VARIANCE)));
    variance *= (K - 5) / max_of(K - 5 * shared, 1);
    /* effect of level noise on an offset: d(delta)/d(inside), d(delta)/d(outside), px per unit of
       contrast */
    double gain_in = common->rest_edge, gain_out = common->sum_edge - common->rest_edge;
    double level = (square(gain_in * l->spread_in) + square(gain_out * l->spread_out)) * over2 * shared / K * size * size;
    double motion_variance = square(s->motion_sd_fraction * motion * size);
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++) inverse[i][j] *= s->covariance_factor * variance * shared * arc;
    /* a level error moves all offsets together, V = I g; an error of its gradient moves the center,
       w = g */
    inverse[0][0] += 2 * level, inverse[1][1] += 2 * level;
    inverse[2][2] += level + motion_variance, inverse[4][4] += level + motion_variance, inverse[2][4] += level, inverse[4][2] += level;
    inverse[3][3] += motion_variance;
    covariance_of_moves(inverse, shape, cov);
    double sd = sqrt(max_of(blur_variance, 0.3));
    found[0] = sqrt(max_of(sd * sd - SOFTEN_VARIANCE - BILINEAR_VARIANCE, square(s->sharpest)));
    /* gray levels at the slope of the edge */
    found[n] = sqrt(variance) * fabs(in - out) / (sqrt(2 * PI) * sd);
    found[2 * n] = K, found[3 * n] = 1 - total / (arc * K), found[4 * n] = motion;
}

/* Compute the edge offsets (K), px, of one marker, corrected for blur along the curved edge. The 50
   % level of an edge with curvature kappa is further inward by kappa / 2 times the blur variance
   along its tangent. */
static void offsets(const Lines *l, const Fan *fan, const Filters *f, const Common *common, double defocus, double *delta) {
    for (int k = 0; k < fan->count; k++) {
        double over = 1 / (l->inside[k] - l->outside[k]), x = l->mx[k], y = l->my[k];
        double off = ((l->read[EDGE][k] - f->sums[EDGE] * l->outside[k]) * over - f->rest_edge) / common->gain;
        double along = max_of(common->uu * y * y - common->uv * 2 * x * y + common->vv * x * x + defocus, 0.3);
        delta[k] = clip(off, -2, 2) + along * 0.5 / (square(l->det) * l->g[k] * l->g[k] * l->g[k]);
    }
}

/* Evaluate the profiles of all markers. Every fourth profile also gives its normal and the blur's
   standard deviation across the edge. */
static void sample_edges(const Image *image, long n, const double *centers, const double *shapes, const Settings *s, const Fan *fan,
                 const Filters *f, double sigma, Lines *l, double *kept, double *normals, double *blurs) {
    for (long i = 0; i < n; i++) {
        outline(l, shapes + 3 * i, fan);
        read_profiles(l, image, centers + 2 * i, shapes + 3 * i, fan, f);
        fit_levels(l, fan, s->level_outlier);
        for (int k = 0; k < fan->count; k += 4) {
            double over = 1 / (l->inside[k] - l->outside[k]);
            *blurs++ = max_of((l->read[BLUR][k] - f->sums[BLUR] * l->outside[k]) * over + sigma - f->rest_blur, 0.5);
            *normals++ = l->mx[k], *normals++ = l->my[k];
        }
        save_lines(l, fan->count, kept + i * (KEPT * fan->count + 3));
    }
}

int64_t fit_profiles(const float *image, int64_t height, int64_t width, int64_t n, double *centers, double *shapes,
                     const double *settings, double *cov, double *levels_, double *found) {
    Settings s;
    Fan fan;
    Filters f;
    Common common;
    Image view = {image, height, width};
    memcpy(&s, settings, sizeof s);
    if (height < 2 || width < 2) return REFUSED;
    if (n == 0) return 0;
    Lines lines;
    double *work = malloc(n * sizeof *work);
    if (!work) return NO_MEMORY;
    double step, sigma = converge_centers(&view, n, centers, shapes, &s, &lines, &fan, work, &step);
    for (long i = 0; i < n; i++) {  /* perimeters, accurate to a percent */
        const double *a = shapes + 3 * i;
        work[i] = 2 * PI * sqrt((a[0] * a[0] + a[2] * a[2]) / 2 + a[1] * a[1]);
    }
    double profiles = 8 * ceil(upper_median(work, n) / s.spacing / 8);
    /* NaN also gives LEAST */
    init_fan(&fan, profiles > PROFILES_MIN ? (int)min_of(profiles, PROFILES_MAX) : PROFILES_MIN);
    make_filters(&f, s.step * max_of(1, sigma / s.start_blur), sigma);
    free(work);
    int per = fan.count / 4, size = KEPT * fan.count + 3;
    work = malloc(n * (4 * per + size) * sizeof *work);
    if (!work) return NO_MEMORY;
    double *blurs = work, *normals = work + n * per, *sorted = work + 3 * n * per, *kept = work + 4 * n * per;
    sample_edges(&view, n, centers, shapes, &s, &fan, &f, sigma, &lines, kept, normals, blurs);
    memcpy(sorted, blurs, n * per * sizeof *sorted);
    double middle = upper_median(sorted, n * per), bound = s.max_blur_variance * middle * middle;
    common.rest_edge = f.rest_edge, common.sum_edge = f.sums[EDGE], common.gain = edge_response(&f, middle);
    blur_tensor(n * per, normals, blurs, bound, &common);
    for (long i = 0; i < n; i++) {
        double delta[PROFILES_MAX], variance = 0, shared = 0, in = 0, out = 0;
        restore_lines(&lines, fan.count, kept + i * size);
        for (int k = 0; k < per; k++) {
            double x = normals[2 * (i * per + k)], y = normals[2 * (i * per + k) + 1];
            variance += min_of(square(blurs[i * per + k]), bound);
            shared += common.uu * x * x + common.uv * 2 * x * y + common.vv * y * y;
        }
        offsets(&lines, &fan, &f, &common, (variance - shared) / per, delta);
        solve_ellipse(&lines, &fan, &s, delta, &common, variance / per, centers + 2 * i, shapes + 3 * i, cov + 25 * i, found + i, n);
        for (int k = 0; k < fan.count; k++) in += lines.inside[k], out += lines.outside[k];
        levels_[i] = in / fan.count, levels_[n + i] = out / fan.count;
    }
    free(work);
    return 0;
}
