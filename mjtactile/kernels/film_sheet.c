/* Elastic forces of the sheet on its grid. A cell is seen at its four corners; a corner's tangents are the cell's two edges that
   meet there. Loops along y go over whole lines, so that the compiler makes vectors of them. */
#include "film_sheet.h"

#include <math.h>
#include <string.h>

#include "band.h"
#include "small.h"

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

static inline double law_at(const Film *film, double root) {
    const double t = (root - film->numbers.law_middle) * film->numbers.law_per_unit;
    double q = film->law[FILM_LAW - 1];
    for (int k = FILM_LAW - 2; k >= 0; k--) q = q * t + film->law[k];
    return q;
}

static inline Strained strained(const Film *film, const double g1[3], const double g2[3], int neo_hookean) {
    const double l = film->numbers.lambda2, M = film->numbers.modulus, nu = film->numbers.poisson;
    Strained s;
    s.C11 = l * (g1[0] * g1[0] + g1[1] * g1[1] + g1[2] * g1[2]);
    s.C22 = l * (g2[0] * g2[0] + g2[1] * g2[1] + g2[2] * g2[2]);
    s.C12 = l * (g1[0] * g2[0] + g1[1] * g2[1] + g1[2] * g2[2]);
    s.root = 1 / sqrt(most(s.C11 * s.C22 - s.C12 * s.C12, LEAST_DET));
    if (neo_hookean) {
        const double q = law_at(film, s.root);
        s.S11 = M * (1 - q * s.C22), s.S22 = M * (1 - q * s.C11), s.S12 = M * q * s.C12;
    } else {
        const double E11 = (s.C11 - 1) / 2, E22 = (s.C22 - 1) / 2;
        s.S11 = M * (E11 + nu * E22), s.S22 = M * (E22 + nu * E11), s.S12 = M * (1 - nu) * s.C12 / 2;
    }
    return s;
}

/* One corner of the cells (i, 0 ..): (ci, cj) says which. Writes lines: 0-2 and 3-5 the forces along x- and y-edges, 6-9 the
   volume's, 10 the corner's own, 11-13 stiffness of heights, 14 tension times area, 15 area, 16 volume, 17 turn. */
static inline void corner_lines(const Film *film, const double *x, long i, int ci, int cj, int neo_hookean, double *lines) {
    const long rows = film->rows, count = film->count, cells = rows - 1;
    const double *low = x + i * rows + cj, *high = low + rows, *side = x + (i + ci) * rows;
    const double over_x = 1 / film->dx, over_y = 1 / film->dy, weight = film->dx * film->dy / 4;
    double *restrict out = lines;
    for (long j = 0; j < cells; j++) {
        double g1[3], g2[3];
        for (int k = 0; k < 3; k++) {
            g1[k] = (high[k * count + j] - low[k * count + j]) * over_x;
            g2[k] = (side[k * count + j + 1] - side[k * count + j]) * over_y;
        }
        g1[0] += 1, g2[1] += 1;
        const Strained s = strained(film, g1, g2, neo_hookean);
        const double wx = weight * over_x, wy = weight * over_y;
        for (int k = 0; k < 3; k++) {
            out[k * rows + j] = wx * (s.S11 * g1[k] + s.S12 * g2[k]);
            out[(3 + k) * rows + j] = wy * (s.S12 * g1[k] + s.S22 * g2[k]);
        }
        const double z = side[2 * count + cj + j], turn = g1[0] * g2[1] - g1[1] * g2[0];
        out[6 * rows + j] = wx * z * g2[1], out[7 * rows + j] = -wx * z * g2[0];
        out[8 * rows + j] = -wy * z * g1[1], out[9 * rows + j] = wy * z * g1[0];
        out[10 * rows + j] = weight * turn;
        const double tension = (s.S11 * s.C11 + s.S22 * s.C22 + 2 * s.S12 * s.C12) * s.root / 2;
        const double least_tension = LEAST_TENSION * most(tension, 0), by = weight / (1 + g1[2] * g1[2] + g2[2] * g2[2]);
        out[11 * rows + j] = by * most(s.S11, least_tension) * over_x * over_x;
        out[12 * rows + j] = by * most(s.S22, least_tension) * over_y * over_y;
        out[13 * rows + j] = by * s.S12 * over_x * over_y;
        out[14 * rows + j] = weight * tension, out[15 * rows + j] = weight / (s.root * film->numbers.lambda2);
        out[16 * rows + j] = weight * z * turn, out[17 * rows + j] = turn;
    }
}

static inline void add(double *restrict to, const double *restrict what, double by, long n) {
    for (long j = 0; j < n; j++) to[j] += by * what[j];
}

static inline double total(const double *what, long n) {
    double sum = 0;
    for (long j = 0; j < n; j++) sum += what[j];
    return sum;
}

static void add_corner(const Film *film, long i, int ci, int cj, const double *lines, const SheetFields *to) {
    const long rows = film->rows, count = film->count, n = rows - 1, low = i * rows + cj, side = (i + ci) * rows;
    const long here = side + cj;
    for (int k = 0; k < 3; k++) {
        double *elastic = to->elastic + k * count;
        add(elastic + low + rows, lines + k * rows, 1, n), add(elastic + low, lines + k * rows, -1, n);
        add(elastic + side + 1, lines + (3 + k) * rows, 1, n), add(elastic + side, lines + (3 + k) * rows, -1, n);
    }
    for (int k = 0; k < 2; k++) {
        double *gradient = to->gradient + k * count;
        add(gradient + low + rows, lines + (6 + k) * rows, 1, n), add(gradient + low, lines + (6 + k) * rows, -1, n);
        add(gradient + side + 1, lines + (8 + k) * rows, 1, n), add(gradient + side, lines + (8 + k) * rows, -1, n);
    }
    add(to->gradient + 2 * count + here, lines + 10 * rows, 1, n);
    if (!to->own) return;
    const double *xx = lines + 11 * rows, *yy = lines + 12 * rows, *xy = lines + 13 * rows, sign = ci == cj ? 1 : -1;
    add(to->own + low, xx, 1, n), add(to->own + low + rows, xx, 1, n), add(to->right + low, xx, -1, n);
    add(to->own + side, yy, 1, n), add(to->own + side + 1, yy, 1, n), add(to->up + side, yy, -1, n);
    add(to->own + here, xy, 2 * sign, n), add(to->right + low, xy, -sign, n), add(to->up + side, xy, -sign, n);
    if (ci == cj) add(to->right_down + i * rows + 1, xy, 1, n); /* pairs (i, j + 1) and (i + 1, j) */
    else add(to->right_up + i * rows, xy, -1, n);
}

SheetSums film_sheet(const Film *film, const double *x, const SheetFields *to, double *lines) {
    const long rows = film->rows, count = film->count, n = rows - 1;
    SheetSums sums = {.least_turn = INFINITY};
    memset(to->elastic, 0, 3 * count * sizeof *to->elastic), memset(to->gradient, 0, 3 * count * sizeof *to->gradient);
    if (to->own) memset(to->own, 0, 5 * count * sizeof *to->own);
    const int neo_hookean = film->numbers.neo_hookean != 0;
    for (long i = 0; i < film->columns - 1; i++)
        for (int c = 0; c < 4; c++) {
            if (neo_hookean) corner_lines(film, x, i, c / 2, c % 2, 1, lines);
            else corner_lines(film, x, i, c / 2, c % 2, 0, lines);
            add_corner(film, i, c / 2, c % 2, lines, to);
            sums.tension += total(lines + 14 * rows, n), sums.area += total(lines + 15 * rows, n);
            sums.volume += total(lines + 16 * rows, n);
            for (long j = 0; j < n; j++) sums.least_turn = least(sums.least_turn, lines[17 * rows + j]);
        }
    sums.tension /= film->numbers.length_x * film->numbers.length_y;
    return sums;
}

/* -- stiffness in the plane, made once a film ------------------------------------------------------------------------------ */

static long inner_of(const Film *film, long i, long j) {
    if (i < 1 || j < 1 || i > film->columns - 2 || j > film->rows - 2) return -1;
    return (i - 1) * film->inner_rows + j - 1;
}

/* Derivative of the stress times 2 by C, S11 S22 S12 by C11 C22 C12, symmetric (Eq. F10). */
static void moduli(const Film *film, const Strained *s, double D[3][3]) {
    const double M = film->numbers.modulus, nu = film->numbers.poisson, l = film->numbers.lambda2;
    if (film->numbers.neo_hookean == 0) {
        const double plain[3][3] = {{M * l, nu * M * l, 0}, {nu * M * l, M * l, 0}, {0, 0, (1 - nu) / 2 * M * l}};
        memcpy(D, plain, sizeof plain);
        return;
    }
    const double step = 1e-4 * s->root, q = 2 * M * l * law_at(film, s->root);
    const double by_root = (law_at(film, s->root + step) - law_at(film, s->root - step)) / (2 * step);
    const double slope = 2 * M * l * by_root * -cube(s->root) / 2; /* by det C */
    const double A[3] = {s->C22, s->C11, -s->C12};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) D[a][b] = -slope * A[a] * A[b];
    D[0][1] -= q, D[1][0] -= q, D[2][2] += q / 2;
}

void film_plane_stiffness(const Film *film, const double *x, double *band) {
    const long rows = film->rows, count = film->count, stride = BAND_STRIDE(FILM_PLANE_WIDTH(film));
    const double weight = film->dx * film->dy / 4;
    memset(band, 0, 2 * film->inner * stride * sizeof *band);
    for (long cell = 0; cell < (film->columns - 1) * (rows - 1) * 4; cell++) {
        const long i = cell / 4 / (rows - 1), j = cell / 4 % (rows - 1), ci = cell % 4 / 2, cj = cell % 2;
        const long pi[4] = {i, i + 1, i + ci, i + ci}, pj[4] = {j + cj, j + cj, j, j + 1};
        const double by1[4] = {-1 / film->dx, 1 / film->dx, 0, 0}, by2[4] = {0, 0, -1 / film->dy, 1 / film->dy};
        double g1[3] = {1, 0, 0}, g2[3] = {0, 1, 0}, D[3][3];
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 4; a++) {
                const double value = x[k * count + pi[a] * rows + pj[a]];
                g1[k] += by1[a] * value, g2[k] += by2[a] * value;
            }
        const Strained s = strained(film, g1, g2, film->numbers.neo_hookean != 0);
        moduli(film, &s, D);
        for (int a = 0; a < 4; a++)
            for (int b = 0; b < 4; b++) {
                const long m = inner_of(film, pi[a], pj[a]), n = inner_of(film, pi[b], pj[b]);
                if (m < 0 || n < 0) continue;
                const double geometric = by1[a] * (s.S11 * by1[b] + s.S12 * by2[b]) + by2[a] * (s.S12 * by1[b] + s.S22 * by2[b]);
                for (int k = 0; k < 2; k++)
                    for (int l = 0; l < 2; l++) {
                        const long row = 2 * m + k, column = 2 * n + l;
                        if (row < column) continue;
                        /* changes of E11, E22, 2 E12 by the two displacements */
                        const double Ea[3] = {by1[a] * g1[k], by2[a] * g2[k], by1[a] * g2[k] + by2[a] * g1[k]};
                        const double Eb[3] = {by1[b] * g1[l], by2[b] * g2[l], by1[b] * g2[l] + by2[b] * g1[l]};
                        double value = k == l ? geometric : 0;
                        for (int e = 0; e < 3; e++)
                            for (int f = 0; f < 3; f++) value += Ea[e] * D[e][f] * Eb[f];
                        band[column * stride + row - column] += weight * value;
                    }
            }
    }
}

