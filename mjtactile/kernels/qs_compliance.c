/* In-plane compliance of a membrane for in-plane forces, with free heights. */
#include <string.h>

#include "band_cholesky_f64.h"

/* Return the index of an in-plane unknown among all unknowns: x, y and height of a node
   together. */
static long place_of(long in_plane) { return 3 * (in_plane / 2) + in_plane % 2; }

int64_t qs_compliance(int64_t columns, int64_t rows, const double *factor, int64_t roomy, double *room, double *compliance) {
    const long inner = (columns - 2) * (rows - 2), all = 3 * inner, count = 2 * inner, width = 3 * rows - 1;
    Lanes *x = (Lanes *)room;
    if (roomy < LANES * all) return REFUSED;
    for (long first = 0; first < count; first += LANES) {
        const long lanes = count - first < LANES ? count - first : LANES;
        memset(x, 0, all * sizeof *x);
        for (long l = 0; l < lanes; l++) x[place_of(first + l)][l] = 1;
        band_solve_lanes(all, width, factor, x, place_of(first));
        for (long r = first; r < count; r++)
            for (long l = 0; l < lanes; l++) compliance[r * count + first + l] = compliance[(first + l) * count + r] = x[place_of(r)][l];
    }
    return 0;
}
