/* Ellipses fitted to the pixels along their edges: sensing/image/edge_fit.py has the image model and
   the estimator. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

#define N 10  /* parameters: center, shape, inside, outside, gradient, blur */
#define SHAPE 5  /* the first of them: center and shape */
#define OUTLIER_RMS 4  /* residual, in rms residuals, with half the weight in the fit of gamma */

/* Settings in the order of `_fit_settings` in sensing/image/edge_fit.py. */
typedef struct {
    double small, stride, steps, blur, blur_weight, settled, outlier_residuals, outlier_fraction;
} Settings;

/* Pixels of one marker, and work arrays of the same length: derivatives J (N, `room`), residual and
   weight. */
typedef struct {
    int64_t count, room;
    const float *x, *y, *observed;
    float *J, *residual, *weight;
} Pixels;

/* Parameters of the model, common to all pixels of a marker. */
typedef struct {
    float cu, cv, ip, iq, js, det2, step, outside, gx, gy, sharp, sigma;
} Edge;

static Edge edge_of(const double *t) {
    double det = 1 / (t[2] * t[4] - t[3] * t[3]);
    return (Edge){(float)t[0], (float)t[1], (float)(t[4] * det), (float)(-t[3] * det), (float)(t[2] * det), (float)(det * det),
                  (float)(t[5] - t[6]), (float)t[6], (float)t[7], (float)t[8], (float)(1 / t[9]), (float)t[9]};
}

/* Return exp(x) for -72 <= x <= 0, with an error below 2e-7 relative. */
static inline float exp_of(float x) {
    float t = x * 1.44269504f, whole = (float)(int32_t)(t - 0.5f), f = t - whole, scale;
    int32_t bits = ((int32_t)whole + 127) << 23;
    memcpy(&scale, &bits, sizeof scale);
    float p = 1.5403530e-4f;
    p = p * f + 1.3333558e-3f;
    p = p * f + 9.6181291e-3f;
    p = p * f + 5.5504109e-2f;
    p = p * f + 2.4022651e-1f;
    p = p * f + 6.9314718e-1f;
    return (p * f + 1) * scale;
}

/* Return Phi(-z), and the normal density. Abramowitz & Stegun 26.2.17, error below 8e-8. */
static inline float normal_tail(float z, float *density) {
    float size = min_float(fabsf(z), 12), d = exp_of(-0.5f * size * size) * 0.3989422804f, t = 1 / (1 + 0.2316419f * size);
    float tail = ((((1.330274429f * t - 1.821255978f) * t + 1.781477937f) * t - 0.356563782f) * t + 0.319381530f) * t * d;
    *density = d;
    return 0.5f - copysignf(0.5f - tail, z);
}

/* Add one chord of the blurred disc: its fraction in F, its slope in phi. */
static inline void add_chord(float x, float y, float fx, float fy, float A, float sharp, float fraction, float *F, float *phi) {
    float B = x * fx + y * fy, under = B * B - A * (x * x + y * y - 1), root = sqrtf(max_float(under, 0)), slope, other;
    float near = normal_tail((B - root) / A * sharp, &slope), far = normal_tail((B + root) / A * sharp, &other);
    float hit = under > 0 ? fraction : 0;
    *F += hit * (near - far), *phi += hit * slope;
}

/* Compute the residuals of the model and their derivatives. `small`: blur along the edge is
   integrated by five chords; otherwise the curvature counts to first order. */
static inline __attribute__((always_inline)) void evaluate(const Pixels *p, const Edge *e, int small) {
    const float *restrict xs = p->x, *restrict ys = p->y, *restrict observed = p->observed;
    float *restrict J0 = p->J, *restrict J1 = J0 + p->room, *restrict J2 = J1 + p->room, *restrict J3 = J2 + p->room;
    float *restrict J4 = J3 + p->room, *restrict J5 = J4 + p->room, *restrict J6 = J5 + p->room, *restrict J7 = J6 + p->room;
    float *restrict J8 = J7 + p->room, *restrict J9 = J8 + p->room, *restrict residual = p->residual;
    const Edge m = *e;
    for (int64_t k = 0; k < p->count; k++) {
        float dx = xs[k] - m.cu, dy = ys[k] - m.cv, ex = m.ip * dx + m.iq * dy, ey = m.iq * dx + m.js * dy;
        float mx = m.ip * ex + m.iq * ey, my = m.iq * ex + m.js * ey, B2 = mx * mx + my * my + 1e-12f, inverse = 1 / sqrtf(B2);
        mx *= inverse, my *= inverse;
        float fx = m.ip * mx + m.iq * my, fy = m.iq * mx + m.js * my, A = fx * fx + fy * fy, rho2 = ex * ex + ey * ey;
        float under = B2 - A * (rho2 - 1), n = (rho2 - 1) / (sqrtf(max_float(under, 0)) + B2 * inverse);
        float kappa = m.det2 * inverse * inverse * inverse * rho2 * sqrtf(rho2), F = 0, phi = 0;
        if (small) {
            float gx = m.iq * mx - m.ip * my, gy = m.js * mx - m.iq * my, along = A + 1e-9f;
            float far = 2.8569700f * m.sigma, near = 1.3556262f * m.sigma;
            add_chord(ex, ey, fx, fy, along, m.sharp, 8.0f / 15, &F, &phi);
            add_chord(ex + near * gx, ey + near * gy, fx, fy, along, m.sharp, 0.22207592f, &F, &phi);
            add_chord(ex - near * gx, ey - near * gy, fx, fy, along, m.sharp, 0.22207592f, &F, &phi);
            add_chord(ex + far * gx, ey + far * gy, fx, fy, along, m.sharp, 0.01125741f, &F, &phi);
            add_chord(ex - far * gx, ey - far * gy, fx, fy, along, m.sharp, 0.01125741f, &F, &phi);
        } else F = normal_tail(n * m.sharp + 0.5f * kappa * m.sigma, &phi);
        float light = 1 + m.gx * dx + m.gy * dy, flat = m.outside + m.step * F, slope = light * m.step * phi * m.sharp;
        float a = slope * mx, b = slope * my, ux = ex - n * fx, uy = ey - n * fy;
        J0[k] = a, J1[k] = b, J2[k] = a * ux, J3[k] = a * uy + b * ux, J4[k] = b * uy;
        J5[k] = light * F, J6[k] = light - light * F, J7[k] = flat * dx, J8[k] = flat * dy;
        J9[k] = slope * (n * m.sharp - 0.5f * kappa * m.sigma);
        residual[k] = observed[k] - light * flat;
    }
}

static double sum_of_products(const float *restrict a, const float *restrict b, int64_t count) {
    float sum = 0;
    for (int64_t k = 0; k < count; k++) sum += a[k] * b[k];
    return sum;
}

/* Compute weights 1/(1 + (r/c)^4); see `_robust` in sensing/image/edge_fit.py. */
static void update_weights(const Pixels *p, const double *theta, const Settings *s) {
    double rms = sqrt(sum_of_products(p->residual, p->residual, p->count) / p->count);
    double c = max_of(max_of(s->outlier_residuals * rms, s->outlier_fraction * fabs(theta[5] - theta[6])), 1e-3);
    float over = (float)(1 / c), *restrict weight = p->weight;
    const float *restrict residual = p->residual;
    for (int64_t k = 0; k < p->count; k++) {
        float t = residual[k] * over;
        t *= t, t *= t;
        weight[k] = 1 / (1 + t);
    }
}

/* Compute the normal matrix H and the right side with the prior of the blur. `weighted` is a work
   array. */
static void normal(const Pixels *p, const double *theta, const Settings *s, float *restrict weighted, double H[N][N], double *right) {
    const float *restrict weight = p->weight, *restrict residual = p->residual;
    for (int i = 0; i < N; i++) {
        const float *restrict row = p->J + i * p->room;
        for (int64_t k = 0; k < p->count; k++) weighted[k] = weight[k] * row[k];
        for (int j = i; j < N; j++) H[i][j] = H[j][i] = sum_of_products(weighted, p->J + j * p->room, p->count);
        right[i] = sum_of_products(weighted, residual, p->count);
    }
    if (s->blur_weight == 0) return;
    for (int64_t k = 0; k < p->count; k++) weighted[k] = weight[k] * residual[k];
    double pull = s->blur_weight * sum_of_products(weighted, residual, p->count) / p->count;
    H[N - 1][N - 1] += pull, right[N - 1] += pull * (s->blur - theta[N - 1]);
}

/* Solve H x = right by Gaussian elimination with pivoting; a singular matrix gives NaN. */
static void solve(double H[N][N], const double *right, double *x) {
    double A[N][N + 1];
    for (int i = 0; i < N; i++) {
        memcpy(A[i], H[i], N * sizeof(double));
        A[i][i] = A[i][i] * (1 + 1e-6) + 1e-9, A[i][N] = right[i];
    }
    for (int i = 0; i < N; i++) {
        int best = i;
        for (int j = i + 1; j < N; j++)
            if (fabs(A[j][i]) > fabs(A[best][i])) best = j;
        double over = A[best][i] == 0 ? NAN : 1 / A[best][i];
        for (int k = i; k <= N; k++) {
            double held = A[best][k];
            A[best][k] = A[i][k], A[i][k] = held;
        }
        for (int j = i + 1; j < N; j++) {
            double factor = A[j][i] * over;
            for (int k = i; k <= N; k++) A[j][k] -= factor * A[i][k];
        }
    }
    for (int i = N - 1; i >= 0; i--) {
        double sum = A[i][N];
        for (int k = i + 1; k < N; k++) sum -= A[i][k] * x[k];
        x[i] = sum / A[i][i];
    }
}

/* Take one damped Gauss-Newton step, limited so that a bad start cannot run away. Return the largest
   change of center and shape, px. */
static double take_step(double *theta, double H[N][N], const double *right) {
    double x[N], new[N], size = 0, moved = 0;
    int finite = 1;
    solve(H, right, x);
    for (int i = 0; i < N; i++) {
        new[i] = theta[i] + (i < SHAPE ? clip(x[i], -1.5, 1.5) : x[i]);
        if (i >= 2 && i < SHAPE) size += square(theta[i]);
    }
    new[N - 1] = clip(new[N - 1], 0.3, 8.0);
    for (int i = 0; i < N; i++) finite &= isfinite(new[i]) != 0;
    if (!finite || new[2] * new[4] - square(new[3]) <= 0.04 * size * 0.1 || new[2] <= 0 || new[4] <= 0) return 0;
    for (int i = 0; i < SHAPE; i++) moved = max_of(moved, fabs(new[i] - theta[i]));
    memcpy(theta, new, sizeof new);
    return moved;
}

static double iterate(const Pixels *p, double *theta, const Settings *s, int robust, float *weighted, double H[N][N]) {
    double right[N];
    Edge e = edge_of(theta);
    if (s->small != 0) evaluate(p, &e, 1);
    else evaluate(p, &e, 0);
    if (robust) update_weights(p, theta, s);
    else
        for (int64_t k = 0; k < p->count; k++) p->weight[k] = 1;
    normal(p, theta, s, weighted, H, right);
    return take_step(theta, H, right);
}

/* Return the room for the largest of n `counts`, a multiple of 16; -1 if they do not sum to `all`. */
static int64_t room_for(int64_t n, int64_t all, const int64_t *counts) {
    int64_t longest = 0, left = all;
    for (int64_t i = 0; i < n; i++) {
        if (counts[i] < 1 || counts[i] > left) return -1;
        left -= counts[i];
        if (counts[i] > longest) longest = counts[i];
    }
    return left ? -1 : (longest + 15) / 16 * 16;
}

int64_t fit_edges(int64_t n, int64_t all, const int64_t *counts, const float *x, const float *y, const float *observed,
                  const double *settings, double *thetas, double *normals, double *sums) {
    Settings s;
    int64_t room = room_for(n, all, counts);
    memcpy(&s, settings, sizeof s);
    if (room < 0 || !(s.stride >= 1 && s.stride < 1e9 && s.steps >= 0 && s.steps < 1000)) return REFUSED;
    int64_t stride = (int64_t)s.stride;
    float *work = malloc((16 * room + 16) * sizeof *work);
    if (!work) return NO_MEMORY;
    float *weighted = work + 12 * room, *some = work + 13 * room;
    for (int64_t i = 0; i < n; i++) {
        double(*H)[N] = (double(*)[N])(normals + N * N * i), *theta = thetas + N * i, moved = 0;
        Pixels full = {counts[i], room, x, y, observed, work, work + 10 * room, work + 11 * room}, part = full;
        part.count = (counts[i] + stride - 1) / stride, part.x = some, part.y = some + room, part.observed = some + 2 * room;
        for (int64_t k = 0; k < part.count; k++)
            some[k] = x[k * stride], some[room + k] = y[k * stride], some[2 * room + k] = observed[k * stride];
        for (int k = 0; k < (int)s.steps; k++) {
            moved = iterate(&part, theta, &s, k > 0, weighted, H);
            if (k && moved < s.settled) break;
        }
        for (int k = 0; k < 2; k++) moved = iterate(&full, theta, &s, 1, weighted, H);
        for (int64_t k = 0; k < full.count; k++) weighted[k] = full.weight[k] * full.residual[k];
        double kept = 0, plain = 0;
        for (int64_t k = 0; k < full.count; k++) kept += full.weight[k], plain += weighted[k];
        sums[4 * i] = kept, sums[4 * i + 1] = plain, sums[4 * i + 2] = sum_of_products(weighted, full.residual, full.count);
        sums[4 * i + 3] = moved;
        x += counts[i], y += counts[i], observed += counts[i];
    }
    free(work);
    return 0;
}

/* Camera with E = middle (L / middle)^(1/gamma) between gray level E and light L. Light is relative to
   `middle`, and at least `darkest`. `robust`: outliers get less weight. */
typedef struct {
    double gamma, middle, darkest, robust;
} Curve;

/* Convert the model in light, whose residual is that of a black image, to gray levels. Column N of J
   becomes the derivative by log gamma. */
static void through_curve(const Pixels *p, const double *theta, const Curve *c) {
    float over = (float)(1 / c->gamma), middle = (float)c->middle, darkest = (float)c->darkest;
    float *restrict residual = p->residual, *restrict by_gamma = p->J + N * p->room, *restrict weight = p->weight;
    const float *restrict observed = p->observed;
    for (int64_t k = 0; k < p->count; k++) {
        float light = max_float(-residual[k], darkest), bits = logf(light), level = expf(over * bits);
        weight[k] = middle * over * level / light, by_gamma[k] = -middle * over * level * bits;
        residual[k] = observed[k] - middle * level;
    }
    for (int i = 0; i < N; i++)
        for (int64_t k = 0; k < p->count; k++) p->J[i * p->room + k] *= weight[k];
    for (int i = SHAPE; i < SHAPE + 2; i++) {
        double edge = theta[i] / c->middle, light = pow(edge, c->gamma);
        float by_log = (float)(c->gamma * light * log(edge)), by_level = (float)(c->gamma * light / edge / c->middle);
        float *restrict row = p->J + i * p->room;
        for (int64_t k = 0; k < p->count; k++) by_gamma[k] += by_log * row[k], row[k] *= by_level;
    }
}

/* Sum the normal equations of one marker: matrix H and, in `sums`, the products of the parameters with
   residual and derivative by log gamma, then those of the derivative and the residual with both, the
   sum of the weights; of the squared residual and the weights, the part at the edge. */
static void gamma_sums(const Pixels *p, float *restrict weighted, double H[N][N], double *sums) {
    const float *restrict weight = p->weight, *restrict residual = p->residual, *restrict by_gamma = p->J + N * p->room;
    for (int i = 0; i <= N; i++) {
        const float *restrict row = p->J + i * p->room;
        for (int64_t k = 0; k < p->count; k++) weighted[k] = weight[k] * row[k];
        for (int j = i; j < N; j++) H[i][j] = H[j][i] = sum_of_products(weighted, p->J + j * p->room, p->count);
        double pull = sum_of_products(weighted, residual, p->count), mixed = sum_of_products(weighted, by_gamma, p->count);
        if (i < N) sums[i] = pull, sums[N + i] = mixed;
        else sums[2 * N] = mixed, sums[2 * N + 1] = pull;
    }
    double kept = 0;
    for (int64_t k = 0; k < p->count; k++) weighted[k] = weight[k] * residual[k], kept += weight[k];
    sums[2 * N + 2] = sum_of_products(weighted, residual, p->count), sums[2 * N + 3] = kept;
    const float *restrict by_u = p->J, *restrict by_v = p->J + p->room;
    double squares = 0, weights = 0;
    float steepest = 1e-12f;
    for (int64_t k = 0; k < p->count; k++) {
        float slope = by_u[k] * by_u[k] + by_v[k] * by_v[k];
        squares += slope * weighted[k] * residual[k], weights += slope * weight[k], steepest = max_float(steepest, slope);
    }
    sums[2 * N + 4] = squares / steepest, sums[2 * N + 5] = weights / steepest;
}

int64_t gamma_equations(int64_t n, int64_t all, const int64_t *counts, const float *x, const float *y, const float *observed,
                        const double *curve, const double *thetas, double *normals, double *sums) {
    Curve c;
    int64_t room = room_for(n, all, counts);
    memcpy(&c, curve, sizeof c);
    if (room < 0) return REFUSED;
    float *work = malloc((15 * room + 16) * sizeof *work);
    if (!work) return NO_MEMORY;
    float *black = work + 14 * room;
    memset(black, 0, room * sizeof *black);
    for (int64_t i = 0; i < n; i++) {
        const double *theta = thetas + N * i;
        double linear[N];
        Pixels p = {counts[i], room, x, y, black, work, work + 11 * room, work + 12 * room};
        memcpy(linear, theta, sizeof linear);
        for (int j = SHAPE; j < SHAPE + 2; j++) linear[j] = pow(theta[j] / c.middle, c.gamma);
        Edge e = edge_of(linear);
        evaluate(&p, &e, 1);
        p.observed = observed;
        through_curve(&p, theta, &c);
        double rms = sqrt(sum_of_products(p.residual, p.residual, p.count) / p.count);
        float over = c.robust != 0 ? (float)(1 / (OUTLIER_RMS * rms)) : 0;
        for (int64_t k = 0; k < p.count; k++) {
            float t = p.residual[k] * over;
            t *= t, p.weight[k] = 1 / (1 + t * t);
        }
        gamma_sums(&p, work + 13 * room, (double(*)[N])(normals + N * N * i), sums + (2 * N + 6) * i);
        x += counts[i], y += counts[i], observed += counts[i];
    }
    free(work);
    return 0;
}
