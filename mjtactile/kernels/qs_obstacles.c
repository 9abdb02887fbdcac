/* Lower sides of obstacles along the membrane's z from below: the first point of a vertical line in
   the obstacle. */
#include "quasistatic.h"

#include <math.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

#define FAR 1.0          /* start of the lines below everything, m */
#define SHARP 1.0 /* slope at which a rim counts as an edge if its radius is below the spacing */
#define FLANK 2.0
#define MAX_APPROACHES 50
#define NEAR 1e-13 /* distance from the surface at which the iteration ends, m */
#define TIP 1e-12  /* tolerance of a cone's tip, m */
#define LANES 4
#define LEVEL 1e-12 /* component of a plane's normal along a line, below which they are parallel */

/* A vertical line in the obstacle's frame: `from` + t `along`; t is the height in S. */
typedef struct { double from[3], along[3]; } Line;

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static Line line_in_body(const Obstacle *b, double x, double y) {
    Line line;
    const double at[3] = {x - b->p[0], y - b->p[1], -b->p[2]};
    for (int k = 0; k < 3; k++) {
        line.from[k] = b->R[k] * at[0] + b->R[3 + k] * at[1] + b->R[6 + k] * at[2];
        line.along[k] = b->R[6 + k];
    }
    return line;
}

/* Compute the slopes of a surface whose outward normal `n` (obstacle's frame) points down. Returns
   1 if it does not. */
static int slopes_of(const Obstacle *b, const double *n, double slope[2]) {
    double world[3];
    for (int k = 0; k < 3; k++) world[k] = dot3(b->R + 3 * k, n);
    if (!(world[2] < 0)) return 1;
    slope[0] = -world[0] / world[2], slope[1] = -world[1] / world[2];
    return 0;
}

/* Compute the smaller root of a t^2 + 2 b t + c. Returns 1 if there is none. */
static int first_root(double a, double b, double c, double *t) {
    double inside = b * b - a * c;
    if (!(inside > 0) || !(fabs(a) > 1e-300)) return 1;
    *t = (-b - sqrt(inside)) / a;
    return 0;
}

static int ball(const double *middle, double radius, const Line *line, double *t, double *n) {
    double off[3];
    for (int k = 0; k < 3; k++) off[k] = line->from[k] - middle[k];
    if (first_root(1, dot3(off, line->along), dot3(off, off) - radius * radius, t)) return 1;
    for (int k = 0; k < 3; k++) n[k] = off[k] + *t * line->along[k];
    return 0;
}

/* Intersect a line with the side of a cylinder about the obstacle's z, up to |z| <= half. */
static int intersect_side(double radius, double half, const Line *line, double *t, double *n) {
    const double *o = line->from, *d = line->along;
    if (first_root(d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1], o[0] * o[0] + o[1] * o[1] - radius * radius, t)) return 1;
    double z = o[2] + *t * d[2];
    if (fabs(z) > half) return 1;
    n[0] = o[0] + *t * d[0], n[1] = o[1] + *t * d[1], n[2] = 0;
    return 0;
}

static int capsule(const Obstacle *b, double out, const Line *line, double *t, double *n) {
    double radius = b->sizes[0] + out, half = b->sizes[1];
    if (!intersect_side(radius, half, line, t, n)) return 0;
    double found = INFINITY;
    for (int end = -1; end <= 1; end += 2) {
        const double middle[3] = {0, 0, end * half};
        double t_end, n_end[3];
        if (!ball(middle, radius, line, &t_end, n_end) && t_end < found) {
            found = t_end;
            for (int k = 0; k < 3; k++) n[k] = n_end[k];
        }
    }
    *t = found;
    return isinf(found);
}

static int ellipsoid(const Obstacle *b, const Line *line, double *t, double *n) {
    Line scaled;
    for (int k = 0; k < 3; k++) scaled.from[k] = line->from[k] / b->sizes[k], scaled.along[k] = line->along[k] / b->sizes[k];
    const double a = dot3(scaled.along, scaled.along), c = dot3(scaled.from, scaled.from) - 1;
    if (first_root(a, dot3(scaled.from, scaled.along), c, t)) return 1;
    for (int k = 0; k < 3; k++) n[k] = (scaled.from[k] + *t * scaled.along[k]) / b->sizes[k];
    return 0;
}

/* Intersect a line with the end of a solid of revolution: a disc of `radius` at `z`, whose outside
   is towards `sign`. */
static int intersect_end(double z, double sign, double radius, const Line *line, double *t, double *n) {
    if (fabs(line->along[2]) < 1e-12) return 1;
    *t = (z - line->from[2]) / line->along[2];
    double x = line->from[0] + *t * line->along[0], y = line->from[1] + *t * line->along[1];
    n[0] = n[1] = 0, n[2] = sign;
    return x * x + y * y > radius * radius;
}

static void keep_lower_root(double t_new, const double *n_new, double *t, double *n) {
    if (t_new >= *t) return;
    *t = t_new;
    for (int k = 0; k < 3; k++) n[k] = n_new[k];
}

static int cylinder(const Obstacle *b, const Line *line, double *t, double *n) {
    double found = INFINITY, t_part, n_part[3];
    if (!intersect_side(b->sizes[0], b->sizes[1], line, &t_part, n_part)) keep_lower_root(t_part, n_part, &found, n);
    for (int end = -1; end <= 1; end += 2)
        if (!intersect_end(end * b->sizes[1], end, b->sizes[0], line, &t_part, n_part)) keep_lower_root(t_part, n_part, &found, n);
    *t = found;
    return isinf(found);
}

/* Intersect a line with a cone. Its tip is at the origin and it opens towards +z: radius sizes[0]
   at height sizes[1]. */
static int cone(const Obstacle *b, const Line *line, double *t, double *n) {
    const double wide = b->sizes[0] / b->sizes[1], *o = line->from, *d = line->along;
    const double w2 = wide * wide;
    double found = INFINITY, t_part, n_part[3];
    const double a = d[0] * d[0] + d[1] * d[1] - w2 * d[2] * d[2], h = o[0] * d[0] + o[1] * d[1] - w2 * o[2] * d[2];
    const double c = o[0] * o[0] + o[1] * o[1] - w2 * o[2] * o[2], inside = h * h - a * c;
    if (inside >= -LEVEL * h * h)
        for (int sign = -1; sign <= 1; sign += 2) {
            t_part = fabs(a) > 1e-14 ? (-h + sign * sqrt(max_of(inside, 0))) / a : -c / (2 * h);
            const double z = o[2] + t_part * d[2];
            if (!(z >= -TIP && z <= b->sizes[1])) continue; /* rounding puts a tip on either side */
            n_part[0] = o[0] + t_part * d[0], n_part[1] = o[1] + t_part * d[1], n_part[2] = -w2 * z;
            if (z < TIP) n_part[2] = -1;
            keep_lower_root(t_part, n_part, &found, n);
        }
    if (!intersect_end(b->sizes[1], 1, b->sizes[0], line, &t_part, n_part)) keep_lower_root(t_part, n_part, &found, n);
    *t = found;
    return isinf(found);
}

/* Intersect a line with all of `count` half-spaces n x <= d, rows (n, d): the last entry before the
   first exit. Four are processed together, without branches: a hull has a hundred. */
static int planes(const double *rows, long count, const Line *line, double *t, double *n) {
    double enter[LANES], leave[LANES], which[LANES], outside[LANES];
    const double *d = line->along, *o = line->from;
    for (int k = 0; k < LANES; k++) enter[k] = -INFINITY, leave[k] = INFINITY, which[k] = 0, outside[k] = 0;
    for (long first = 0; first < count; first += LANES) {
        double own[4 * LANES];
        const double *row = rows + 4 * first;
        if (first + LANES > count) { /* repeat the last plane */
            for (long i = 0; i < LANES; i++) memcpy(own + 4 * i, rows + 4 * (first + i < count ? first + i : count - 1), 4 * sizeof *own);
            row = own;
        }
        for (int k = 0; k < LANES; k++) {
            const double towards = row[4 * k] * d[0] + row[4 * k + 1] * d[1] + row[4 * k + 2] * d[2];
            const double left = row[4 * k + 3] - (row[4 * k] * o[0] + row[4 * k + 1] * o[1] + row[4 * k + 2] * o[2]);
            const double way = left / towards, in = towards < -LEVEL ? way : -INFINITY, out = towards > LEVEL ? way : INFINITY;
            outside[k] = fabs(towards) <= LEVEL ? min_of(outside[k], left) : outside[k];
            which[k] = in > enter[k] ? (double)first : which[k];
            enter[k] = in > enter[k] ? in : enter[k];
            leave[k] = out < leave[k] ? out : leave[k];
        }
    }
    int lane = 0;
    for (int k = 1; k < LANES; k++) {
        if (enter[k] > enter[lane]) lane = k;
        leave[0] = min_of(leave[0], leave[k]), outside[0] = min_of(outside[0], outside[k]);
    }
    const long last = (long)which[lane] + lane;
    for (int k = 0; k < 3; k++) n[k] = rows[4 * (last < count ? last : count - 1) + k];
    *t = enter[lane];
    return outside[0] < 0 || !(enter[lane] < leave[0]) || isinf(enter[lane]);
}

static int box(const Obstacle *b, const Line *line, double *t, double *n) {
    double rows[24] = {0};
    for (int k = 0; k < 6; k++) rows[4 * k + k / 2] = k % 2 ? 1 : -1, rows[4 * k + 3] = b->sizes[k / 2];
    return planes(rows, 6, line, t, n);
}

/* Intersect a line with z >= (k_x x^2 + k_y y^2) / 2 in the obstacle's frame. The sizes are k_x,
   k_y and the reach. */
static int quadric(const Obstacle *b, const Line *line, double *t, double *n) {
    const double kx = b->sizes[0], ky = b->sizes[1], *o = line->from, *d = line->along;
    const double a = (kx * d[0] * d[0] + ky * d[1] * d[1]) / 2, c = (kx * o[0] * o[0] + ky * o[1] * o[1]) / 2 - o[2];
    const double h = (kx * o[0] * d[0] + ky * o[1] * d[1] - d[2]) / 2;
    if (fabs(a) < 1e-12 * fabs(h)) *t = -c / (2 * h);
    else if (h * h < a * c) return 1;
    else *t = c / (-h + sqrt(h * h - a * c)); /* the root that exists without tilt */
    const double x = o[0] + *t * d[0], y = o[1] + *t * d[1];
    n[0] = kx * x, n[1] = ky * y, n[2] = -1;
    return !(x * x + y * y <= square(b->sizes[2]));
}

/* Return the distance to a flat disc of radius sizes[0] and half height sizes[1] whose rims are
   rounded by sizes[2]. The normal is in `n`. */
static double rounded_disc(const Obstacle *b, const double *x, double *n) {
    const double r = hypot(x[0], x[1]), round = b->sizes[2];
    const double across = r - (b->sizes[0] - b->sizes[2]), up = fabs(x[2]) - (b->sizes[1] - b->sizes[2]);
    const double out_r = max_of(across, 0), out_z = max_of(up, 0), out = hypot(out_r, out_z);
    const double radial = out > 0 ? out_r / out : across > up, axial = out > 0 ? out_z / out : !(across > up);
    n[0] = r > 0 ? radial * x[0] / r : 0, n[1] = r > 0 ? radial * x[1] / r : 0, n[2] = x[2] < 0 ? -axial : axial;
    return out + min_of(max_of(across, up), 0) - round;
}

/* Intersect a line with the disc. The distance along a line is convex: Newton steps from outside
   reach the surface and never pass it. */
static int disc(const Obstacle *b, const Line *line, double *t, double *n) {
    const double reach = b->sizes[0] + b->sizes[1];
    double x[3];
    *t = -dot3(line->from, line->along) - reach;
    for (int step = 0; step < MAX_APPROACHES; step++) {
        for (int k = 0; k < 3; k++) x[k] = line->from[k] + *t * line->along[k];
        const double left = rounded_disc(b, x, n), falls = -dot3(n, line->along);
        if (left < NEAR) return 0;
        if (falls <= 0) return 1;
        *t += left / falls;
        if (*t > -dot3(line->from, line->along) + reach) return 1;
    }
    return 1;
}

/* Find the lowest of the triangles (count, 3, 3), in the obstacle's frame, over the position. Frame
   S only without a rotation. */
static int triangles(const double *corners, long count, const Line *line, double *t, double *n) {
    double found = INFINITY;
    for (long i = 0; i < count; i++) {
        const double *a = corners + 9 * i;
        double e1[3], e2[3], from[3], normal[3];
        for (int k = 0; k < 3; k++) e1[k] = a[3 + k] - a[k], e2[k] = a[6 + k] - a[k], from[k] = line->from[k] - a[k];
        normal[0] = e1[1] * e2[2] - e1[2] * e2[1], normal[1] = e1[2] * e2[0] - e1[0] * e2[2];
        normal[2] = e1[0] * e2[1] - e1[1] * e2[0];
        const double *d = line->along, towards = dot3(normal, d);
        if (fabs(towards) < 1e-24) continue;
        const double q[3] = {from[1] * d[2] - from[2] * d[1], from[2] * d[0] - from[0] * d[2], from[0] * d[1] - from[1] * d[0]};
        const double u = -dot3(e2, q) / towards, v = dot3(e1, q) / towards;
        if (u < 0 || v < 0 || u + v > 1) continue;
        const double way = -dot3(normal, from) / towards;
        if (towards > 0)
            for (int k = 0; k < 3; k++) normal[k] = -normal[k];
        keep_lower_root(way, normal, &found, n);
    }
    *t = found;
    return isinf(found);
}

/* Interpolate heights at the membrane's own nodes bilinearly. Values that are not finite mean no
   obstacle. */
static int heights(const Membrane *membrane, const double *field, double x, double y, double *t, double slope[2]) {
    const double at_x = (x + membrane->numbers.length_x / 2) / membrane->dx, at_y = (y + membrane->numbers.length_y / 2) / membrane->dy;
    const long i = (long)clip(floor(at_x), 0, membrane->columns - 2), j = (long)clip(floor(at_y), 0, membrane->rows - 2);
    const double *here = field + i * membrane->rows + j, u = at_x - i, v = at_y - j;
    const double a = here[0], b = here[membrane->rows], c = here[1], d = here[membrane->rows + 1];
    if (!isfinite(a + b + c + d)) { /* next to an edge, use the nearest node */
        const double nearest = here[(u > 0.5) * membrane->rows + (v > 0.5)];
        *t = nearest, slope[0] = slope[1] = 0;
        return !isfinite(nearest);
    }
    *t = (1 - u) * ((1 - v) * a + v * c) + u * ((1 - v) * b + v * d);
    slope[0] = ((1 - v) * (b - a) + v * (d - c)) / membrane->dx, slope[1] = ((1 - u) * (c - a) + u * (d - b)) / membrane->dy;
    return 0;
}

/* Return the slope beyond which an obstacle counts as ended: at a flank that a membrane meets only
   at its edge, and at a rim whose radius is below the spacing. */
static double max_slope_of(const Membrane *membrane, const Obstacle *b) {
    switch ((int)b->kind) {
    case BODY_DISC: return b->sizes[2] < max_of(membrane->dx, membrane->dy) ? SHARP : INFINITY;
    case BODY_BOX: case BODY_CYLINDER: return FLANK;
    default: return INFINITY;
    }
}

int qs_obstacle_height(const Membrane *membrane, const Obstacle *b, const double *pool, double x, double y, double *height,
                     double slope[2]) {
    static const double origin[3] = {0};
    double t, n[3];
    const double out = membrane->numbers.half_thickness;
    const Line line = line_in_body(b, x, y);
    const double *own = pool ? pool + (long)b->first : 0;
    int missed, exact = 0; /* exact: `out` is already included */
    switch ((int)b->kind) {
    case BODY_SPHERE: missed = ball(origin, b->sizes[0] + out, &line, &t, n), exact = 1; break;
    case BODY_CAPSULE: missed = capsule(b, out, &line, &t, n), exact = 1; break;
    case BODY_ELLIPSOID: missed = ellipsoid(b, &line, &t, n); break;
    case BODY_CYLINDER: missed = cylinder(b, &line, &t, n); break;
    case BODY_BOX: missed = box(b, &line, &t, n); break;
    case BODY_QUADRIC: missed = quadric(b, &line, &t, n); break;
    case BODY_DISC: missed = disc(b, &line, &t, n); break;
    case BODY_CONE: missed = cone(b, &line, &t, n); break;
    case BODY_CONVEX: missed = planes(own, (long)b->number, &line, &t, n); break;
    case BODY_TRIANGLES: missed = triangles(own, (long)b->number, &line, &t, n); break;
    case BODY_PLANE: /* solid on the far side, for either direction of its normal */
        n[0] = n[1] = 0, n[2] = line.along[2] > 0 ? -1 : 1;
        t = -line.from[2] / line.along[2], missed = !isfinite(t);
        break;
    default: missed = heights(membrane, own, x, y, &t, slope);
        if (!missed) *height = t - out * qs_farther_along_z(slope);
        return missed;
    }
    if (missed || slopes_of(b, n, slope)) return 1;
    if (square(slope[0]) + square(slope[1]) > square(max_slope_of(membrane, b))) return 1;
    *height = exact ? t : t - out * qs_farther_along_z(slope);
    return 0;
}

int64_t qs_obstacle_heights(const double *numbers, int64_t bodies, const double *body, int64_t pooled, const double *pool, int64_t count,
                     const double *places, double *out) {
    (void)pooled;
    const Membrane membrane = qs_membrane(numbers, 0);
    for (long i = 0; i < count; i++) {
        out[i] = INFINITY;
        for (long k = 0; k < bodies; k++) {
            double height, slope[2];
            const Obstacle *one = (const Obstacle *)(body + k * QS_OBSTACLE);
            if (!qs_obstacle_height(&membrane, one, pool, places[2 * i], places[2 * i + 1], &height, slope))
                out[i] = min_of(out[i], height);
        }
    }
    return 0;
}
