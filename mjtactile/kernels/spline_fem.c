#include "spline_fem.h"

#include <stdlib.h>
#include <string.h>

#include "band_cholesky_f64.h"
#include "kernels.h"
#include "small_linalg.h"
#include "splines.h"

#define GAUSS 2    /* points in each interval */
#define LOCAL 16   /* splines on a cell */
#define MIN_DET 1e-3
/* increment, fraction of the mean diagonal, for an indefinite stiffness (wrinkles); tenfold until
   it is definite */
#define NUDGE 1e-3
_Static_assert(sizeof(SplineNumbers) == 8 * sizeof(double), "as in kernels.h");

typedef struct { double weight; Local at; } Line; /* line of Gauss points along the other axis */

typedef struct { double z, g1[3], g2[3], normal[3]; } Point; /* height, tangents, area vector */

typedef struct { double S11, S22, S12; } Stress;

typedef struct { double D11, D22, D12, D16, D26, D66; } Moduli;

/* Derivatives of the parametric coordinates by position on a non-rectangular opening, and area of
   the opening over area in these coordinates. */
typedef struct { double x_by_X, x_by_Y, y_by_X, y_by_Y, area; } TangentMap;
_Static_assert(sizeof(TangentMap) == 5 * sizeof(double), "as in kernels.h");

/* A deformation at the Gauss points, y fastest. */
typedef struct { long qx, qy; Line *x, *y; Point *points; const TangentMap *turns; } Sampling;

int has_enough_splines(long nx, long ny) { return nx > FEWEST_SPANS && ny > FEWEST_SPANS; }

SplineMembrane membrane_of(long nx, long ny, const double *numbers) {
    SplineMembrane s = {.nx = nx, .ny = ny, .n = nx * ny, .width = SPLINE_BAND_WIDTH(ny)};
    if (numbers) memcpy(&s.numbers, numbers, sizeof s.numbers);
    return s;
}

void interleave_components(const SplineMembrane *s, const double *parts, double *x) {
    for (long i = 0; i < s->n; i++)
        for (int k = 0; k < 3; k++) x[3 * i + k] = parts[k * s->n + i];
}

void separate_components(const SplineMembrane *s, const double *x, double *parts) {
    for (long i = 0; i < s->n; i++)
        for (int k = 0; k < 3; k++) parts[k * s->n + i] = x[3 * i + k];
}

static void make_lines(Line *lines, double length, long spans) {
    double half = length / spans / 2;
    for (long i = 0; i < GAUSS * spans; i++) {
        double middle = (2 * (i / GAUSS) + 1) * half - length / 2;
        lines[i].weight = half;
        lines[i].at = splines_at(length, spans, middle + (i % GAUSS ? half : -half) / sqrt(3));
    }
}

/* Evaluate one component on an x-line: values of the spline across it, and its slopes. */
static void cross_line(const SplineMembrane *s, const Line *line, const double *c, double *value, double *slope) {
    for (long j = 0; j < s->ny; j++) value[j] = slope[j] = 0;
    for (int a = 0; a < 4; a++) {
        const double *row = c + (line->at.first + a) * s->ny;
        for (long j = 0; j < s->ny; j++) value[j] += line->at.value[a] * row[j], slope[j] += line->at.slope[a] * row[j];
    }
}

static void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1], out[1] = a[2] * b[0] - a[0] * b[2], out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Convert tangents by parametric coordinates to tangents by position. */
static void transform_tangents(const TangentMap *t, Point *p) {
    for (int k = 0; k < 3; k++) {
        const double by_x = p->g1[k] - (k == 0), by_y = p->g2[k] - (k == 1);
        p->g1[k] = (k == 0) + t->x_by_X * by_x + t->y_by_X * by_y;
        p->g2[k] = (k == 1) + t->x_by_Y * by_x + t->y_by_Y * by_y;
    }
}

/* Evaluate the deformation `c` (3, n) at the Gauss points. Returns 1 if memory runs out. */
static int sample(const SplineMembrane *s, const double *c, const TangentMap *turns, Sampling *l) {
    l->turns = turns;
    l->qx = GAUSS * (s->nx - 1), l->qy = GAUSS * (s->ny - 1);
    double *value = malloc(6 * s->ny * sizeof *value), *slope = value + 3 * s->ny;
    l->x = malloc((l->qx + l->qy) * sizeof *l->x), l->y = l->x + l->qx;
    l->points = malloc(l->qx * l->qy * sizeof *l->points);
    int failed = !value || !l->x || !l->points;
    if (!failed) {
        make_lines(l->x, s->numbers.length_x, s->nx - 1), make_lines(l->y, s->numbers.length_y, s->ny - 1);
        for (long i = 0; i < l->qx; i++) {
            for (int k = 0; k < 3; k++) cross_line(s, l->x + i, c + k * s->n, value + k * s->ny, slope + k * s->ny);
            for (long j = 0; j < l->qy; j++) {
                const Local *y = &l->y[j].at;
                Point *p = l->points + i * l->qy + j;
                *p = (Point){.g1 = {1}, .g2 = {0, 1}};
                for (int b = 0; b < 4; b++) {
                    for (int k = 0; k < 3; k++) {
                        p->g1[k] += y->value[b] * slope[k * s->ny + y->first + b];
                        p->g2[k] += y->slope[b] * value[k * s->ny + y->first + b];
                    }
                    p->z += y->value[b] * value[2 * s->ny + y->first + b];
                }
                if (turns) transform_tangents(turns + i * l->qy + j, p);
                cross(p->g1, p->g2, p->normal);
            }
        }
    }
    free(value);
    return failed;
}

static void free_sampling(Sampling *l) { free(l->x), free(l->points); }

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Compute the right Cauchy-Green tensor C11, C22, C12 relative to the free membrane. */
static void strain(const SplineMembrane *s, const Point *p, double *C) {
    double by = s->numbers.lambda2;
    C[0] = by * dot(p->g1, p->g1), C[1] = by * dot(p->g2, p->g2), C[2] = by * dot(p->g1, p->g2);
}

/* Return q (row 0) or q' (row 1) of sensing/constitutive_law.py at this strain, from its table;
   constant beyond its ends. */
static double law_at(const SplineMembrane *s, const double *C, int row) {
    const SplineNumbers *o = &s->numbers;
    double at = (log(max_of(C[0] * C[1] - C[2] * C[2], MIN_DET)) - o->table_first) * o->table_per_unit;
    double place = clip(at, 0, (double)s->entries - 1);
    long i = (long)min_of(place, (double)s->entries - 2);
    const double *table = s->law + row * s->entries;
    return table[i] + (place - i) * (table[i + 1] - table[i]);
}

static Stress stress(const SplineMembrane *s, const double *C, double scale) {
    double by = scale * s->numbers.modulus, nu = s->numbers.poisson;
    if (s->numbers.neo_hookean == 0) {
        double E11 = (C[0] - 1) / 2, E22 = (C[1] - 1) / 2;
        return (Stress){by * (E11 + nu * E22), by * (E22 + nu * E11), by * (1 - nu) * C[2] / 2};
    }
    double q = law_at(s, C, 0);
    return (Stress){by * (1 - q * C[1]), by * (1 - q * C[0]), by * q * C[2]};
}

static Moduli moduli(const SplineMembrane *s, const double *C, double scale) {
    double by = scale * s->numbers.lambda2 * s->numbers.modulus, nu = s->numbers.poisson;
    if (s->numbers.neo_hookean == 0) return (Moduli){by, by, nu * by, 0, 0, (1 - nu) / 2 * by};
    double q = 2 * by * law_at(s, C, 0), slope = 2 * by * law_at(s, C, 1), A11 = C[1], A22 = C[0], A12 = -C[2];
    return (Moduli){-slope * A11 * A11, -slope * A22 * A22, -slope * A11 * A22 - q, -slope * A11 * A12, -slope * A22 * A12,
                    q / 2 - slope * A12 * A12};
}

/* Add to `out` (3, n) the integral of `value` times the splines plus `along` times their slopes by
   x. Each (3, ny) holds one x-line, already summed along y. */
static void add_line(const SplineMembrane *s, const Line *line, const double *value, const double *along, double *out) {
    for (int k = 0; k < 3; k++)
        for (int a = 0; a < 4; a++) {
            double *row = out + k * s->n + (line->at.first + a) * s->ny;
            for (long j = 0; j < s->ny; j++) {
                row[j] += line->at.value[a] * value[k * s->ny + j];
                if (along) row[j] += line->at.slope[a] * along[k * s->ny + j];
            }
        }
}

int64_t spline_state(int64_t nx, int64_t ny, const double *numbers, int64_t entries, const double *law_, const double *turns,
                    const double *c, double scale, double *elastic, double *gradient, double *volume) {
    if (!has_enough_splines(nx, ny) || entries < 2) return REFUSED;
    SplineMembrane s = membrane_of(nx, ny, numbers);
    s.law = law_, s.entries = entries;
    Sampling l;
    double sum = 0, *along = malloc(9 * s.ny * sizeof *along), *across = along + 3 * s.ny, *normal = across + 3 * s.ny;
    int failed = sample(&s, c, (const TangentMap *)turns, &l) || !along;
    memset(elastic, 0, 3 * s.n * sizeof *elastic), memset(gradient, 0, 3 * s.n * sizeof *gradient);
    for (long i = 0; i < l.qx && !failed; i++) {
        memset(along, 0, 9 * s.ny * sizeof *along);
        for (long j = 0; j < l.qy; j++) {
            const Point *p = l.points + i * l.qy + j;
            const Local *y = &l.y[j].at;
            double C[3], w = l.x[i].weight * l.y[j].weight;
            const TangentMap *t = l.turns ? l.turns + i * l.qy + j : NULL;
            if (t) w *= t->area;
            strain(&s, p, C);
            Stress S = stress(&s, C, scale);
            sum += w * p->z * p->normal[2];
            for (int k = 0; k < 3; k++) {
                double P1 = w * (S.S11 * p->g1[k] + S.S12 * p->g2[k]), P2 = w * (S.S12 * p->g1[k] + S.S22 * p->g2[k]);
                if (t) {
                    const double X = P1, Y = P2;
                    P1 = X * t->x_by_X + Y * t->x_by_Y, P2 = X * t->y_by_X + Y * t->y_by_Y;
                }
                double *to = along + k * s.ny + y->first;
                for (int b = 0; b < 4; b++) {
                    to[b] += P1 * y->value[b], to[3 * s.ny + b] += P2 * y->slope[b];
                    to[6 * s.ny + b] += w * p->normal[k] * y->value[b];
                }
            }
        }
        add_line(&s, l.x + i, across, along, elastic), add_line(&s, l.x + i, normal, NULL, gradient);
    }
    free(along), free_sampling(&l);
    *volume = sum;
    return failed ? NO_MEMORY : 0;
}

/* Stiffness of one Gauss point: its row (k, i) is d1B_k T1_i + d2B_k T2_i + B_k U_i, by components
   j and splines l. */
typedef double Rows[3][3][LOCAL];

/* Compute dP_a,i / dg_b,j = S_ab d_ij + D_acbd g_c,i g_d,j (Eq. F10), and for the gas d(g1 x g2) =
   du,1 x g2 + g1 x du,2. Component t of the tangents appears at row i and column j, with the sign
   of ijt; t is the remaining index. On a closed frame this is symmetric: the rows of the later
   component have both. */
static void point_rows(const Point *p, const Stress *S, const Moduli *D, double w, double push, const double *B, const double *B1,
                       const double *B2, Rows T1, Rows T2, Rows U) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double one = p->g1[i] * p->g1[j], two = p->g2[i] * p->g2[j];
            double mixed = p->g1[i] * p->g2[j], crossed = p->g2[i] * p->g1[j];
            double sides = D->D16 * one + D->D26 * two, same = i == j, sign = j == (i + 2) % 3 ? push : i == j ? 0 : -push;
            double M11 = w * (D->D11 * one + D->D66 * two + D->D16 * (mixed + crossed) + same * S->S11);
            double M22 = w * (D->D22 * two + D->D66 * one + D->D26 * (mixed + crossed) + same * S->S22);
            double M12 = w * (D->D12 * mixed + D->D66 * crossed + sides + same * S->S12);
            double M21 = w * (D->D12 * crossed + D->D66 * mixed + sides + same * S->S12);
            const int t = (3 - i - j + 3) % 3;
            const double by_1 = sign * p->g2[t], by_2 = -sign * p->g1[t];
            const double later = i > j, earlier = i < j;
            for (int l = 0; l < LOCAL; l++) {
                T1[i][j][l] = M11 * B1[l] + M12 * B2[l] - earlier * by_1 * B[l];
                T2[i][j][l] = M21 * B1[l] + M22 * B2[l] - earlier * by_2 * B[l];
                U[i][j][l] = later * (by_1 * B1[l] + by_2 * B2[l]);
            }
        }
}

/* Add a Gauss point to its cell. Rows are whole vectors: entries above the diagonal are not
   used. */
static void add_point(const Rows T1, const Rows T2, const Rows U, const double *B, const double *B1, const double *B2,
                      double (*cell)[3][LOCAL]) {
    for (int k = 0; k < LOCAL; k++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double *restrict row = cell[3 * k + i][j];
                for (int part = 0; part <= k; part += 4)
                    for (int l = part; l < part + 4; l++) row[l] += B1[k] * T1[i][j][l] + B2[k] * T2[i][j][l] + B[k] * U[i][j][l];
            }
}

/* Adds a cell's lower triangle to the band. */
static void add_cell(const SplineMembrane *s, long first_x, long first_y, double (*cell)[3][LOCAL], double *band) {
    for (int k = 0; k < LOCAL; k++)
        for (int l = 0; l <= k; l++) {
            const long row = 3 * ((first_x + k / 4) * s->ny + first_y + k % 4);
            const long column = 3 * ((first_x + l / 4) * s->ny + first_y + l % 4);
            for (int j = 0; j < 3; j++) {
                double *to = band + (column + j) * BAND_STRIDE(s->width) + row - column - j;
                for (int i = l < k ? 0 : j; i < 3; i++) to[i] += cell[3 * k + i][j][l];
            }
        }
}

/* Assemble the tangent at constant pressure. */
static void assemble(const SplineMembrane *s, const Sampling *l, double scale, double pressure, double *band) {
    memset(band, 0, 3 * s->n * BAND_STRIDE(s->width) * sizeof *band);
    for (long cx = 0; cx < s->nx - 1; cx++)
        for (long cy = 0; cy < s->ny - 1; cy++) {
            double cell[3 * LOCAL][3][LOCAL] = {{{0}}};
            for (int g = 0; g < GAUSS * GAUSS; g++) {
                const Line *x = l->x + GAUSS * cx + g / GAUSS, *y = l->y + GAUSS * cy + g % GAUSS;
                const Point *p = l->points + (x - l->x) * l->qy + (y - l->y);
                double B[LOCAL], B1[LOCAL], B2[LOCAL], C[3], w = x->weight * y->weight;
                Rows T1, T2, U;
                for (int k = 0; k < LOCAL; k++) {
                    int a = k / 4, b = k % 4;
                    B[k] = x->at.value[a] * y->at.value[b];
                    B1[k] = x->at.slope[a] * y->at.value[b], B2[k] = x->at.value[a] * y->at.slope[b];
                }
                if (l->turns) {
                    const TangentMap *t = l->turns + (p - l->points);
                    for (int k = 0; k < LOCAL; k++) {
                        const double by_x = B1[k], by_y = B2[k];
                        B1[k] = t->x_by_X * by_x + t->y_by_X * by_y, B2[k] = t->x_by_Y * by_x + t->y_by_Y * by_y;
                    }
                    w *= t->area;
                }
                strain(s, p, C);
                Stress S = stress(s, C, scale);
                Moduli D = moduli(s, C, scale);
                point_rows(p, &S, &D, w, pressure * w, B, B1, B2, T1, T2, U);
                add_point(T1, T2, U, B, B1, B2, cell);
            }
            add_cell(s, l->x[GAUSS * cx].at.first, l->y[GAUSS * cy].at.first, cell, band);
        }
}

int64_t spline_tangent(int64_t nx, int64_t ny, const double *numbers, int64_t entries, const double *law_, const double *turns,
                      const double *c, double scale, double pressure, double *band) {
    if (!has_enough_splines(nx, ny) || entries < 2) return REFUSED;
    SplineMembrane s = membrane_of(nx, ny, numbers);
    s.law = law_, s.entries = entries;
    Sampling l;
    int failed = sample(&s, c, (const TangentMap *)turns, &l);
    if (!failed) assemble(&s, &l, scale, pressure, band);
    free_sampling(&l);
    return failed ? NO_MEMORY : 0;
}

int64_t factor_definite(int64_t n, int64_t width, double *band) {
    const long stride = BAND_STRIDE(width);
    if (n < 1 || width < 0) return REFUSED;
    double trace = 0, push = 0, *kept = malloc(n * stride * sizeof *kept);
    if (!kept) return NO_MEMORY;
    memcpy(kept, band, n * stride * sizeof *kept);
    for (long i = 0; i < n; i++) trace += band[i * stride];
    int failed = !isfinite(trace);
    while (!failed && band_cholesky(n, width, band)) {
        push = max_of(10 * push, NUDGE * fabs(trace) / n);
        failed = !isfinite(push);
        memcpy(band, kept, n * stride * sizeof *kept);
        for (long i = 0; i < n; i++) band[i * stride] += push;
    }
    free(kept);
    return failed ? NOT_DEFINITE : 0;
}

void solve_stiffness(const SplineMembrane *s, const Stiffness *K, double *x) {
    double along = 0;
    for (long i = 0; i < 3 * s->n; i++) along += K->softened[i] * x[i];
    band_forward(3 * s->n, s->width, K->factor, x), band_backward(3 * s->n, s->width, K->factor, x);
    for (long i = 0; i < 3 * s->n; i++) x[i] -= K->fraction * along * K->softened[i];
}

double soften(int64_t nx, int64_t ny, const double *factor, const double *gradient, double gas_stiffness, double *softened) {
    SplineMembrane s = membrane_of(nx, ny, NULL);
    double along = 0;
    interleave_components(&s, gradient, softened);
    band_forward(3 * s.n, s.width, factor, softened);
    for (long i = 0; i < 3 * s.n; i++) along += softened[i] * softened[i];
    band_backward(3 * s.n, s.width, factor, softened);
    return gas_stiffness / (1 + gas_stiffness * along);
}

int64_t spline_solve(int64_t nx, int64_t ny, const double *factor, const double *softened, double fraction, const double *forces,
                    double *out) {
    SplineMembrane s = membrane_of(nx, ny, NULL);
    Stiffness K = {factor, softened, fraction};
    double *x = malloc(3 * s.n * sizeof *x);
    if (!x) return NO_MEMORY;
    interleave_components(&s, forces, x), solve_stiffness(&s, &K, x), separate_components(&s, x, out);
    free(x);
    return 0;
}
