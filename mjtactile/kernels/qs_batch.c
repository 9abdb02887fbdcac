/* Equilibria of membranes in many environments, distributed among threads. Each thread takes the
   next environment that is still free. */
#include <string.h>

#include "qs_workspace.h"
#include "kernels.h"

/* Return one environment's fields, or NULL if there are none. */
static const double *own(const double *fields, long e, long size) { return fields ? fields + e * size : 0; }

static void start_at(double *to, const double *from, long size) {
    if (from == to) return;
    if (from) memcpy(to, from, size * sizeof *to);
    else memset(to, 0, size * sizeof *to);
}

int64_t qs_solve_batch(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                   const double *rest, int64_t roomy, double *room, int64_t environments, int64_t *next, const double *settings,
                   int64_t bodies, const double *body, int64_t pooled, const double *pool, const double *from_x,
                   const double *from_force, const double *from_trend, const double *from_found, double *x, double *force,
                   double *trend, double *found) {
    const long nodes = columns * rows;
    for (;;) {
        const long e = (long)__atomic_fetch_add(next, 1, __ATOMIC_RELAXED);
        if (e >= environments) return 0;
        const int known = from_found && from_found[e * FOUND + STATUS] == CONVERGED;
        start_at(x + e * 3 * nodes, known ? own(from_x, e, 3 * nodes) : rest, 3 * nodes);
        start_at(force + e * nodes, known ? own(from_force, e, nodes) : 0, nodes);
        start_at(trend + e * 4 * nodes, known ? own(from_trend, e, 4 * nodes) : 0, 4 * nodes);
        const int64_t code = qs_solve(numbers, law, columns, rows, keeping, kept, rest, roomy, room, 1, 0, 1,
                                        settings + e * (long)(sizeof(Settings) / sizeof(double)), bodies, body + e * bodies * QS_OBSTACLE,
                                        pooled, pool, x + e * 3 * nodes, force + e * nodes, trend + e * 4 * nodes, found + e * FOUND);
        if (code < 0) return code;
    }
}
