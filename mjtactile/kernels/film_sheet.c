/* Elastic forces of the sheet on its grid. A cell is seen at its four corners; a corner's tangents are the cell's two edges that
   meet there. Loops along y go over whole lines, so that the compiler makes vectors of them. */
#include "film_sheet.h"

#include <math.h>
#include <string.h>

#include "band.h"
#include "small.h"

#define INLINE static inline __attribute__((always_inline)) /* else loops over them are no vectors */
#define LEAST_DET 1e-2
#define LEAST_TENSION 0.3 /* of the mean of both directions, in the stiffness that steps are made with */

Film film_of(const double *numbers, const double *law) {
    Film film = {.law = law};
    memcpy(&film.numbers, numbers, sizeof film.numbers);
    film.columns = (long)film.numbers.nodes_x, film.rows = (long)film.numbers.nodes_y;
    film.inner_rows = film.rows - 2, film.inner = (film.columns - 2) * film.inner_rows;
    film.count = film.columns * film.rows;
    film.dx = film.numbers.length_x / (film.columns - 1), film.dy = film.numbers.length_y / (film.rows - 1);
    return film;
}

/* Metric against the free sheet, and second Piola-Kirchhoff stress times thickness. `root` is 1 / sqrt(det C). */
typedef struct { double C11, C22, C12, root, S11, S22, S12; } Strained;

INLINE double law_at(const FilmNumbers *o, const double *law, double root) {
    const double t = (root - o->law_middle) * o->law_per_unit;
    double q = law[FILM_LAW - 1];
    for (int k = FILM_LAW - 2; k >= 0; k--) q = q * t + law[k];
    return q;
}

INLINE Strained strained(const FilmNumbers *o, const double *law, const double g1[3], const double g2[3], int neo_hookean) {
    const double l = o->lambda2, M = o->modulus, nu = o->poisson;
    Strained s;
    s.C11 = l * (g1[0] * g1[0] + g1[1] * g1[1] + g1[2] * g1[2]);
    s.C22 = l * (g2[0] * g2[0] + g2[1] * g2[1] + g2[2] * g2[2]);
    s.C12 = l * (g1[0] * g2[0] + g1[1] * g2[1] + g1[2] * g2[2]);
    s.root = 1 / sqrt(most(s.C11 * s.C22 - s.C12 * s.C12, LEAST_DET));
    if (neo_hookean) {
        const double q = law_at(o, law, s.root);
        s.S11 = M * (1 - q * s.C22), s.S22 = M * (1 - q * s.C11), s.S12 = M * q * s.C12;
    } else {
        const double E11 = (s.C11 - 1) / 2, E22 = (s.C22 - 1) / 2;
        s.S11 = M * (E11 + nu * E22), s.S22 = M * (E22 + nu * E11), s.S12 = M * (1 - nu) * s.C12 / 2;
    }
    return s;
}

/* What BLOCK cells give. A cell has edges along x, low and high, and along y, left and right; what belongs to its nodes is in the
   order low left, low right, high left, high right. Cells are counted by their low left nodes, so that loops go over whole fields
   and the compiler makes vectors of them; behind each column's last cell is one that is none, and weighs nothing. */
#define BLOCK 128
enum { LOW_LEFT, LOW_RIGHT, HIGH_LEFT, HIGH_RIGHT };
typedef struct {
    double force[3][4][BLOCK], volume[3][4][BLOCK];                      /* on its nodes, of elastic forces and of the volume */
    double own[4][BLOCK], right[2][BLOCK], up[2][BLOCK], across[2][BLOCK]; /* stiffness: nodes, edges, diagonals rising and falling */
    double weight[BLOCK], tension[BLOCK], area[BLOCK], bulge[BLOCK], turn[BLOCK];
} Cells;

/* One corner: its stress times weight, and what it adds to sums and stiffness. */
typedef struct { double S11, S22, S12, xx, yy, xy, turn, tension, area; } Corner;

INLINE Corner see_corner(const FilmNumbers *o, const double *law, const double g1[3], const double g2[3], double weight, double over_x,
                         double over_y, int neo_hookean, int stiffness) {
    const Strained s = strained(o, law, g1, g2, neo_hookean);
    Corner c = {.S11 = weight * s.S11, .S22 = weight * s.S22, .S12 = weight * s.S12, .turn = g1[0] * g2[1] - g1[1] * g2[0]};
    c.tension = weight * (s.S11 * s.C11 + s.S22 * s.C22 + 2 * s.S12 * s.C12) * s.root / 2;
    c.area = weight / s.root;
    if (stiffness) {
        const double least_tension = LEAST_TENSION * most(c.tension, 0), by = 1 / (1 + g1[2] * g1[2] + g2[2] * g2[2]);
        c.xx = by * most(c.S11, least_tension) * over_x * over_x, c.yy = by * most(c.S22, least_tension) * over_y * over_y;
        c.xy = by * c.S12 * over_x * over_y;
    }
    return c;
}

INLINE void see_cells(const Film *film, const double *restrict x, long cells, int neo_hookean, int stiffness, Cells *restrict out) {
    const Film f = *film; /* what is written might be part of it, for all that a compiler knows */
    const long rows = f.rows;
    double law[FILM_LAW];
    memcpy(law, film->law, sizeof law);
    const double over_x = 1 / f.dx, over_y = 1 / f.dy;
    const double *restrict y = x + f.count, *restrict z = y + f.count;
    for (long j = 0; j < cells; j++) {
        const double weight = out->weight[j], wx = weight * over_x, wy = weight * over_y;
        const double *const at[3] = {x + j, y + j, z + j};
        double low[3], high[3], left[3], right[3];
        for (int k = 0; k < 3; k++) {
            low[k] = (k == 0) + (at[k][rows] - at[k][0]) * over_x, high[k] = (k == 0) + (at[k][rows + 1] - at[k][1]) * over_x;
            left[k] = (k == 1) + (at[k][1] - at[k][0]) * over_y, right[k] = (k == 1) + (at[k][rows + 1] - at[k][rows]) * over_y;
        }
        const Corner ll = see_corner(&f.numbers, law, low, left, weight, over_x, over_y, neo_hookean, stiffness);
        const Corner lr = see_corner(&f.numbers, law, low, right, weight, over_x, over_y, neo_hookean, stiffness);
        const Corner hl = see_corner(&f.numbers, law, high, left, weight, over_x, over_y, neo_hookean, stiffness);
        const Corner hr = see_corner(&f.numbers, law, high, right, weight, over_x, over_y, neo_hookean, stiffness);
        for (int k = 0; k < 3; k++) {
            const double on_low = over_x * ((ll.S11 + lr.S11) * low[k] + ll.S12 * left[k] + lr.S12 * right[k]);
            const double on_high = over_x * ((hl.S11 + hr.S11) * high[k] + hl.S12 * left[k] + hr.S12 * right[k]);
            const double on_left = over_y * ((ll.S22 + hl.S22) * left[k] + ll.S12 * low[k] + hl.S12 * high[k]);
            const double on_right = over_y * ((lr.S22 + hr.S22) * right[k] + lr.S12 * low[k] + hr.S12 * high[k]);
            out->force[k][LOW_LEFT][j] = -on_low - on_left, out->force[k][LOW_RIGHT][j] = on_low - on_right;
            out->force[k][HIGH_LEFT][j] = on_left - on_high, out->force[k][HIGH_RIGHT][j] = on_high + on_right;
        }
        const double zll = z[j], zlr = z[j + rows], zhl = z[j + 1], zhr = z[j + rows + 1];
        for (int k = 0; k < 2; k++) { /* a corner's is its height times its shadow */
            const double sign = k ? -1 : 1, along_left = sign * left[1 - k], along_right = sign * right[1 - k];
            const double on_low = wx * (zll * along_left + zlr * along_right), on_high = wx * (zhl * along_left + zhr * along_right);
            const double on_left = -wy * sign * (zll * low[1 - k] + zhl * high[1 - k]);
            const double on_right = -wy * sign * (zlr * low[1 - k] + zhr * high[1 - k]);
            out->volume[k][LOW_LEFT][j] = -on_low - on_left, out->volume[k][LOW_RIGHT][j] = on_low - on_right;
            out->volume[k][HIGH_LEFT][j] = on_left - on_high, out->volume[k][HIGH_RIGHT][j] = on_high + on_right;
        }
        out->volume[2][LOW_LEFT][j] = weight * ll.turn, out->volume[2][LOW_RIGHT][j] = weight * lr.turn;
        out->volume[2][HIGH_LEFT][j] = weight * hl.turn, out->volume[2][HIGH_RIGHT][j] = weight * hr.turn;
        out->bulge[j] = weight * (zll * ll.turn + zlr * lr.turn + zhl * hl.turn + zhr * hr.turn);
        out->tension[j] = ll.tension + lr.tension + hl.tension + hr.tension, out->area[j] = ll.area + lr.area + hl.area + hr.area;
        out->turn[j] = (weight > 0 ? 0 : 1e9) + least(least(ll.turn, lr.turn), least(hl.turn, hr.turn));
        if (!stiffness) continue;
        const double xx_low = ll.xx + lr.xx, xx_high = hl.xx + hr.xx, yy_left = ll.yy + hl.yy, yy_right = lr.yy + hr.yy;
        out->own[LOW_LEFT][j] = xx_low + yy_left + 2 * ll.xy, out->own[LOW_RIGHT][j] = xx_low + yy_right - 2 * lr.xy;
        out->own[HIGH_LEFT][j] = xx_high + yy_left - 2 * hl.xy, out->own[HIGH_RIGHT][j] = xx_high + yy_right + 2 * hr.xy;
        out->right[0][j] = lr.xy - ll.xy - xx_low, out->right[1][j] = hl.xy - hr.xy - xx_high;
        out->up[0][j] = hl.xy - ll.xy - yy_left, out->up[1][j] = lr.xy - hr.xy - yy_right;
        out->across[0][j] = -lr.xy - hl.xy, out->across[1][j] = ll.xy + hr.xy;
    }
}

static void see_rubber(const Film *film, const double *x, long cells, Cells *out) { see_cells(film, x, cells, 1, 0, out); }
static void see_plain(const Film *film, const double *x, long cells, Cells *out) { see_cells(film, x, cells, 0, 0, out); }
static void see_stiff_rubber(const Film *film, const double *x, long cells, Cells *out) { see_cells(film, x, cells, 1, 1, out); }
static void see_stiff_plain(const Film *film, const double *x, long cells, Cells *out) { see_cells(film, x, cells, 0, 1, out); }

INLINE void add(double *restrict to, const double *restrict what, long n) {
    for (long j = 0; j < n; j++) to[j] += what[j];
}

/* Of each cell's four nodes. */
INLINE void add_to_nodes(double *restrict to, double what[4][BLOCK], long rows, long n) {
    add(to, what[LOW_LEFT], n), add(to + 1, what[HIGH_LEFT], n);
    add(to + rows, what[LOW_RIGHT], n), add(to + rows + 1, what[HIGH_RIGHT], n);
}

static void add_cells(const Film *film, long first, long n, Cells *c, const SheetFields *to) {
    const long rows = film->rows, count = film->count;
    for (int k = 0; k < 3; k++) {
        add_to_nodes(to->elastic + k * count + first, c->force[k], rows, n);
        add_to_nodes(to->gradient + k * count + first, c->volume[k], rows, n);
    }
    if (!to->own) return;
    add_to_nodes(to->own + first, c->own, rows, n);
    add(to->right + first, c->right[0], n), add(to->right + first + 1, c->right[1], n);
    add(to->up + first, c->up[0], n), add(to->up + first + rows, c->up[1], n);
    add(to->right_up + first, c->across[0], n), add(to->right_down + first + 1, c->across[1], n);
}

static void sum_cells(const Film *film, const Cells *c, long n, SheetSums *sums) {
    double tension = 0, area = 0, volume = 0, turn = sums->least_turn;
    for (long j = 0; j < n; j++) tension += c->tension[j], area += c->area[j], volume += c->bulge[j];
    for (long j = 0; j < n; j++) turn = c->turn[j] < turn ? c->turn[j] : turn;
    sums->tension += tension, sums->area += area / film->numbers.lambda2, sums->volume += volume, sums->least_turn = turn;
}

SheetSums film_sheet(const Film *film, const double *x, const SheetFields *to) {
    const long rows = film->rows, count = film->count, all = count - rows - 1;
    const double weight = film->dx * film->dy / 4;
    SheetSums sums = {.least_turn = INFINITY};
    Cells cells;
    memset(to->elastic, 0, 3 * count * sizeof *to->elastic), memset(to->gradient, 0, 3 * count * sizeof *to->gradient);
    if (to->own) memset(to->own, 0, 5 * count * sizeof *to->own);
    void (*const see)(const Film *, const double *, long, Cells *) =
        film->numbers.neo_hookean != 0 ? (to->own ? see_stiff_rubber : see_rubber) : (to->own ? see_stiff_plain : see_plain);
    for (long first = 0; first < all; first += BLOCK) {
        const long n = all - first < BLOCK ? all - first : BLOCK;
        for (long j = 0; j < n; j++) cells.weight[j] = weight;
        for (long j = rows - 1 - first % rows; j < n; j += rows) cells.weight[j] = 0;
        see(film, x + first, n, &cells);
        add_cells(film, first, n, &cells, to);
        sum_cells(film, &cells, n, &sums);
    }
    sums.tension /= film->numbers.length_x * film->numbers.length_y;
    return sums;
}

/* -- stiffness ------------------------------------------------------------------------------------------------------------ */

/* Derivative of the stress times 2 by C, S11 S22 S12 by C11 C22 C12, symmetric (Eq. F10). */
static void moduli(const Film *film, const Strained *s, double D[3][3]) {
    const double M = film->numbers.modulus, nu = film->numbers.poisson, l = film->numbers.lambda2;
    if (film->numbers.neo_hookean == 0) {
        const double plain[3][3] = {{M * l, nu * M * l, 0}, {nu * M * l, M * l, 0}, {0, 0, (1 - nu) / 2 * M * l}};
        memcpy(D, plain, sizeof plain);
        return;
    }
    const double step = 1e-4 * s->root, q = 2 * M * l * law_at(&film->numbers, film->law, s->root);
    const double by_root = (law_at(&film->numbers, film->law, s->root + step) - law_at(&film->numbers, film->law, s->root - step)) / (2 * step);
    const double slope = 2 * M * l * by_root * -cube(s->root) / 2; /* by det C */
    const double A[3] = {s->C22, s->C11, -s->C12};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) D[a][b] = -slope * A[a] * A[b];
    D[0][1] -= q, D[1][0] -= q, D[2][2] += q / 2;
}

void film_corner_nodes(const Film *film, long corner, long node[3]) {
    const long i = corner / 4 / (film->rows - 1), j = corner / 4 % (film->rows - 1), ci = corner % 4 / 2, cj = corner % 2;
    node[0] = (i + ci) * film->rows + j + cj;
    node[1] = (i + 1 - ci) * film->rows + j + cj, node[2] = (i + ci) * film->rows + j + 1 - cj;
}

void film_corner(const Film *film, const double *x, double pressure, long corner, CornerStiffness *out) {
    const long count = film->count, ci = corner % 4 / 2, cj = corner % 2;
    const double weight = film->dx * film->dy / 4, over_x = (ci ? -1 : 1) / film->dx, over_y = (cj ? -1 : 1) / film->dy;
    const double by1[3] = {-over_x, over_x, 0}, by2[3] = {-over_y, 0, over_y};
    film_corner_nodes(film, corner, out->node);
    const double *at = x + out->node[0], *beside = x + out->node[1], *above = x + out->node[2];
    double g1[3] = {1, 0, 0}, g2[3] = {0, 1, 0}, D[3][3], strain[9][3], stress[9][3], turn[9];
    for (int k = 0; k < 3; k++) {
        g1[k] += over_x * (beside[k * count] - at[k * count]);
        g2[k] += over_y * (above[k * count] - at[k * count]);
    }
    const Strained s = strained(&film->numbers, film->law, g1, g2, film->numbers.neo_hookean != 0);
    moduli(film, &s, D);
    for (int p = 0; p < 9; p++) {
        const int n = p / 3, k = p % 3;
        strain[p][0] = by1[n] * g1[k], strain[p][1] = by2[n] * g2[k], strain[p][2] = by1[n] * g2[k] + by2[n] * g1[k];
        for (int e = 0; e < 3; e++) stress[p][e] = D[e][0] * strain[p][0] + D[e][1] * strain[p][1] + D[e][2] * strain[p][2];
        turn[p] = k == 0 ? by1[n] * g2[1] - by2[n] * g1[1] : k == 1 ? by2[n] * g1[0] - by1[n] * g2[0] : 0;
    }
    const double height = at[2 * count];
    for (int p = 0; p < 9; p++)
        for (int q = 0; q <= p; q++) {
            const int n = p / 3, m = q / 3, k = p % 3, l = q % 3;
            double value = 0, volume = 0; /* the latter's second derivative */
            for (int e = 0; e < 3; e++) value += stress[p][e] * strain[q][e];
            if (k == l) value += by1[n] * (s.S11 * by1[m] + s.S12 * by2[m]) + by2[n] * (s.S12 * by1[m] + s.S22 * by2[m]);
            if (k + l == 1) volume = (k ? -height : height) * (by1[n] * by2[m] - by2[n] * by1[m]);
            volume += (p == 2) * turn[q] + (q == 2) * turn[p];
            out->K[p][q] = out->K[q][p] = weight * (value - pressure * volume);
        }
}

void film_plane_stiffness(const Film *film, const double *x, double *band) {
    const long stride = BAND_STRIDE(FILM_PLANE_WIDTH(film));
    memset(band, 0, 2 * film->inner * stride * sizeof *band);
    CornerStiffness c;
    for (long corner = 0; corner < FILM_CORNERS(film); corner++) {
        film_corner(film, x, 0, corner, &c);
        const long inner[3] = {film_inner(film, c.node[0]), film_inner(film, c.node[1]), film_inner(film, c.node[2])};
        for (int n = 0; n < 3; n++)
            for (int m = 0; m < 3; m++) {
                if (inner[n] < inner[m] || inner[m] < 0) continue;
                for (int k = 0; k < 2; k++)
                    for (int l = 0; l < 2; l++) {
                        const long row = 2 * inner[n] + k, column = 2 * inner[m] + l;
                        if (row >= column) band[column * stride + row - column] += c.K[3 * n + k][3 * m + l];
                    }
            }
    }
}
