/* Tractions from markers: one linearization, and one step with it. Equations:
   sensing/force/inverse_fem.py. */
#include <stdlib.h>
#include <string.h>

#include "band_cholesky_f64.h"
#include "kernels.h"
#include "spline_fem.h"
#include "small_linalg.h"
#include "splines.h"

#define PRODUCTS 16 /* nonzero splines at a marker */

/* Products of splines at a marker, and their slopes. */
typedef struct { long first; double value[PRODUCTS], by_x[PRODUCTS], by_y[PRODUCTS]; } MarkerBasis;

/* Observation of the membrane by the whitened markers, r rows. The positions come first, three rows
   per marker. With `tilts`, two slopes per marker follow. A row has the weights of the splines'
   values, or those of their slopes by x and y. */
typedef struct { long markers, rows; const double *weights, *tilts; const MarkerBasis *bases; } Observation;

/* Nodes of tractions (jx, jy). `load_x` (nx, jx) and `load_y` (ny, jy) give the generalized forces
   of 1 Pa at each node. `root_x` and `root_y` are the lower triangular roots of the prior's
   correlation along x and y. */
typedef struct { long jx, jy; const double *load_x, *load_y, *root_x, *root_y; } Nodes;

static void locate_markers(const SplineMembrane *s, long markers, const double *material, MarkerBasis *bases) {
    for (long m = 0; m < markers; m++) {
        Local x = splines_at(s->numbers.length_x, s->nx - 1, material[2 * m]);
        Local y = splines_at(s->numbers.length_y, s->ny - 1, material[2 * m + 1]);
        MarkerBasis *basis = bases + m;
        basis->first = x.first * s->ny + y.first;
        for (int k = 0; k < PRODUCTS; k++) {
            int a = k / 4, b = k % 4;
            basis->value[k] = x.value[a] * y.value[b];
            basis->by_x[k] = x.slope[a] * y.value[b], basis->by_y[k] = x.value[a] * y.slope[b];
        }
    }
}

/* Compute row r: its 48 entries, in the order of the returned basis's splines; `place` gives their
   positions in (n, 3). */
static const MarkerBasis *row_of(const Observation *observed, long r, double (*row)[3]) {
    const long positions = 3 * observed->markers, m = r < positions ? r / 3 : (r - positions) / 2;
    const MarkerBasis *basis = observed->bases + m;
    for (int k = 0; k < PRODUCTS; k++)
        for (int i = 0; i < 3; i++) {
            if (r < positions) row[k][i] = observed->weights[3 * r + i] * basis->value[k];
            else {
                const double *by_x = observed->tilts + 3 * (r - positions), *by_y = by_x + 6 * observed->markers;
                row[k][i] = by_x[i] * basis->by_x[k] + by_y[i] * basis->by_y[k];
            }
        }
    return basis;
}

static long place(const SplineMembrane *s, const MarkerBasis *basis, int k) { return 3 * (basis->first + k / 4 * s->ny + k % 4); }

static double predict_row(const SplineMembrane *s, const Observation *observed, long r, const double *x) {
    double row[PRODUCTS][3], sum = 0;
    const MarkerBasis *basis = row_of(observed, r, row);
    for (int k = 0; k < PRODUCTS; k++) {
        const double *at = x + place(s, basis, k);
        sum += row[k][0] * at[0] + row[k][1] * at[1] + row[k][2] * at[2];
    }
    return sum;
}

/* Compute out (p, t) = left (p, q) middle (q, r) right^T (t, r); `half` is workspace for a row
   (t). */
static void sandwich(long p, long q, long r, long t, const double *left, const double *middle, const double *right, double *half,
                     double *out) {
    memset(out, 0, p * t * sizeof *out);
    for (long i = 0; i < q; i++) {
        for (long j = 0; j < t; j++) {
            double sum = 0;
            for (long k = 0; k < r; k++) sum += middle[i * r + k] * right[j * r + k];
            half[j] = sum;
        }
        for (long k = 0; k < p; k++)
            if (left[k * q + i] != 0)
                for (long j = 0; j < t; j++) out[k * t + j] += left[k * q + i] * half[j];
    }
}

/* Compute `sandwich` with left^T (q, p) and right (r, t). */
static void sandwich_transposed(long p, long q, long r, long t, const double *left, const double *middle, const double *right,
                                double *half, double *out) {
    memset(out, 0, p * t * sizeof *out);
    for (long i = 0; i < q; i++) {
        memset(half, 0, t * sizeof *half);
        for (long k = 0; k < r; k++)
            for (long j = 0; j < t; j++) half[j] += middle[i * r + k] * right[k * t + j];
        for (long k = 0; k < p; k++)
            if (left[i * p + k] != 0)
                for (long j = 0; j < t; j++) out[k * t + j] += left[i * p + k] * half[j];
    }
}

/* -- one linearization ------------------------------------------------------------------------- */

/* Map eight motions x (n, 3) to the tractions of the nodes: through the transposed loads and the
   transposed root of the prior's covariance. */
static void half_of(const SplineMembrane *s, const Nodes *nodes, const double *prior, const Lanes *x, Lanes *rows, Lanes *out) {
    const long jx = nodes->jx, jy = nodes->jy, count = jx * jy;
    for (int k = 0; k < 3; k++) {
        memset(out, 0, count * sizeof *out);
        for (long a = 0; a < jx; a++) {
            memset(rows, 0, s->ny * sizeof *rows);
            for (long i = 0; i < s->nx; i++)
                if (nodes->load_x[i * jx + a] != 0)
                    for (long j = 0; j < s->ny; j++) rows[j] += nodes->load_x[i * jx + a] * x[3 * (i * s->ny + j) + k];
            for (long j = 0; j < s->ny; j++)
                for (long b = 0; b < jy; b++)
                    if (nodes->load_y[j * jy + b] != 0) out[a * jy + b] += nodes->load_y[j * jy + b] * rows[j];
        }
        for (long at = 0; at < count; at++) out[at] *= prior[k * count + at];
        /* root_x^T (lower) and root_y (lower): rows behind are no longer needed */
        for (long a = 0; a < jx; a++) {
            memset(rows, 0, jy * sizeof *rows);
            for (long i = a; i < jx; i++)
                for (long b = 0; b < jy; b++) rows[b] += nodes->root_x[i * jx + a] * out[i * jy + b];
            for (long b = 0; b < jy; b++) {
                Lanes sum = nodes->root_y[b * jy + b] * rows[b];
                for (long j = b + 1; j < jy; j++) sum += nodes->root_y[j * jy + b] * rows[j];
                out[a * jy + b] = sum;
            }
        }
        out += count;
    }
}

int64_t inverse_gain(int64_t nx, int64_t ny, const double *numbers, const double *factor, const double *softened, double fraction,
                     int64_t r, int64_t markers, const double *material, const double *weights, const double *tilts, int64_t jx, int64_t jy,
                     const double *load_x, const double *load_y, const double *root_x, const double *root_y, const double *prior,
                     const double *bulge, double *half, double *bulge_seen) {
    if (!has_enough_splines(nx, ny) || r != (tilts ? 5 : 3) * markers) return REFUSED;
    SplineMembrane s = membrane_of(nx, ny, numbers);
    Nodes nodes = {jx, jy, load_x, load_y, root_x, root_y};
    const long dofs = 3 * s.n, nodal = 3 * jx * jy, longer = s.ny > jy ? s.ny : jy;
    MarkerBasis *bases = malloc((markers + 1) * sizeof *bases);
    double *motion = malloc(dofs * sizeof *motion);
    Lanes *x = malloc((dofs + longer + nodal) * sizeof *x), *rows = x + dofs, *out = rows + longer;
    int failed = bases && motion && x ? 0 : NO_MEMORY;
    Observation observed = {markers, r, weights, tilts, bases};
    if (!failed) locate_markers(&s, markers, material, bases), interleave_components(&s, bulge, motion);
    for (long first = 0; first < observed.rows && !failed; first += LANES) {
        long lanes = observed.rows - first < LANES ? observed.rows - first : LANES;
        Lanes along = {0};
        memset(x, 0, dofs * sizeof *x);
        for (long l = 0; l < lanes; l++) {
            double row[PRODUCTS][3];
            const MarkerBasis *basis = row_of(&observed, first + l, row);
            for (int k = 0; k < PRODUCTS; k++)
                for (int i = 0; i < 3; i++) x[place(&s, basis, k) + i][l] = row[k][i];
            bulge_seen[first + l] = predict_row(&s, &observed, first + l, motion);
            along[l] = fraction * predict_row(&s, &observed, first + l, softened);
        }
        band_solve_lanes(dofs, s.width, factor, x, 0);
        for (long i = 0; i < dofs; i++) x[i] -= softened[i] * along;
        half_of(&s, &nodes, prior, x, rows, out);
        for (long l = 0; l < lanes; l++)
            for (long i = 0; i < nodal; i++) half[(first + l) * nodal + i] = out[i][l];
    }
    free(bases), free(motion), free(x);
    return failed;
}

int64_t solve_lower(int64_t n, int64_t k, const double *factor, double *x) {
    for (int64_t i = 0; i < n; i++) {
        double *row = x + i * k;
        for (int64_t j = 0; j < i; j++)
            for (int64_t c = 0; c < k; c++) row[c] -= factor[i * n + j] * x[j * k + c];
        for (int64_t c = 0; c < k; c++) row[c] /= factor[i * n + i];
    }
    return 0;
}

/* -- one step ---------------------------------------------------------------------------------- */

/* Solve L L^T x = b for x in place of b; L (n, n) by rows. */
static void solve_dense(long n, const double *L, double *x) {
    for (long i = 0; i < n; i++) {
        double sum = x[i];
        for (long j = 0; j < i; j++) sum -= L[i * n + j] * x[j];
        x[i] = sum / L[i * n + i];
    }
    for (long i = n - 1; i >= 0; i--) {
        double value = x[i] /= L[i * n + i];
        for (long j = 0; j < i; j++) x[j] -= L[i * n + j] * value;
    }
}

/* Compute the tractions (3, jx, jy) that displacements x imply: prior covariance times transposed
   loads, P Load^T x. */
static void tractions(const SplineMembrane *s, const Nodes *nodes, const double *prior, const double *x, double *work, double *out) {
    const long jx = nodes->jx, jy = nodes->jy, count = jx * jy;
    double *response = work, *half = response + count, *room = half + count;
    for (int k = 0; k < 3; k++, out += count) {
        sandwich_transposed(jx, s->nx, s->ny, jy, nodes->load_x, x + k * s->n, nodes->load_y, room, response);
        for (long i = 0; i < count; i++) response[i] *= prior[k * count + i];
        sandwich_transposed(jx, jx, jy, jy, nodes->root_x, response, nodes->root_y, room, half);
        sandwich(jx, jx, jy, jy, nodes->root_x, half, nodes->root_y, room, out);
        for (long i = 0; i < count; i++) out[i] *= prior[k * count + i];
    }
}

int64_t inverse_step(int64_t nx, int64_t ny, const double *numbers, const double *factor, const double *softened, double fraction,
                     int64_t r, int64_t markers, const double *material, const double *weights, const double *tilts, int64_t jx, int64_t jy,
                     const double *load_x, const double *load_y, const double *root_x, const double *root_y, const double *prior,
                     const double *innovation, int64_t modes, const double *drift, const double *gas_load, const double *c,
                     const double *residual, const double *data, const double *slopes_off, double *change, double *traction,
                     double *misfit, double *noise, double *drift_found) {
    if (!has_enough_splines(nx, ny) || r != (tilts ? 5 : 3) * markers || (tilts && !slopes_off) || modes < 1) return REFUSED;
    SplineMembrane s = membrane_of(nx, ny, numbers);
    Stiffness K = {factor, softened, fraction};
    Nodes nodes = {jx, jy, load_x, load_y, root_x, root_y};
    const long dofs = 3 * s.n, room = 2 * jx * jy + s.nx + s.ny + jx + jy;
    MarkerBasis *bases = malloc((markers + 1) * sizeof *bases);
    double *relaxed = malloc((3 * dofs + room) * sizeof *relaxed), *x = relaxed + dofs, *parts = x + dofs, *work = parts + dofs;
    Observation observed = {markers, r, weights, tilts, bases};
    if (!bases || !relaxed) {
        free(bases), free(relaxed);
        return NO_MEMORY;
    }
    locate_markers(&s, markers, material, bases);
    /* relative to the state without tractions, c - K^-1 r */
    interleave_components(&s, residual, relaxed), solve_stiffness(&s, &K, relaxed);
    interleave_components(&s, c, x);
    for (long m = 0; m < markers; m++) {
        double off[3] = {data[3 * m], data[3 * m + 1], data[3 * m + 2]};
        for (int k = 0; k < PRODUCTS; k++)
            for (int i = 0; i < 3; i++) {
                long at = place(&s, bases + m, k) + i;
                off[i] -= bases[m].value[k] * (x[at] - relaxed[at]);
            }
        for (int a = 0; a < 3; a++) {
            const double *w = weights + 9 * m + 3 * a;
            misfit[3 * m + a] = w[0] * off[0] + w[1] * off[1] + w[2] * off[2];
        }
    }
    for (long r = 3 * markers; r < observed.rows; r++) misfit[r] = slopes_off[r - 3 * markers] + predict_row(&s, &observed, r, relaxed);
    memcpy(noise, misfit, observed.rows * sizeof *noise);
    solve_dense(observed.rows, innovation, noise); /* remaining noise of the whitened markers */
    memset(x, 0, dofs * sizeof *x), memset(drift_found, 0, modes * sizeof *drift_found);
    for (long r = 0; r < observed.rows; r++) {
        double row[PRODUCTS][3];
        const MarkerBasis *basis = row_of(&observed, r, row);
        for (int k = 0; k < PRODUCTS; k++)
            for (int i = 0; i < 3; i++) x[place(&s, basis, k) + i] += row[k][i] * noise[r];
        for (long i = 0; i < modes; i++) drift_found[i] += drift[modes * r + i] * noise[r];
    }
    solve_stiffness(&s, &K, x), separate_components(&s, x, parts);
    tractions(&s, &nodes, prior, parts, work, traction);
    for (int k = 0; k < 3; k++)
        sandwich(s.nx, jx, jy, s.ny, load_x, traction + k * jx * jy, load_y, work, parts + k * s.n);
    for (long i = 0; i < dofs; i++) parts[i] += drift_found[0] * gas_load[i];
    interleave_components(&s, parts, x), solve_stiffness(&s, &K, x);
    for (long i = 0; i < dofs; i++) x[i] -= relaxed[i];
    separate_components(&s, x, change);
    free(bases), free(relaxed);
    return 0;
}

/* -- results ----------------------------------------------------------------------------------- */

#define WRENCH 6 /* used lanes of a row */

/* Multiply the root of the traction prior by rows (6, 3 J). The rows sum tractions on `areas` at
   `p` (J, 3) to force and torque about the origin. `out` (3 J); `room` (2 count + jx + jy) is
   workspace. */
static void wrench_rows(const Nodes *nodes, const double *prior, const double *p, const double *areas, double *room, Lanes *out) {
    const long jx = nodes->jx, jy = nodes->jy, count = jx * jy;
    double *row = room, *half = row + count;
    for (int a = 0; a < WRENCH; a++)
        for (int k = 0; k < 3; k++) {
            /* axis of the lever arm of force k for torque a - 3; a force is summed directly */
            const int arm = 6 - a - k;
            if (a < 3 ? a != k : a - 3 == k) continue;
            for (long i = 0; i < count; i++)
                row[i] = areas[i] * prior[k * count + i] * (a < 3 ? 1 : (a - 2) % 3 == k ? -p[3 * i + arm] : p[3 * i + arm]);
            sandwich_transposed(jx, jx, jy, jy, nodes->root_x, row, nodes->root_y, half + count, half);
            for (long i = 0; i < count; i++) out[k * count + i][a] = half[i];
        }
}

/* Add `by` times row x to the sum, in four independent chains. */
static void add_product(double by, long n, const double *row, const Lanes *x, Lanes *sum) {
    Lanes a = {0}, b = {0}, c = {0}, d = {0};
    long k = 0;
    for (; k + 3 < n; k += 4) {
        a += row[k] * x[k], b += row[k + 1] * x[k + 1];
        c += row[k + 2] * x[k + 2], d += row[k + 3] * x[k + 3];
    }
    for (; k < n; k++) a += row[k] * x[k];
    *sum += by * (a + b + c + d);
}

/* Compute seen (r) = L^-1 half own, with L (r, r) and half (r, m) by rows. */
static void whiten(long r, long m, const double *half, const Lanes *own, const double *L, Lanes *seen) {
    for (long i = 0; i < r; i++) {
        Lanes sum = {0};
        add_product(1, m, half + i * m, own, &sum), add_product(-1, i, L + i * r, seen, &sum);
        seen[i] = sum / L[i * r + i];
    }
}

int64_t wrench_posterior(int64_t r, int64_t jx, int64_t jy, const double *root_x, const double *root_y, const double *prior,
                         const double *positions, const double *areas, const double *half, const double *innovation,
                         double *cov) {
    const Nodes nodes = {jx, jy, NULL, NULL, root_x, root_y};
    const long nodal = 3 * jx * jy;
    Lanes *own = calloc(nodal + r, sizeof *own), *seen = own + nodal, sum[WRENCH] = {{0}};
    double *room = malloc((2 * jx * jy + jx + jy) * sizeof *room);
    int failed = own && room ? 0 : NO_MEMORY;
    if (!failed) {
        wrench_rows(&nodes, prior, positions, areas, room, own);
        whiten(r, nodal, half, own, innovation, seen);
        for (int a = 0; a < WRENCH; a++) {
            for (long k = 0; k < nodal; k++) sum[a] += own[k][a] * own[k];
            for (long i = 0; i < r; i++) sum[a] -= seen[i][a] * seen[i];
            for (int b = 0; b < WRENCH; b++) cov[WRENCH * a + b] = sum[a][b];
        }
    }
    free(own), free(room);
    return failed;
}
