/* Lower bounds of the obstacles: a convex obstacle is above each of its tangent planes, and every
   obstacle is above the limit of its reach. */
#include <math.h>
#include <string.h>

#include "qs_workspace.h"
#include "small_linalg.h"

/* distance of the tangent points from the contact center, fraction of the frame's sides */
#define SPREAD 0.15

static const double TAKEN_AT[QS_TANGENTS][2] = {{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}};

static int is_convex(const Obstacle *b) {
    switch ((int)b->kind) {
    case BODY_TRIANGLES: case BODY_HEIGHTS: return 0;
    case BODY_QUADRIC: return b->sizes[0] >= 0 && b->sizes[1] >= 0;
    default: return 1;
    }
}

/* Compute planes z = p[0] + p[1] x + p[2] y below the heights of one obstacle: a horizontal one,
   and tangents about `middle`. A height is that of the obstacle minus the membrane's half thickness
   along z. That term is replaced by its bound, unless the offset surface itself is convex. */
static void planes_below(const Membrane *f, const Obstacle *b, const double *pool, const double middle[2], double *planes) {
    const double half_sides[2] = {f->numbers.length_x / 2, f->numbers.length_y / 2}, out = f->numbers.half_thickness;
    const int offset_is_convex = b->kind == BODY_SPHERE || b->kind == BODY_CAPSULE;
    int is_over = 1;
    for (int c = 0; c < 2; c++) is_over &= fabs(b->p[c]) <= half_sides[c] + b->reach + out;
    const double level = is_over ? b->p[2] - b->reach - QS_STEEPEST * out : INFINITY;
    for (int t = 0; t <= QS_TANGENTS; t++) planes[3 * t] = level, planes[3 * t + 1] = planes[3 * t + 2] = 0;
    if (!is_over || !is_convex(b)) return;
    for (int t = 0; t < QS_TANGENTS; t++) {
        double *plane = planes + 3 * (t + 1), height, slope[2], at[2];
        for (int c = 0; c < 2; c++) at[c] = middle[c] + 2 * SPREAD * half_sides[c] * TAKEN_AT[t][c];
        if (qs_obstacle_height(f, b, pool, at[0], at[1], &height, slope)) continue;
        const double lower = offset_is_convex ? 0 : out * (QS_STEEPEST - qs_farther_along_z(slope));
        plane[0] = height - lower - slope[0] * at[0] - slope[1] * at[1], plane[1] = slope[0], plane[2] = slope[1];
    }
}

void find_lower_bounds(const Membrane *f, const Bodies *bodies, ContactNodes *seen) {
    const long *box = seen->box;
    const int touches = box[0] < box[1];
    const double middle[2] = {touches ? (double)(box[0] + box[1] - 1) / 2 * f->dx - f->numbers.length_x / 2 : 0,
                              touches ? (double)(box[2] + box[3] - 1) / 2 * f->dy - f->numbers.length_y / 2 : 0};
    seen->floors = bodies->count <= QS_FLOORS ? bodies->count : -1;
    for (long b = 0; b < seen->floors; b++)
        planes_below(f, qs_obstacle_at(bodies, b), bodies->pool, middle, seen->planes + b * QS_PLANES);
}

void lower_bound_at(const ContactNodes *seen, long count, const double *x, const double *y, double *floor) {
    for (long k = 0; k < count; k++) floor[k] = seen->floors < 0 ? -INFINITY : INFINITY;
    for (long b = 0; b < seen->floors; b++) {
        const double *p = seen->planes + b * QS_PLANES;
        if (isinf(p[0]) && p[0] > 0) continue;
        for (long k = 0; k < count; k++) {
            double own = p[0];
            for (int t = 1; t <= QS_TANGENTS; t++) own = max_of(own, p[3 * t] + p[3 * t + 1] * x[k] + p[3 * t + 2] * y[k]);
            floor[k] = min_of(floor[k], own);
        }
    }
}
