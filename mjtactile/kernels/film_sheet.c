/* The sheet of a film: elastic forces (film_cells.h), in double and in single precision, and their stiffness. */
#include "film_sheet.h"

#include <math.h>
#include <string.h>

#include "band.h"
#include "small.h"

#define INLINE static inline __attribute__((always_inline)) /* else loops over them are no vectors */
#ifdef __clang__
#define VECTORS _Pragma("clang loop vectorize(assume_safety) interleave(disable)") /* lines do not overlap */
#else
#define VECTORS _Pragma("GCC ivdep")
#endif
#define LEAST_DET 1e-2
#define LEAST_TENSION 0.3 /* of the mean of both directions, in the stiffness that steps are made with */

Film film_of(const double *numbers, const double *law) {
    Film film = {.law = law};
    memcpy(&film.numbers, numbers, sizeof film.numbers);
    film.columns = (long)film.numbers.nodes_x, film.rows = (long)film.numbers.nodes_y;
    film.inner_rows = film.rows - 2, film.inner = (film.columns - 2) * film.inner_rows;
    film.line = (film.rows + 7) / 8 * 8, film.count = film.columns * film.line;
    film.dx = film.numbers.length_x / (film.columns - 1), film.dy = film.numbers.length_y / (film.rows - 1);
    return film;
}

#define REAL double
#define SQRT sqrt
#define TYPE(name) name
#include "film_cells.h"
#undef REAL
#undef SQRT
#undef TYPE

#define REAL float
#define SQRT sqrtf
#define TYPE(name) name##Float
#include "film_cells.h"
#undef REAL
#undef SQRT
#undef TYPE

/* -- stiffness ------------------------------------------------------------------------------------------------------------ */

/* Derivative of the stress times 2 by C, S11 S22 S12 by C11 C22 C12, symmetric (Eq. F10). */
static void moduli(const Numbers *o, const Strained *s, int neo_hookean, double D[3][3]) {
    const double M = o->modulus, nu = o->poisson, l = o->lambda2;
    if (!neo_hookean) {
        const double plain[3][3] = {{M * l, nu * M * l, 0}, {nu * M * l, M * l, 0}, {0, 0, (1 - nu) / 2 * M * l}};
        memcpy(D, plain, sizeof plain);
        return;
    }
    const double step = 1e-4 * s->root, q = 2 * M * l * law_at(o, s->root);
    const double by_root = (law_at(o, s->root + step) - law_at(o, s->root - step)) / (2 * step);
    const double slope = 2 * M * l * by_root * -cube(s->root) / 2; /* by det C */
    const double A[3] = {s->C22, s->C11, -s->C12};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) D[a][b] = -slope * A[a] * A[b];
    D[0][1] -= q, D[1][0] -= q, D[2][2] += q / 2;
}

void film_corner_nodes(const Film *film, long corner, long node[3]) {
    const long i = corner / 4 / (film->rows - 1), j = corner / 4 % (film->rows - 1), ci = corner % 4 / 2, cj = corner % 2;
    node[0] = (i + ci) * film->line + j + cj;
    node[1] = (i + 1 - ci) * film->line + j + cj, node[2] = (i + ci) * film->line + j + 1 - cj;
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
    const Numbers o = numbers_of(film);
    const int neo_hookean = film->numbers.neo_hookean != 0;
    const double C[3] = {g1[0] * g1[0] + g1[1] * g1[1] + g1[2] * g1[2], g2[0] * g2[0] + g2[1] * g2[1] + g2[2] * g2[2],
                         g1[0] * g2[0] + g1[1] * g2[1] + g1[2] * g2[2]};
    const Strained s = strained(&o, o.lambda2 * C[0], o.lambda2 * C[1], o.lambda2 * C[2], neo_hookean);
    moduli(&o, &s, neo_hookean, D);
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
