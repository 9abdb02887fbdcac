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

/* What a corner of BLOCK cells in a line gives: forces on the ends of the edges along x and along y, likewise of the volume,
   which also the corner's own height changes; stiffness of heights, three numbers; and what is summed. */
#define BLOCK 64
typedef struct {
    double along_x[3][BLOCK], along_y[3][BLOCK], volume_x[2][BLOCK], volume_y[2][BLOCK], own[BLOCK];
    double xx[BLOCK], yy[BLOCK], xy[BLOCK];
    double tension[BLOCK], area[BLOCK], volume[BLOCK], turn[BLOCK];
} Corners;

/* Fields of displacements at both ends of the edges that meet in a corner, and the corner's height. */
typedef struct { const double *low[3], *high[3], *under[3], *over[3], *height; } Ends;

INLINE void see_corners(const Film *film, const Ends *ends, long cells, int neo_hookean, Corners *restrict out) {
    const Film f = *film; /* what is written might be part of it, for all that a compiler knows */
    double law[FILM_LAW];
    memcpy(law, film->law, sizeof law);
    const double over_x = 1 / f.dx, over_y = 1 / f.dy, weight = f.dx * f.dy / 4, wx = weight * over_x, wy = weight * over_y;
    const double *restrict low_x = ends->low[0], *restrict low_y = ends->low[1], *restrict low_z = ends->low[2];
    const double *restrict high_x = ends->high[0], *restrict high_y = ends->high[1], *restrict high_z = ends->high[2];
    const double *restrict under_x = ends->under[0], *restrict under_y = ends->under[1], *restrict under_z = ends->under[2];
    const double *restrict over_at_x = ends->over[0], *restrict over_at_y = ends->over[1], *restrict over_z = ends->over[2];
    const double *restrict height = ends->height;
    for (long j = 0; j < cells; j++) {
        const double g1[3] = {1 + (high_x[j] - low_x[j]) * over_x, (high_y[j] - low_y[j]) * over_x, (high_z[j] - low_z[j]) * over_x};
        const double g2[3] = {(over_at_x[j] - under_x[j]) * over_y, 1 + (over_at_y[j] - under_y[j]) * over_y,
                              (over_z[j] - under_z[j]) * over_y};
        const Strained s = strained(&f.numbers, law, g1, g2, neo_hookean);
        for (int k = 0; k < 3; k++) {
            out->along_x[k][j] = wx * (s.S11 * g1[k] + s.S12 * g2[k]);
            out->along_y[k][j] = wy * (s.S12 * g1[k] + s.S22 * g2[k]);
        }
        const double z = height[j], turn = g1[0] * g2[1] - g1[1] * g2[0];
        out->volume_x[0][j] = wx * z * g2[1], out->volume_x[1][j] = -wx * z * g2[0];
        out->volume_y[0][j] = -wy * z * g1[1], out->volume_y[1][j] = wy * z * g1[0];
        out->own[j] = weight * turn;
        const double tension = (s.S11 * s.C11 + s.S22 * s.C22 + 2 * s.S12 * s.C12) * s.root / 2;
        const double least_tension = LEAST_TENSION * most(tension, 0), by = weight / (1 + g1[2] * g1[2] + g2[2] * g2[2]);
        out->xx[j] = by * most(s.S11, least_tension) * over_x * over_x;
        out->yy[j] = by * most(s.S22, least_tension) * over_y * over_y;
        out->xy[j] = by * s.S12 * over_x * over_y;
        out->tension[j] = weight * tension, out->area[j] = weight / (s.root * f.numbers.lambda2);
        out->volume[j] = weight * z * turn, out->turn[j] = turn;
    }
}

static void see_rubber(const Film *film, const Ends *ends, long cells, Corners *restrict out) {
    see_corners(film, ends, cells, 1, out);
}

static void see_plain(const Film *film, const Ends *ends, long cells, Corners *restrict out) {
    see_corners(film, ends, cells, 0, out);
}

INLINE void add(double *restrict to, const double *restrict what, double by, long n) {
    for (long j = 0; j < n; j++) to[j] += by * what[j];
}

/* An edge's force pulls at both its ends. */
INLINE void pull(double *restrict low, double *restrict high, const double *restrict force, long n) {
    for (long j = 0; j < n; j++) high[j] += force[j];
    for (long j = 0; j < n; j++) low[j] -= force[j];
}

/* Of cells (i, first ..): corner (ci, cj). */
static void add_corners(const Film *film, long i, long first, long n, int ci, int cj, const Corners *c, const SheetFields *to) {
    const long rows = film->rows, count = film->count, low = i * rows + first + cj, side = (i + ci) * rows + first;
    for (int k = 0; k < 3; k++) {
        double *elastic = to->elastic + k * count;
        pull(elastic + low, elastic + low + rows, c->along_x[k], n), pull(elastic + side, elastic + side + 1, c->along_y[k], n);
    }
    for (int k = 0; k < 2; k++) {
        double *volume = to->gradient + k * count;
        pull(volume + low, volume + low + rows, c->volume_x[k], n), pull(volume + side, volume + side + 1, c->volume_y[k], n);
    }
    add(to->gradient + 2 * count + side + cj, c->own, 1, n);
    if (!to->own) return;
    const double sign = ci == cj ? 1 : -1;
    add(to->own + low, c->xx, 1, n), add(to->own + low + rows, c->xx, 1, n), add(to->right + low, c->xx, -1, n);
    add(to->own + side, c->yy, 1, n), add(to->own + side + 1, c->yy, 1, n), add(to->up + side, c->yy, -1, n);
    add(to->own + side + cj, c->xy, 2 * sign, n), add(to->right + low, c->xy, -sign, n), add(to->up + side, c->xy, -sign, n);
    if (ci == cj) add(to->right_down + i * rows + first + 1, c->xy, 1, n); /* pairs (i, j + 1) and (i + 1, j) */
    else add(to->right_up + i * rows + first, c->xy, -1, n);
}

static void sum_corners(const Corners *c, long n, SheetSums *sums) {
    double tension = 0, area = 0, volume = 0, turn = sums->least_turn;
    for (long j = 0; j < n; j++) tension += c->tension[j], area += c->area[j], volume += c->volume[j];
    for (long j = 0; j < n; j++) turn = c->turn[j] < turn ? c->turn[j] : turn;
    sums->tension += tension, sums->area += area, sums->volume += volume, sums->least_turn = turn;
}

SheetSums film_sheet(const Film *film, const double *x, const SheetFields *to) {
    const long rows = film->rows, count = film->count;
    SheetSums sums = {.least_turn = INFINITY};
    Corners corners;
    memset(to->elastic, 0, 3 * count * sizeof *to->elastic), memset(to->gradient, 0, 3 * count * sizeof *to->gradient);
    if (to->own) memset(to->own, 0, 5 * count * sizeof *to->own);
    for (long cell = 0; cell < 4 * (film->columns - 1); cell++)
        for (long first = 0; first < rows - 1; first += BLOCK) {
            const long i = cell / 4, ci = cell / 2 % 2, cj = cell % 2, n = rows - 1 - first < BLOCK ? rows - 1 - first : BLOCK;
            Ends ends = {.height = x + 2 * count + (i + ci) * rows + first + cj};
            for (int k = 0; k < 3; k++) {
                ends.low[k] = x + k * count + i * rows + first + cj, ends.high[k] = ends.low[k] + rows;
                ends.under[k] = x + k * count + (i + ci) * rows + first, ends.over[k] = ends.under[k] + 1;
            }
            (film->numbers.neo_hookean != 0 ? see_rubber : see_plain)(film, &ends, n, &corners);
            add_corners(film, i, first, n, ci, cj, &corners, to);
            sum_corners(&corners, n, &sums);
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
        for (int p = 0; p < 9; p++)
            for (int q = 0; q < 9; q++) {
                const long m = film_inner(film, c.node[p / 3]), n = film_inner(film, c.node[q / 3]);
                const long row = 2 * m + p % 3, column = 2 * n + q % 3;
                if (m < 0 || n < 0 || p % 3 == 2 || q % 3 == 2 || row < column) continue;
                band[column * stride + row - column] += c.K[p][q];
            }
    }
}
