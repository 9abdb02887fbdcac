/* Marker candidates and the classification of their fits: sensing/image/candidates.py and
   sensing/image/fit_validation.py. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

/* residual, gray levels, that marks a fit without convergence: sensing/image/edge_fit.py */
#define UNSETTLED 1e3

/* Settings in the order of the dataclass MarkerSettings, one number per field. */
typedef struct {
    double profile_min_radius, profile_min_blurs, min_blurs, start_blur_fraction, sure_blurs,
        blur_spread, min_motion, covered_fraction, min_peers, size_log_tolerance, min_edge_distance,
        min_border_axes, min_flawed_axes, max_flawed_misfit, max_border_misfit, border_misfit_fraction,
        border_misfit_fraction_cut, min_contrast, min_contrast_any, max_shape_sd, max_shape_sd_any,
        max_residual, covered_residuals, max_lost_weight, sharper_ratio, max_shape_change, max_move,
        min_fit_axes, shrunk_fraction;
} MarkerSettings;

_Static_assert(sizeof(MarkerSettings) == 29 * sizeof(double), "as in kernels.h");

/* Status codes in the order of STATUSES in sensing/image/fit_validation.py. */
enum { OK, CUT, NOT_ELLIPSE, TOUCHING, LOW_CONTRAST, GLARE, SMALL, MOTION, BLURRED, LONG, NO_FIT, MOVED };

static void axes_of(const double *shape, double *a, double *b) {
    double mean = (shape[0] + shape[2]) / 2, half = hypot((shape[0] - shape[2]) / 2, shape[1]);
    *a = mean + half, *b = mean - half;
}

/* Return the distance of a border point from the ellipse to first order, px. The outline of the
   blob is half a pixel farther out. */
static double distance(double dx, double dy, const double *inverse) {
    double p = inverse[0], q = inverse[1], s = inverse[2], ex = p * dx + q * dy, ey = q * dx + s * dy;
    double mx = p * ex + q * ey, my = q * ex + s * ey, rho2 = ex * ex + ey * ey;
    return fabs((rho2 - sqrt(rho2)) / sqrt(mx * mx + my * my + 1e-18) + 0.5);
}

int64_t border_moments(int64_t n, const int64_t *counts, int64_t all, const int32_t *points, int64_t height, int64_t width, double *centers,
                       double *shapes, double *misfit, int64_t *cut) {
    for (int64_t i = 0; i < n; i++) {
        if (counts[i] < 0 || counts[i] > all) return REFUSED;
        all -= counts[i];
    }
    if (all) return REFUSED;
    for (int64_t i = 0; i < n; points += 2 * counts[i++]) {
        double area = 0, mx = 0, my = 0, mxx = 0, mxy = 0, myy = 0, room = INFINITY, *shape = shapes + 3 * i;
        /* Green's theorem on the polygon through the pixel centers */
        for (int64_t k = 0; k < counts[i]; k++) {
            const int32_t *here = points + 2 * k, *next = k + 1 < counts[i] ? here + 2 : points;
            double x = here[0], y = here[1], x2 = next[0], y2 = next[1], cross = x * y2 - x2 * y, sx = x + x2, sy = y + y2;
            area += cross, mx += cross * sx, my += cross * sy;
            mxx += cross * (sx * sx - x * x2), myy += cross * (sy * sy - y * y2), mxy += cross * (sx * sy + x * y + x2 * y2);
            room = min_of(room, min_of(min_of(x, y), min_of(width - 1 - x, height - 1 - y)));
        }
        area /= 2, mx /= 6, my /= 6, mxx /= 12, mxy /= 24, myy /= 12;
        /* a border one pixel wide has no area; it is not a marker, so any placeholder will do */
        int flat = fabs(area) < 0.5;
        if (flat) area = 1;
        double cx = mx / area, cy = my / area;
        double xx = flat ? 0.01 : mxx / area - cx * cx, xy = flat ? 0 : mxy / area - cx * cy, yy = flat ? 0.01 : myy / area - cy * cy;
        double root = sqrt(max_of(16 * (xx * yy - xy * xy), 0)), scale = 1 / sqrt(max_of(4 * (xx + yy) + 2 * root, 1e-12));
        /* half a pixel more: the polygon runs inside the blob's outline */
        shape[0] = (4 * xx + root) * scale + 0.5, shape[1] = 4 * xy * scale, shape[2] = (4 * yy + root) * scale + 0.5;
        double det = shape[0] * shape[2] - shape[1] * shape[1], inverse[3] = {shape[2] / det, -shape[1] / det, shape[0] / det};
        double farthest = 0;
        for (int64_t k = 0; k < counts[i]; k++)
            farthest = max_of(distance(points[2 * k] - cx, points[2 * k + 1] - cy, inverse), farthest);
        centers[2 * i] = cx, centers[2 * i + 1] = cy, misfit[i] = flat ? INFINITY : farthest, cut[i] = room <= 0;
    }
    return 0;
}

/* Return 1 if a border is far from its own ellipse. A cut border has another limit. */
static int is_misfit(double misfit, int cut, double b, const MarkerSettings *s) {
    return misfit >= s->max_border_misfit + (cut ? s->border_misfit_fraction_cut : s->border_misfit_fraction) * b;
}

int64_t check_borders(int64_t n, const double *shapes, const double *misfit, const int64_t *cut, double min_radius,
                      const double *settings, int64_t *status) {
    MarkerSettings s;
    memcpy(&s, settings, sizeof s);
    double *size = malloc((n + 1) * sizeof *size);
    int64_t fits = 0;
    if (!size) return NO_MEMORY;
    for (int64_t i = 0; i < n; i++) {
        double a, b;
        axes_of(shapes + 3 * i, &a, &b);
        const int misfits = is_misfit(misfit[i], (int)cut[i], b, &s);
        status[i] = b < min_radius ? SMALL : b <= s.min_border_axes * a ? LONG : misfits ? NOT_ELLIPSE : OK;
        if (status[i] == OK) size[fits++] = sqrt(a * b);
    }
    if (fits >= s.min_peers) {
        /* a border as large as the others but with another outline is a marker with glare or dirt,
           to be flagged */
        double usual = upper_median(size, fits);
        for (int64_t i = 0; i < n; i++) {
            double a, b, own;
            axes_of(shapes + 3 * i, &a, &b);
            own = sqrt(a * b);
            if (fabs(log(own / usual)) < s.size_log_tolerance && b > s.min_flawed_axes * a && misfit[i] < s.max_flawed_misfit * own) status[i] = OK;
        }
    }
    free(size);
    return 0;
}

/* One fit and the candidate from which it started. */
typedef struct {
    const double *center, *shape, *cov, *start, *start_shape;
    double a, b, contrast, noise, shape_sd, residual, blur, lost, motion, misfit;
    int cut;
} Fit;

static Fit fit_of(int64_t i, int64_t n, const double *centers, const double *shapes, const double *cov, const double *levels,
                  const double *found, const double *starts, const double *start_shapes, const double *misfit, const int64_t *cut,
                  double sign) {
    const double *c = cov + 25 * i;
    Fit f = {.center = centers + 2 * i, .shape = shapes + 3 * i, .cov = c, .start = starts + 2 * i,
             .start_shape = start_shapes + 3 * i, .contrast = sign * (levels[n + i] - levels[i]), .blur = found[i],
             .residual = found[n + i], .lost = found[3 * n + i], .motion = found[4 * n + i], .misfit = misfit[i],
             .cut = (int)cut[i]};
    axes_of(f.shape, &f.a, &f.b);
    f.noise = f.residual < 1e-3 ? 1e-3 : f.residual;
    f.shape_sd = sqrt(c[12] + c[18] + c[24]) / f.b;
    return f;
}

static int fit_status(const Fit *f, double usual, const MarkerSettings *s) {
    int status = OK;
    if (f->contrast < s->min_contrast * f->noise || f->shape_sd > s->max_shape_sd) status = LOW_CONTRAST;
    if (f->residual > s->max_residual * f->contrast) status = NOT_ELLIPSE;
    int covered = f->residual > max_of(s->covered_fraction * f->contrast, s->covered_residuals * usual) && f->b > s->profile_min_radius;
    if (f->lost > s->max_lost_weight || covered) status = GLARE;
    return f->motion > s->min_motion ? MOTION : status;
}

static int reaches_border(const Fit *f, int64_t height, int64_t width, double close) {
    double u = hypot(f->shape[0], f->shape[1]), v = hypot(f->shape[2], f->shape[1]);
    return f->center[0] - u < close || f->center[1] - v < close || f->center[0] + u > width - 1 - close
           || f->center[1] + v > height - 1 - close;
}

/* Return the status of a fit, given the `common` blur of the image. `keep` is 0 if the fit is
   probably not a marker. */
static int check_fit(const Fit *f, int status, double common, int64_t height, int64_t width, double min_radius,
                 const MarkerSettings *s, int64_t *keep) {
    if (f->b < s->min_blurs * clip(f->blur, common / s->blur_spread, common * s->blur_spread)) status = BLURRED;
    if (f->blur < s->sharper_ratio * common && common > 1 && f->b < s->sure_blurs * common) status = BLURRED;
    double changed = 0, odd_b, odd_a;
    for (int k = 0; k < 3; k++) changed = max_of(fabs(f->shape[k] - f->start_shape[k]), changed);
    if (changed > s->max_border_misfit + s->max_shape_change * f->b) status = NOT_ELLIPSE;
    if (f->b < min_radius) status = SMALL;
    int cut = reaches_border(f, height, width, s->min_edge_distance) || f->cut;
    if (cut) status = CUT;
    axes_of(f->start_shape, &odd_a, &odd_b);
    int odd = is_misfit(f->misfit, f->cut, odd_b, s) && !cut;
    if (odd) status = GLARE;
    double way = hypot(f->center[0] - f->start[0], f->center[1] - f->start[1]);
    int drop = 0;
    if (way > 1 + s->max_move * f->b && !cut && !odd) status = MOVED, drop = 1;
    if (f->contrast < s->min_contrast_any * f->noise) status = LOW_CONTRAST, drop = 1;
    if (f->shape_sd > s->max_shape_sd_any || f->residual >= UNSETTLED) status = NO_FIT, drop = 1;
    if (f->b < s->min_fit_axes * f->a) status = LONG, drop = 1;
    if (f->b < s->shrunk_fraction * min_radius) status = SMALL, drop = 1;
    *keep = !drop;
    return status;
}

/* Return the distance from an ellipse's center to its boundary in the direction (x, y). */
static double reach(const Fit *f, double x, double y) {
    double p = f->shape[0], q = f->shape[1], s = f->shape[2], det = p * s - q * q;
    return det / hypot(s * x - q * y, p * y - q * x);
}

/* Flag ellipses close to the edge of another one, measured along the line of centers. */
static void flag_crowded(const Fit *fits, int64_t n, double close, int64_t *status) {
    for (int64_t i = 0; i < n; i++) {
        if (status[i] != OK && status[i] != TOUCHING) continue;
        for (int64_t j = i + 1; j < n; j++) {
            if (status[j] != OK && status[j] != TOUCHING) continue;
            double x = fits[j].center[0] - fits[i].center[0], y = fits[j].center[1] - fits[i].center[1];
            if (!(x * x + y * y < square(fits[i].a + fits[j].a + close))) continue;
            double length = max_of(hypot(x, y), 1e-9);
            x /= length, y /= length;
            if (length < reach(fits + i, x, y) + reach(fits + j, x, y) + close) status[i] = status[j] = TOUCHING;
        }
    }
}

int64_t check_fits(int64_t n, const double *centers, const double *shapes, const double *cov, const double *levels,
                   const double *found, const double *starts, const double *start_shapes, const double *misfit,
                   const int64_t *cut, double sign, int64_t height, int64_t width, double min_radius, const double *settings,
                   int64_t *status, int64_t *keep) {
    MarkerSettings s;
    memcpy(&s, settings, sizeof s);
    Fit *fits = malloc((n + 1) * sizeof *fits);
    double *some = malloc((n + 1) * sizeof *some);
    if (!fits || !some) {
        free(fits), free(some);
        return NO_MEMORY;
    }
    for (int64_t i = 0; i < n; i++) {
        fits[i] = fit_of(i, n, centers, shapes, cov, levels, found, starts, start_shapes, misfit, cut, sign);
        some[i] = fits[i].residual;
    }
    /* typical residual in this image: noise and compression */
    double usual = n ? upper_median(some, n) : 0;
    int64_t good = 0;
    for (int64_t i = 0; i < n; i++) {
        status[i] = fit_status(fits + i, usual, &s);
        if (status[i] == OK) some[good++] = fits[i].blur;
    }
    /* blur is a property of the image; its scatter is mostly fit error */
    double common = good ? upper_median(some, good) : 0;
    for (int64_t i = 0; i < n; i++)
        status[i] = check_fit(fits + i, (int)status[i], common, height, width, min_radius, &s, keep + i);
    flag_crowded(fits, n, s.min_edge_distance, status);
    free(fits), free(some);
    return 0;
}

void ellipse_axes(int64_t n, const double *shapes, const double *cov, double *semi_axes, double *angles, double *out) {
    for (int64_t i = 0; i < n; i++) {
        const double *shape = shapes + 3 * i;
        double a, b, angle = 0.5 * atan2(2 * shape[1], shape[0] - shape[2]), c = cos(angle), s = sin(angle);
        axes_of(shape, &a, &b);
        /* below, the angle is meaningless; the floor keeps its variance finite */
        double over = 1 / max_of(a - b, 1e-6 * a);
        double J[5][5] = {{1, 0, 0, 0, 0}, {0, 1, 0, 0, 0}, {0, 0, c * c, 2 * c * s, s * s}, {0, 0, s * s, -2 * c * s, c * c},
                          {0, 0, -c * s * over, (c * c - s * s) * over, c * s * over}};
        semi_axes[2 * i] = a, semi_axes[2 * i + 1] = b, angles[i] = angle;
        sandwich5(J, cov + 25 * i, 5, out + 25 * i);
    }
}
