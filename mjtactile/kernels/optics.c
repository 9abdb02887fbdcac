#include "optics.h"
#include "kernels.h"
#include "small_linalg.h"

#define STEPS 30
#define UNDISTORT_NEAR 1e-7  /* residual from which one more Newton step is exact to about 1e-13 */
#define ANGLE_STEPS 10
#define ANGLE_MAX 1.5  /* rad; start of the inverse of a fisheye */
#define ON_AXIS 1e-16  /* r^2 below which a fisheye is its own tangent to 1e-16 */

/* codes of core/lens.py; any other is the first */
enum { PLUMB_BOB, RATIONAL, EQUIDISTANT };

_Static_assert(sizeof(Camera) == CAMERA_NUMBERS * sizeof(double), "a camera has CAMERA_NUMBERS numbers");

int has_lens(const Camera *c) {
    int any = c->model == EQUIDISTANT;
    for (int i = 0; i < 8; i++) any |= c->k[i] != 0;
    return any;
}

static Lens plumb_bob(const Camera *c, double x, double y) {
    double k1 = c->k[0], k2 = c->k[1], p1 = c->k[2], p2 = c->k[3], k3 = c->k[4];
    double x2 = x * x, y2 = y * y, xy = x * y, r2 = x2 + y2;
    double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), slope = 2 * k1 + r2 * (4 * k2 + 6 * k3 * r2);
    Lens l = {x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x2), y * radial + p1 * (r2 + 2 * y2) + 2 * p2 * xy,
              radial + slope * x2 + 2 * p1 * y + 6 * p2 * x, slope * xy + 2 * p1 * x + 2 * p2 * y,
              radial + slope * y2 + 6 * p1 * y + 2 * p2 * x};
    return l;
}

static Lens rational(const Camera *c, double x, double y) {
    const double *k = c->k;
    double x2 = x * x, y2 = y * y, xy = x * y, r2 = x2 + y2, p1 = k[2], p2 = k[3];
    double below = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
    double scale = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / below;
    double above_slope = 2 * k[0] + r2 * (4 * k[1] + 6 * k[4] * r2), below_slope = 2 * k[5] + r2 * (4 * k[6] + 6 * k[7] * r2);
    double slope = (above_slope - scale * below_slope) / below;
    Lens l = {x * scale + 2 * p1 * xy + p2 * (r2 + 2 * x2), y * scale + p1 * (r2 + 2 * y2) + 2 * p2 * xy,
              scale + slope * x2 + 2 * p1 * y + 6 * p2 * x, slope * xy + 2 * p1 * x + 2 * p2 * y,
              scale + slope * y2 + 6 * p1 * y + 2 * p2 * x};
    return l;
}

/* image radius of a ray at `theta` to the axis, and its derivative */
static double distorted_angle(const double *k, double theta, double *by_theta) {
    double t2 = theta * theta;
    *by_theta = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
    return theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
}

static Lens equidistant(const Camera *c, double x, double y) {
    double r2 = x * x + y * y, scale = 1, slope = 2 * (c->k[0] - 1.0 / 3), by_theta;
    if (!(r2 < ON_AXIS)) {
        double r = sqrt(r2);
        scale = distorted_angle(c->k, atan(r), &by_theta) / r;
        slope = (by_theta / (1 + r2) - scale) / r2;
    }
    return (Lens){x * scale, y * scale, scale + slope * x * x, slope * x * y, scale + slope * y * y};
}

typedef Lens (*Model)(const Camera *c, double x, double y);

Lens distort(const Camera *c, double x, double y) {
    if (c->model == RATIONAL) return rational(c, x, y);
    if (c->model == EQUIDISTANT) return equidistant(c, x, y);
    return plumb_bob(c, x, y);
}

/* Invert `lens` by Newton's method, inlined for each model. */
static inline __attribute__((always_inline)) void invert(Model lens, const Camera *c, double x_d, double y_d, double *x, double *y) {
    double u, v, residual = INFINITY, det = 0;
    if (lens == equidistant) {
        double angle = hypot(x_d, y_d), theta = min_of(angle, ANGLE_MAX), by_theta;
        for (int i = 0; i < ANGLE_STEPS; i++) {
            double now = distorted_angle(c->k, theta, &by_theta);
            theta = max_of(0, min_of(theta - (now - angle) / by_theta, ANGLE_MAX));
        }
        double scale = angle > 0 ? tan(theta) / angle : 1;
        u = x_d * scale, v = y_d * scale;
    } else {
        Lens l = lens(c, x_d, y_d);
        u = 2 * x_d - l.x, v = 2 * y_d - l.y;
    }
    for (int i = 0; i < STEPS; i++) {
        Lens l = lens(c, u, v);
        double x_off = l.x - x_d, y_off = l.y - y_d;
        det = l.xx * l.yy - l.xy * l.xy;
        u -= (l.yy * x_off - l.xy * y_off) / det, v -= (l.xx * y_off - l.xy * x_off) / det;
        residual = max_of(fabs(x_off), fabs(y_off));
        if (!(residual > UNDISTORT_NEAR)) break;  /* the last step squares it */
    }
    int good = residual <= UNDISTORT_NEAR && det > 0 && isfinite(u) && isfinite(v);
    *x = good ? u : NAN, *y = good ? v : NAN;
}

void undistort(const Camera *c, double x_d, double y_d, double *x, double *y) {
    if (c->model == RATIONAL) invert(rational, c, x_d, y_d, x, y);
    else if (c->model == EQUIDISTANT) invert(equidistant, c, x_d, y_d, x, y);
    else invert(plumb_bob, c, x_d, y_d, x, y);
}

double glass_displacement(const Camera *c, double tan2) {
    double slower = c->index * c->index - 1;
    return c->thickness * (1 - 1 / sqrt(slower * tan2 + slower + 1));
}

void refract(const Camera *c, const double *p, double *x_out, double *y_out) {
    double t = c->thickness, n2 = c->index * c->index, z = p[2] > (t > 0 ? c->distance + t : 0) ? p[2] : NAN, scale = 1 / z;
    if (t != 0 && n2 != 1) {
        /* the paraxial solution */
        double rho = hypot(p[0], p[1]), x = rho / (z - t + t / c->index);
        for (int i = 0; i < STEPS; i++) {
            double root = 1 / sqrt(n2 + (n2 - 1) * x * x);
            double step = ((z - t + t * root) * x - rho) / (z - t + t * n2 * root * root * root);
            x -= step;
            if (!(fabs(step) > 1e-8 * (1 + x))) break;
        }
        if (rho > 0) scale = x / rho;
    }
    *x_out = p[0] * scale, *y_out = p[1] * scale;
}

void project(const Camera *c, const double *p, double *uv) {
    double x, y;
    refract(c, p, &x, &y);
    Lens l = has_lens(c) ? distort(c, x, y) : (Lens){x, y, 1, 0, 1};
    uv[0] = c->fx * l.x + c->cx, uv[1] = c->fy * l.y + c->cy;
}
