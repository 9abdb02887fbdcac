/* Lowest obstacle over a position. */
#ifndef MJTACTILE_QS_LOWEST_OBSTACLE_H
#define MJTACTILE_QS_LOWEST_OBSTACLE_H
#include <math.h>

#include "qs_workspace.h"
#include "small_linalg.h"

/* Compute the lowest height, and its slopes, of all obstacles over a position. Returns the number
   of the lowest obstacle, or -1 if there is none. */
static inline long lowest_of(const Membrane *f, const Bodies *bodies, double x, double y, double *height, double slope[2]) {
    double found = INFINITY, at, by[2] = {0, 0};
    long which = -1;
    const double *next = bodies->faces;
    for (long b = 0; b < bodies->count; b++) {
        const Obstacle *one = qs_obstacle_at(bodies, b);
        const double *faces = next && one->kind == BODY_CONVEX ? next : 0;
        if (faces) next += qs_faces_of(one);
        if (square(x - one->p[0]) + square(y - one->p[1]) > square(one->reach + f->numbers.half_thickness)) continue;
        const int off = faces ? qs_faces_height(f, one, faces, x, y, &at, by) : qs_obstacle_height(f, one, bodies->pool, x, y, &at, by);
        if (off || at >= found || at > f->numbers.roof) continue;
        found = at, which = b, slope[0] = by[0], slope[1] = by[1];
    }
    *height = found;
    return which;
}

/* Return 1 if there is no obstacle over a position, otherwise as `lowest_of`. */
static inline int lowest(const Membrane *f, const Bodies *bodies, double x, double y, double *height, double slope[2]) {
    lowest_of(f, bodies, x, y, height, slope);
    return isinf(*height);
}

#endif
