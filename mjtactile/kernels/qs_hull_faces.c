/* Planes of a convex hull as heights over the frame's plane, computed once for all positions. The
   lower side is the maximum of the planes that face down. The hull is there only if this is below
   the minimum of the planes that face up, and inside the upright planes. */
#include <math.h>

#include "qs_workspace.h"
#include "small_linalg.h"

#define UPRIGHT 1e-12 /* z component of a unit normal up to which a plane is upright */

enum { DOWN, UP, NEITHER };

/* Planes that face in the same direction, as lists of c, a and b: z = c + a x + b y. Upright planes
   are positive inside. */
typedef struct { long count; const double *c, *a, *b; } Planes;

/* Compute the three numbers of an obstacle's plane (n, d) in S. Returns the direction in which it
   faces. */
static int plane_in_sensor(const Obstacle *b, const double *plane, double *numbers) {
    double n[3];
    for (int k = 0; k < 3; k++) n[k] = b->R[3 * k] * plane[0] + b->R[3 * k + 1] * plane[1] + b->R[3 * k + 2] * plane[2];
    const double inside = plane[3] + n[0] * b->p[0] + n[1] * b->p[1] + n[2] * b->p[2];
    const int way = n[2] < -UPRIGHT ? DOWN : n[2] > UPRIGHT ? UP : NEITHER;
    const double over = way == NEITHER ? 1 : 1 / n[2];
    numbers[0] = inside * over, numbers[1] = -n[0] * over, numbers[2] = -n[1] * over;
    return way;
}

/* Write the number of planes in each direction, in multiples of four, and then the planes. */
static void make_faces(const Obstacle *b, const double *rows, double *out) {
    const long count = (long)b->number, stride = qs_faces_stride(b);
    long filled = 0;
    double numbers[3];
    for (int way = 0; way < QS_DIRECTIONS; way++) {
        const long first = filled;
        for (long i = 0; i < count; i++) {
            if (plane_in_sensor(b, rows + 4 * i, numbers) != way) continue;
            for (int k = 0; k < 3; k++) out[QS_SIDE + k * stride + filled] = numbers[k];
            filled++;
        }
        for (; (filled - first) % QS_SIDE; filled++) /* repeat the last plane */
            for (int k = 0; k < 3; k++) out[QS_SIDE + k * stride + filled] = out[QS_SIDE + k * stride + filled - 1];
        out[way] = (double)(filled - first);
    }
}

void qs_faces(const Bodies *bodies, double *faces) {
    for (long b = 0; b < bodies->count; b++) {
        const Obstacle *one = qs_obstacle_at(bodies, b);
        if (one->kind == BODY_CONVEX) make_faces(one, bodies->pool + (long)one->first, faces);
        faces += qs_faces_of(one);
    }
}

/* Return the maximum of planes over a position, or with `sign` -1 the negative minimum; `which` is
   the index of that plane. */
static double largest(Planes planes, double sign, double x, double y, long *which) {
    double top[QS_SIDE], at[QS_SIDE];
    for (int k = 0; k < QS_SIDE; k++) top[k] = -INFINITY, at[k] = 0;
    for (long first = 0; first < planes.count; first += QS_SIDE)
        for (int k = 0; k < QS_SIDE; k++) {
            const double own = sign * (planes.c[first + k] + planes.a[first + k] * x + planes.b[first + k] * y);
            at[k] = own > top[k] ? (double)first : at[k];
            top[k] = own > top[k] ? own : top[k];
        }
    int lane = 0;
    for (int k = 1; k < QS_SIDE; k++)
        if (top[k] > top[lane]) lane = k;
    *which = (long)at[lane] + lane;
    return top[lane];
}

int qs_faces_height(const Membrane *f, const Obstacle *b, const double *faces, double x, double y, double *height, double slope[2]) {
    const long stride = qs_faces_stride(b);
    const double *c = faces + QS_SIDE;
    Planes planes[QS_DIRECTIONS];
    for (int way = 0; way < QS_DIRECTIONS; way++) {
        planes[way] = (Planes){(long)faces[way], c, c + stride, c + 2 * stride};
        c += planes[way].count;
    }
    long lowest, other;
    const double z = largest(planes[DOWN], 1, x, y, &lowest);
    if (isinf(z) || z >= -largest(planes[UP], -1, x, y, &other) || largest(planes[NEITHER], -1, x, y, &other) > 0) return 1;
    slope[0] = planes[DOWN].a[lowest], slope[1] = planes[DOWN].b[lowest];
    *height = z - f->numbers.half_thickness * qs_farther_along_z(slope);
    return 0;
}
