/* Smoothing spline through markers, and measurements of it. Equations:
   sensing/surface/surface.py. */
#include <stdlib.h>
#include <string.h>

#include "band_cholesky_f64.h"
#include "kernels.h"
#include "small_linalg.h"
#include "splines.h"

#define PRODUCTS 16 /* nonzero splines at a point */

typedef struct { double length_x, length_y, distance, slope_model_sd, slope_sd_max, slope_off, outlier_sd,
                 outlier_min, outliers_leave; } Settings;

_Static_assert(sizeof(Settings) == 9 * sizeof(double), "as in kernels.h");

/* One marker: position, weight 1/sd, product splines at it, and their slopes. */
typedef struct { double p[3], variance, weight; const double *normal; long first; double z[PRODUCTS], z_x[PRODUCTS],
                 z_y[PRODUCTS]; int used; } Marker;

/* Normal equations of n coefficients, nx per row; matrices are bands. */
typedef struct { long nx, ny, n, width, size; const double *prior; double *heights, *factor, *inverse, *right, *c; } System;

static long place(const System *s, const Marker *m, int k) { return m->first + k / 4 * s->nx + k % 4; }

static double dot(const System *s, const Marker *m, const double *row, const double *c) {
    double sum = 0;
    for (int k = 0; k < PRODUCTS; k++) sum += row[k] * c[place(s, m, k)];
    return sum;
}

/* Add w row row^T to the matrix, and w row b to the right-hand side. */
static void add(const System *s, const Marker *m, const double *row, double w, double b, double *matrix) {
    for (int k = 0; k < PRODUCTS; k++) {
        long at = place(s, m, k);
        double *column = matrix + at * BAND_STRIDE(s->width);
        for (int l = k; l < PRODUCTS; l++) column[place(s, m, l) - at] += w * row[k] * row[l];
        s->right[at] += w * row[k] * b;
    }
}

/* Return row^T Z row. */
static double variance_of(const System *s, const Marker *m, const double *row, const double *Z) {
    double sum = 0;
    for (int k = 0; k < PRODUCTS; k++) {
        long at = place(s, m, k);
        const double *column = Z + at * BAND_STRIDE(s->width);
        double half = 0.5 * column[0] * row[k];
        for (int l = k + 1; l < PRODUCTS; l++) half += column[place(s, m, l) - at] * row[l];
        sum += 2 * half * row[k];
    }
    return sum;
}

static int solve(const System *s, const double *matrix) {
    memcpy(s->factor, matrix, s->size * sizeof *matrix);
    if (band_cholesky(s->n, s->width, s->factor)) return NOT_DEFINITE;
    memcpy(s->c, s->right, s->n * sizeof *s->c);
    band_forward(s->n, s->width, s->factor, s->c);
    band_backward(s->n, s->width, s->factor, s->c);
    return 0;
}

/* Fit the heights. Repeat without the worst marker while one is far from the prediction of all
   others. Leave-one-out: residual / (1 - leverage), variance / (1 - leverage); Cook & Weisberg
   1982, 2.2. */
static int fit_heights(const System *s, long n, Marker *markers, const Settings *o) {
    long left = n;
    while (1) {
        memcpy(s->heights, s->prior, s->size * sizeof *s->heights);
        memset(s->right, 0, s->n * sizeof *s->right);
        for (long i = 0; i < n; i++) {
            const Marker *m = markers + i;
            if (m->used) add(s, m, m->z, square(m->weight), m->p[2], s->heights);
        }
        if (solve(s, s->heights)) return NOT_DEFINITE;
        band_inverse(s->n, s->width, s->factor, s->inverse);
        double worst = 1;
        Marker *out = NULL;
        for (long i = 0; i < n; i++) {
            Marker *m = markers + i;
            if (!m->used) continue;
            double rest = max_of(1 - variance_of(s, m, m->z, s->inverse) * square(m->weight), 1e-6);
            /* leave-one-out residual, m */
            double off = fabs(m->p[2] - dot(s, m, m->z, s->c)) / rest;
            double excess = min_of(off / o->outlier_min, off * m->weight * sqrt(rest) / o->outlier_sd);
            if (excess > worst) worst = excess, out = m;
        }
        if (!out || left <= o->outliers_leave * n) return 0;
        out->used = 0, left--;
    }
}

/* Return the standard deviation of a slope as slope_sd_of (sensing/surface/slope_noise.py),
   including that of the model. */
static double slope_sd(const Marker *m, double z_x, double z_y, const Settings *o) {
    double over = 1 / sqrt(1 + z_x * z_x + z_y * z_y), z = m->p[2] + o->distance;
    double far = sqrt(square(m->p[0]) + square(m->p[1]) + z * z);
    double aspect_sd = sqrt(8.0 / 3) * sqrt(m->variance) / far, cosine = (z_x * m->p[0] + z_y * m->p[1] - z) * over / far;
    double sine2 = max_of(1 - cosine * cosine, max_of(aspect_sd, 1e-12));
    return hypot(o->slope_model_sd, aspect_sd / sqrt(sine2) / max_of(over * over, 1e-6));
}

/* Add the slopes that are accurate enough and near the prediction of the heights; return the number
   of their markers. `weights` (n) scale slope residuals by their sd; they are zero for slopes that
   are not used. */
static long add_slopes(const System *s, long n, const Marker *markers, const Settings *o, double *weights, double (*slopes)[2]) {
    long count = 0;
    for (long i = 0; i < n; i++) {
        const Marker *m = markers + i;
        double z_x = dot(s, m, m->z_x, s->c), z_y = dot(s, m, m->z_y, s->c), sd = slope_sd(m, z_x, z_y, o);
        slopes[i][0] = -m->normal[0] / m->normal[2], slopes[i][1] = -m->normal[1] / m->normal[2];
        /* false for NaN: an unknown slope is not used */
        int near = fabs(slopes[i][0] - z_x) < o->slope_off && fabs(slopes[i][1] - z_y) < o->slope_off;
        int use = m->used && sd < o->slope_sd_max && near;
        weights[i] = use ? 1 / sd : 0;
        count += use;
    }
    for (long i = 0; i < n; i++) {
        const Marker *m = markers + i;
        if (weights[i] == 0) continue;
        add(s, m, m->z_x, square(weights[i]), slopes[i][0], s->heights);
        add(s, m, m->z_y, square(weights[i]), slopes[i][1], s->heights);
    }
    return count;
}

static double squares(const System *s, long n, const Marker *markers, const double *weights, double (*slopes)[2]) {
    double sum = 0;
    for (long i = 0; i < n; i++) {
        const Marker *m = markers + i;
        if (m->used) sum += square((dot(s, m, m->z, s->c) - m->p[2]) * m->weight);
        if (weights && weights[i] > 0)
            sum += square((dot(s, m, m->z_x, s->c) - slopes[i][0]) * weights[i])
                   + square((dot(s, m, m->z_y, s->c) - slopes[i][1]) * weights[i]);
    }
    return sum;
}

/* Read the markers that are finite, with their splines; return their number. */
static long read_markers(long n, const double *p, const double *variance, const double *normals, const System *s,
                         const Settings *o, Marker *markers) {
    long count = 0;
    for (long i = 0; i < n; i++) {
        Marker *m = markers + count;
        memcpy(m->p, p + 3 * i, sizeof m->p);
        if (!isfinite(m->p[0]) || !isfinite(m->p[1]) || !isfinite(m->p[2]) || !(variance[i] > 0)) continue;
        Local x = splines_at(o->length_x, s->nx - 1, m->p[0]), y = splines_at(o->length_y, s->ny - 1, m->p[1]);
        m->first = y.first * s->nx + x.first;
        for (int k = 0; k < PRODUCTS; k++) {
            int a = k % 4, b = k / 4;
            m->z[k] = y.value[b] * x.value[a], m->z_x[k] = y.value[b] * x.slope[a], m->z_y[k] = y.slope[b] * x.value[a];
        }
        m->variance = variance[i], m->weight = 1 / sqrt(variance[i]), m->normal = normals ? normals + 3 * i : NULL, m->used = 1;
        count++;
    }
    return count;
}

int64_t fit_surface(int64_t n, const double *p_SM, const double *variance, const double *n_S, int64_t nx, int64_t ny,
                    const double *settings, const double *prior, double *c, double *factor, double *found) {
    if (nx <= FEWEST_SPANS || ny <= FEWEST_SPANS) return REFUSED;
    Settings o;
    memcpy(&o, settings, sizeof o);
    System s = {.nx = nx, .ny = ny, .prior = prior, .factor = factor, .c = c};
    s.n = nx * ny, s.width = SURFACE_WIDTH(nx), s.size = s.n * BAND_STRIDE(s.width);
    double *work = malloc((2 * s.size + s.n + 3 * n) * sizeof *work);
    Marker *markers = malloc((n + 1) * sizeof *markers);
    int failed = work && markers ? 0 : NO_MEMORY;
    if (!failed) {
        s.heights = work, s.inverse = work + s.size, s.right = s.inverse + s.size;
        double *weights = s.right + s.n, (*slopes)[2] = (double (*)[2])(weights + n);
        long good = read_markers(n, p_SM, variance, n_S, &s, &o, markers), used = 0, tilted = 0;
        failed = fit_heights(&s, good, markers, &o);
        if (!failed && n_S) tilted = add_slopes(&s, good, markers, &o, weights, slopes);
        if (!failed && tilted) failed = solve(&s, s.heights);
        for (long i = 0; i < good; i++) used += markers[i].used;
        /* features that the splines cannot follow (the edge of a contact) give residuals larger
           than their noise: Birge 1932 */
        double sum = failed ? 0 : squares(&s, good, markers, tilted ? weights : NULL, slopes);
        found[0] = max_of(1, sum / max_of(used + 2 * tilted, 1)), found[1] = used;
    }
    free(work), free(markers);
    return failed;
}

/* Compute out (m, q) = left (m, k) right (k, q). */
static void multiply(long m, long k, long q, const double *left, const double *right, double *restrict out) {
    memset(out, 0, m * q * sizeof *out);
    for (long i = 0; i < m; i++)
        for (long j = 0; j < k; j++)
            for (long l = 0; l < q; l++) out[i * q + l] += left[i * k + j] * right[j * q + l];
}

/* Compute out (k, q) += left^T (m, k) (values (m, p) right^T (q, p)); `half` (q) is workspace. */
static void add_transposed(long m, long k, long p, long q, const double *left, const double *values, const double *right,
                           double *half, double *restrict out) {
    for (long i = 0; i < m; i++) {
        for (long l = 0; l < q; l++) {
            double sum = 0;
            for (long j = 0; j < p; j++) sum += values[i * p + j] * right[l * p + j];
            half[l] = sum;
        }
        for (long j = 0; j < k; j++)
            if (left[i * k + j] != 0)
                for (long l = 0; l < q; l++) out[j * q + l] += left[i * k + j] * half[l];
    }
}

/* Return x^T (L L^T)^-1 x; overwrites x. */
static double seen_variance(long n, long width, const double *L, double *x) {
    double sum = 0;
    band_forward(n, width, L, x);
    for (long i = 0; i < n; i++) sum += x[i] * x[i];
    return sum;
}

static double trace_of_product(long n, long width, const double *A, const double *B) {
    double sum = 0, diagonal = 0;
    for (long j = 0; j < n; j++) {
        long at = j * BAND_STRIDE(width);
        diagonal += A[at] * B[at];
        for (long i = 1; i <= width; i++) sum += A[at + i] * B[at + i];
    }
    return diagonal + 2 * sum;
}

int64_t measure_surface(int64_t nx, int64_t ny, const double *c, const double *factor, double misfit, int64_t grid_nx,
                        int64_t grid_ny, const double *grid_x, const double *grid_y, int64_t qx, int64_t qy, const double *quad_x,
                        const double *quad_y, const double *weights, const double *volume_c, const double *stiffness, double *z,
                        double *found) {
    const long n = nx * ny, width = SURFACE_WIDTH(nx), points = qx * qy, larger = grid_ny > qy ? grid_ny : qy;
    const double *slope_x = quad_x + nx * qx, *slope_y = quad_y + qy * ny;
    double *half = malloc((larger * nx + 2 * points + n + n * BAND_STRIDE(width)) * sizeof *half);
    if (!half) return NO_MEMORY;
    double *z_x = half + larger * nx, *z_y = z_x + points, *gradient = z_y + points, *inverse = gradient + n;
    double area = 0, volume = 0;
    multiply(grid_ny, ny, nx, grid_y, c, half), multiply(grid_ny, nx, grid_nx, half, grid_x, z);
    multiply(qy, ny, nx, quad_y, c, half), multiply(qy, nx, qx, half, slope_x, z_x);
    multiply(qy, ny, nx, slope_y, c, half), multiply(qy, nx, qx, half, quad_x, z_y);
    for (long i = 0; i < points; i++) {
        double stretch = sqrt(1 + z_x[i] * z_x[i] + z_y[i] * z_y[i]);
        area += weights[i] * stretch;
        z_x[i] *= weights[i] / stretch, z_y[i] *= weights[i] / stretch;
    }
    memset(gradient, 0, n * sizeof *gradient);  /* derivatives of the area by the coefficients */
    add_transposed(qy, ny, qx, nx, quad_y, z_x, slope_x, half, gradient);
    add_transposed(qy, ny, qx, nx, slope_y, z_y, quad_x, half, gradient);
    double area_var = seen_variance(n, width, factor, gradient);
    for (long i = 0; i < n; i++) volume += volume_c[i] * c[i], gradient[i] = volume_c[i];
    double volume_var = seen_variance(n, width, factor, gradient);
    /* noise increases the area of a flat membrane, to second order: E = trace(stiffness covariance)
       / 2 */
    band_inverse(n, width, factor, inverse);
    double rough = trace_of_product(n, width, stiffness, inverse) / 2;
    found[0] = area, found[1] = volume;
    found[2] = sqrt(misfit * (area_var + rough * rough)), found[3] = sqrt(misfit * volume_var);
    free(half);
    return 0;
}
