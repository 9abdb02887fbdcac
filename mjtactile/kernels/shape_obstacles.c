/* Obstacles of parametric shapes (docs/theory/contact_shape.md). Positions are in mm from a guess,
   curvatures in 1/m. The shape approaches from +z, frame S. */
#include <math.h>
#include <string.h>

#include "kernels.h"
#include "quasistatic.h"
#include "small_linalg.h"

#define FLAT 0.2       /* curvature that is flat at the size of a sensor, 1/m */
#define RIM_SLOPE 2.0  /* slope of the flank beyond a rim */
#define RIM_OUT 1.4    /* outward offset of the rounded rim from the nominal rim, in rounding radii */
#define MIN_END 1e-3   /* minimum distance from a cylinder's position to its ends, m */
#define ALONG 1e-9     /* component of a direction below which it never meets a side */

enum { SMOOTH, BALL, CYLINDER, DISC, BLOCK };

typedef struct { double x, y, height, frame[2], round, rounding; } Guess;

static void rotate_about_z(double angle, double *R) {
    const double c = cos(angle), s = sin(angle), rows[9] = {c, -s, 0, s, c, 0, 0, 0, 1};
    memcpy(R, rows, sizeof rows);
}

/* An ellipsoid with the given lowest point and curvatures: exact for a ball, a lying cylinder and
   a plane. */
static void make_ellipsoid(const double *theta, Obstacle *body) {
    const double mean = (theta[3] + theta[5]) / 2, half = hypot((theta[3] - theta[5]) / 2, theta[4]);
    const double direction = fmod(0.5 * atan2(2 * theta[4], theta[3] - theta[5]) + PI / 2, PI);
    const double tall = 1 / max_of(mean + half, FLAT);
    body->kind = BODY_ELLIPSOID;
    body->sizes[0] = sqrt(tall / max_of(mean - half, FLAT)), body->sizes[1] = sqrt(tall / max_of(mean + half, FLAT));
    body->sizes[2] = tall, body->p[2] += tall;
    rotate_about_z(direction, body->R);
}

static void make_ball(const double *theta, Obstacle *body) {
    body->kind = BODY_SPHERE, body->sizes[0] = 1 / max_of(theta[3], FLAT), body->p[2] += body->sizes[0];
    rotate_about_z(0, body->R);
}

/* Distances backward and forward along a line to a rectangle with half-extents `frame`. */
static void to_rectangle(const double *frame, const double *at, const double *along, double ends[2]) {
    ends[0] = ends[1] = INFINITY;
    for (int axis = 0; axis < 2; axis++) {
        if (fabs(along[axis]) < ALONG) continue;
        const double ahead = along[axis] < 0 ? -at[axis] : at[axis];
        ends[0] = min_of(ends[0], (frame[axis] + ahead) / fabs(along[axis]));
        ends[1] = min_of(ends[1], (frame[axis] - ahead) / fabs(along[axis]));
    }
}

/* The same to an ellipse with half-axes `half`. */
static void to_ellipse(const double *half, const double *at, const double *along, double ends[2]) {
    double a = 0, b = 0, c = 1;
    for (int axis = 0; axis < 2; axis++) {
        const double from = at[axis] / half[axis], step = along[axis] / half[axis];
        a += step * step, b += from * step, c -= from * from;
    }
    const double root = sqrt(max_of(b * b + a * c, 0));
    ends[0] = (root + b) / a, ends[1] = (root - b) / a;
}

/* A lying cylinder that ends at the frame. */
static void make_cylinder(const double *theta, const Guess *guess, Obstacle *body) {
    const double cz = cos(theta[4]), sz = sin(theta[4]), cy = cos(theta[5]), sy = sin(theta[5]), radius = 1 / max_of(theta[3], FLAT);
    const double axis[3] = {cz * cy, sz * cy, -sy}, side[3] = {-sz, cz, 0}, up[3] = {cz * sy, sz * sy, cy};
    double ends[2];
    (guess->round != 0 ? to_ellipse : to_rectangle)(guess->frame, body->p, axis, ends);
    const double back = max_of(ends[0], MIN_END), forth = max_of(ends[1], MIN_END);
    body->kind = BODY_CYLINDER, body->sizes[0] = radius, body->sizes[1] = (back + forth) / 2;
    for (int k = 0; k < 3; k++) {
        body->p[k] += axis[k] * (forth - back) / 2 + up[k] * radius;
        body->R[3 * k] = side[k], body->R[3 * k + 1] = up[k], body->R[3 * k + 2] = axis[k];
    }
}

/* Return the rise of a rim's flank over its face, m: zero far inside, steep outside, rounded
   between. The membrane solution on a sharp rim changes in steps with the node positions. With a
   rounding of half a spacing it does not, and the fit converges from any start. */
static double flank(double distance, double rounding) {
    return RIM_SLOPE / 2 * (distance + sqrt(distance * distance + rounding * rounding));
}

/* Compute the heights of a tilted face with a rim, a disc or a block, at the nodes. */
static void make_face(int model, const double *theta, const Guess *guess, long columns, long rows, const double *x, const double *y,
                      Obstacle *body, double *heights) {
    const double out = RIM_OUT * guess->rounding, c = cos(theta[5]), s = sin(theta[5]), *at = body->p;
    for (long i = 0; i < columns; i++)
        for (long j = 0; j < rows; j++) {
            const double dx = x[i] - at[0], dy = y[j] - at[1];
            double height = at[2] + theta[3] * dy - theta[4] * dx;
            if (model == DISC) height += flank(sqrt(dx * dx + dy * dy) - 1e-3 * theta[5] - out, guess->rounding);
            else {
                height += flank(fabs(c * dx + s * dy) - 1e-3 * theta[6] - out, guess->rounding);
                height += flank(fabs(c * dy - s * dx) - 1e-3 * theta[7] - out, guess->rounding);
            }
            heights[i * rows + j] = height;
        }
    body->kind = BODY_HEIGHTS, body->sizes[0] = (double)columns, body->sizes[1] = (double)rows;
    body->p[0] = body->p[1] = body->p[2] = 0;
    rotate_about_z(0, body->R);
}

int64_t shape_obstacles(int64_t model, int64_t count, int64_t parameters, const double *theta, const double *guess, int64_t columns,
                        int64_t rows, const double *x, const double *y, double *obstacles, double *heights) {
    static const int64_t needed[] = {6, 4, 6, 6, 8};
    if (model < SMOOTH || model > BLOCK || parameters != needed[model]) return REFUSED;
    if (model >= DISC && !heights) return REFUSED;
    const Guess *from = (const Guess *)guess;
    memset(obstacles, 0, (size_t)count * QS_OBSTACLE * sizeof *obstacles);
    for (int64_t a = 0; a < count; a++) {
        const double *here = theta + a * parameters;
        Obstacle *body = (Obstacle *)(obstacles + a * QS_OBSTACLE);
        body->p[0] = from->x + 1e-3 * here[0], body->p[1] = from->y + 1e-3 * here[1], body->p[2] = from->height + 1e-3 * here[2];
        if (model >= DISC) {
            make_face((int)model, here, from, columns, rows, x, y, body, heights + a * columns * rows);
            body->first = (double)(a * columns * rows), body->number = (double)(columns * rows);
            body->min_width = body->reach = INFINITY;
            continue;
        }
        if (model == SMOOTH) make_ellipsoid(here, body);
        else if (model == BALL) make_ball(here, body);
        else make_cylinder(here, from, body);
        body->min_width = 2 * (model == BALL ? body->sizes[0] : min_of(body->sizes[0], body->sizes[1]));
        body->reach = body->sizes[0] + body->sizes[1] + body->sizes[2];
    }
    return 0;
}
