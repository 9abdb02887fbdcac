#include "optics.h"
#include "small_linalg.h"

#define STEPS 30
#define UNDISTORT_NEAR 1e-7  /* residual from which one more Newton step is exact to about 1e-13 */

int has_lens(const Camera *c) { return c->k1 != 0 || c->k2 != 0 || c->p1 != 0 || c->p2 != 0 || c->k3 != 0; }

Lens distort(const Camera *c, double x, double y) {
    double x2 = x * x, y2 = y * y, xy = x * y, r2 = x2 + y2;
    double radial = 1 + r2 * (c->k1 + r2 * (c->k2 + r2 * c->k3)), slope = 2 * c->k1 + r2 * (4 * c->k2 + 6 * c->k3 * r2);
    Lens l = {x * radial + 2 * c->p1 * xy + c->p2 * (r2 + 2 * x2), y * radial + c->p1 * (r2 + 2 * y2) + 2 * c->p2 * xy,
              radial + slope * x2 + 2 * c->p1 * y + 6 * c->p2 * x, slope * xy + 2 * c->p1 * x + 2 * c->p2 * y,
              radial + slope * y2 + 6 * c->p1 * y + 2 * c->p2 * x};
    return l;
}

void undistort(const Camera *c, double x_d, double y_d, double *x, double *y) {
    Lens l = distort(c, x_d, y_d);
    double u = 2 * x_d - l.x, v = 2 * y_d - l.y, residual = INFINITY, det = 0;
    for (int i = 0; i < STEPS; i++) {
        l = distort(c, u, v);
        double x_off = l.x - x_d, y_off = l.y - y_d;
        det = l.xx * l.yy - l.xy * l.xy;
        u -= (l.yy * x_off - l.xy * y_off) / det, v -= (l.xx * y_off - l.xy * x_off) / det;
        residual = most(fabs(x_off), fabs(y_off));
        if (!(residual > UNDISTORT_NEAR)) break;  /* the last step squares it */
    }
    int good = residual <= UNDISTORT_NEAR && det > 0 && isfinite(u) && isfinite(v);
    *x = good ? u : NAN, *y = good ? v : NAN;
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
