/* Circle poses with covariance from ellipses. Equations: docstrings of sensing/pose/circles.py. */
#include <string.h>

#include "kernels.h"
#include "optics.h"
#include "small_linalg.h"

/* points on an ellipse's boundary: at least five are needed; lens and glass add only few
   harmonics */
#define POINTS 8
/* tilt, rad, below which the normal's derivative vanishes and only its bound remains */
#define MIN_TILT 1e-3
#define FIT_STEPS 30
/* tolerance of a conic's coefficients; the error after such a step is 1e-10 */
#define FIT_TOLERANCE 1e-8
/* for (a - b) / a below this, the angle is meaningless; the floor keeps its variance finite */
#define ROUND 1e-6

typedef struct { double c[POINTS], s[POINTS]; } Circle;
typedef struct { double x[POINTS], y[POINTS]; } Boundary;
/* (x, y) as combinations of (1, cos, sin) */
typedef struct { double x0, xa, xb, y0, ya, yb; } Affine;
typedef struct { double p[3], n[3]; } Pose;

static Circle unit_circle(void) {
    Circle e;
    for (int k = 0; k < POINTS; k++) e.c[k] = cos(2 * PI * k / POINTS), e.s[k] = sin(2 * PI * k / POINTS);
    return e;
}

/* Compute the cone Q (3, 3) of the conic a u^2 + 2 b u v + c v^2 + 2 e u + 2 f v = 1. The map `m`
   takes its coordinates (u, v) to (x, y). */
static void cone(const Affine *m, const double *conic, double Q[3][3]) {
    double over = 1 / (m->xa * m->yb - m->xb * m->ya);
    double U[3] = {m->yb * over, -m->xb * over, 0}, V[3] = {-m->ya * over, m->xa * over, 0};
    U[2] = -(U[0] * m->x0 + U[1] * m->y0), V[2] = -(V[0] * m->x0 + V[1] * m->y0);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            Q[i][j] = U[i] * (conic[0] * U[j] + conic[1] * V[j]) + V[i] * (conic[1] * U[j] + conic[2] * V[j]);
    for (int i = 0; i < 3; i++) {
        double linear = conic[3] * U[i] + conic[4] * V[i];
        Q[i][2] += linear, Q[2][i] += linear;
    }
    Q[2][2] -= 1;
}

/* Fit an affine map to the boundary points, and compute their cone Q. In the map's coordinates, the
   points are nearly on the unit circle. The least squares of the conic are solved iteratively with
   those of the circle, whose harmonics are orthogonal, applied to the remaining residuals. */
static Affine fit_cone(const Circle *e, const Boundary *b, double Q[3][3]) {
    Affine m = {0};
    double u[POINTS], v[POINTS], conic[5] = {1, 0, 1, 0, 0};
    for (int k = 0; k < POINTS; k++) {
        m.x0 += b->x[k] / POINTS, m.xa += 2 * e->c[k] * b->x[k] / POINTS, m.xb += 2 * e->s[k] * b->x[k] / POINTS;
        m.y0 += b->y[k] / POINTS, m.ya += 2 * e->c[k] * b->y[k] / POINTS, m.yb += 2 * e->s[k] * b->y[k] / POINTS;
    }
    double over = 1 / (m.xa * m.yb - m.xb * m.ya);
    for (int k = 0; k < POINTS; k++) {
        double dx = b->x[k] - m.x0, dy = b->y[k] - m.y0;
        u[k] = (m.yb * dx - m.xb * dy) * over, v[k] = (m.xa * dy - m.ya * dx) * over;
    }
    for (int i = 0; i < FIT_STEPS; i++) {
        double mean = 0, c1 = 0, s1 = 0, c2 = 0, s2 = 0;
        for (int k = 0; k < POINTS; k++) {
            double left = conic[0] * u[k] * u[k] + 2 * conic[1] * u[k] * v[k] + conic[2] * v[k] * v[k]
                          + 2 * conic[3] * u[k] + 2 * conic[4] * v[k] - 1;
            double c = e->c[k], s = e->s[k];
            mean += left, c1 += left * c, s1 += left * s, c2 += left * (c * c - s * s), s2 += left * 2 * s * c;
        }
        mean /= POINTS, c1 /= POINTS, s1 /= POINTS, c2 *= 2.0 / POINTS, s2 *= 2.0 / POINTS;
        double step[5] = {mean + c2, s2, mean - c2, c1, s1}, largest = 0;
        for (int j = 0; j < 5; j++) conic[j] -= step[j], largest = max_of(fabs(step[j]), largest);
        if (!(largest > FIT_TOLERANCE)) break;
    }
    cone(&m, conic, Q);
    return m;
}

/* Compute both circles of radius r on the cone in closed form. The eigenvalue l3 is the
   trigonometric solution of the cubic (Smith, Comm. ACM 4(4), 1961). This is accurate for the one
   that is well separated. The others follow from the 2 x 2 problem in the plane perpendicular to
   v3. */
static void both_circles(double Q[3][3], double r, Pose *out) {
    double a = Q[0][0], b = Q[0][1], d = Q[0][2], c = Q[1][1], e = Q[1][2], f = Q[2][2], third = (a + c + f) / 3;
    double A = a - third, C = c - third, F = f - third;
    double size = sqrt((A * A + C * C + F * F + 2 * (b * b + d * d + e * e)) / 6);
    double half_det = (A * (C * F - e * e) - b * (b * F - d * e) + d * (b * e - d * C)) / (2 * size * size * size);
    double l3 = third + 2 * size * cos(acos(clip(half_det, -1, 1)) / 3 + 2 * PI / 3);
    A = a - l3, C = c - l3;
    double x = b * e - d * C, y = b * d - A * e, z = A * C - b * b, over = 1 / sqrt(x * x + y * y + z * z);
    x *= over, y *= over, z *= over;
    /* Rayleigh quotient */
    double off = A * x * x + C * y * y + (f - l3) * z * z + 2 * (b * x * y + d * x * z + e * y * z);
    l3 += off, A -= off, C -= off;
    /* u and w are perpendicular to v3 (geometry.tangents). Q - l3 I vanishes along v3. Its block
       [[A, b], [b, C]] therefore acts on (u_x, u_y) - (u_z / z) (x, y), which is (1, 0) + h x
       (x, y). For w it is (0, 1) + h y (x, y). */
    double h = 1 / (z * (1 + z)), g = 1 + h * x * x, hh = h * x * y, k = 1 + h * y * y;
    double t = A * g + b * hh, s = A * hh + b * k, v = b * hh + C * k;
    double uu = g * t + hh * (b * g + C * hh), uw = g * s + hh * v, ww = hh * s + k * v;
    double mean = (uu + ww) / 2, half = (uu - ww) / 2, spread = sqrt(half * half + uw * uw), l1 = mean + spread + l3;
    double sine = sqrt(2 * spread / (mean + spread)), cosine = sqrt((mean - spread) / (mean + spread));
    double turn = 0.5 * atan2(uw, half), cu = cos(turn), cw = sin(turn), j = -(cu * x + cw * y) / (1 + z);
    double v1[3] = {cu + j * x, cw + j * y, -(cu * x + cw * y)}, v3[3] = {x, y, z};
    double ratio = sqrt(-l3 / l1), along1 = r * ratio * sine, along3 = r / ratio * cosine;
    for (int i = 0; i < 3; i++) {
        out[0].p[i] = along3 * v3[i] + along1 * v1[i], out[1].p[i] = along3 * v3[i] - along1 * v1[i];
        out[0].n[i] = sine * v1[i] - cosine * v3[i], out[1].n[i] = -sine * v1[i] - cosine * v3[i];
    }
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Compute a pose behind the glass from `pose`, which is the pose without glass. The glass shifts
   each ray along z by its own amount. Relative to a center of projection with the mean shift, each
   boundary point is rescaled by the ratio of its depths. */
static Pose through_glass(const Camera *camera, const Circle *e, const Boundary *b, const Pose *pose, double r) {
    double shift[POINTS], middle = 0, away = dot(pose->n, pose->p), Q[3][3];
    Boundary seen;
    Pose both[2];
    for (int k = 0; k < POINTS; k++) {
        shift[k] = glass_displacement(camera, b->x[k] * b->x[k] + b->y[k] * b->y[k]);
        middle += shift[k] / POINTS;
    }
    for (int k = 0; k < POINTS; k++) {
        double towards = pose->n[0] * b->x[k] + pose->n[1] * b->y[k] + pose->n[2];
        double scale = 1 + (middle - shift[k]) * (towards / away);
        seen.x[k] = b->x[k] * scale, seen.y[k] = b->y[k] * scale;
    }
    fit_cone(e, &seen, Q);
    both_circles(Q, r, both);
    /* the signs of the eigenvectors are arbitrary: the refit may return the two solutions in the
       other order */
    Pose same = both[dot(both[1].n, pose->n) > dot(both[0].n, pose->n)];
    same.p[2] += middle;
    return same;
}

/* Copy the normal to `n`. A normal exactly face-on is tilted, because there the ellipse does not
   change with the tilt. */
static void tilted(const Pose *pose, double *n) {
    double far = sqrt(dot(pose->p, pose->p)), view[3];
    memcpy(n, pose->n, 3 * sizeof *n);
    if (!(-dot(pose->n, pose->p) > cos(MIN_TILT) * far)) return;
    for (int i = 0; i < 3; i++) view[i] = pose->p[i] / far;
    double sign = copysign(1, view[2]), a = -1 / (sign + view[2]);
    double tangent[3] = {1 + sign * view[0] * view[0] * a, sign * view[0] * view[1] * a, -sign * view[0]};
    for (int i = 0; i < 3; i++) n[i] = MIN_TILT * tangent[i] - view[i];
}

/* Solve A X = B for X in place of B (5, m), by Gaussian elimination with pivoting. */
static void solve5(double A[5][5], double B[5][5], int m) {
    for (int j = 0; j < 5; j++) {
        int best = j;
        for (int i = j + 1; i < 5; i++)
            if (fabs(A[i][j]) > fabs(A[best][j])) best = i;
        for (int k = 0; k < 5; k++) {
            double held = A[j][k];
            A[j][k] = A[best][k], A[best][k] = held;
            held = B[j][k], B[j][k] = B[best][k], B[best][k] = held;
        }
        for (int i = j + 1; i < 5; i++) {
            double factor = A[i][j] / A[j][j];
            for (int k = j; k < 5; k++) A[i][k] -= factor * A[j][k];
            for (int k = 0; k < m; k++) B[i][k] -= factor * B[j][k];
        }
    }
    for (int i = 4; i >= 0; i--)
        for (int k = 0; k < m; k++) {
            for (int j = i + 1; j < 5; j++) B[i][k] -= A[i][j] * B[j][k];
            B[i][k] /= A[i][i];
        }
}

/* Compute derivatives G (`parts`, 5) of the pose by the ellipse's (u, v, a, b, angle). The pose is
   the center, m, and (n_x, n_y) at fixed n_z; G has the first `parts` of these. It is the inverse
   of the derivatives of the ellipse by the pose.

   Let e be the points of the unit circle. A change of the ellipse moves the boundary by e . w + e^T
   V e, in units of the local radius. A change of the pose has the same form. The lens enters by its
   derivative at the center. */
static void derivative(const Camera *camera, const Circle *e, const Boundary *bound, const Affine *m, const Pose *pose,
                       double a, double b, double angle, int parts, double G[5][5]) {
    double n[3], c = cos(angle), s = sin(angle), pz = pose->p[2], D[5][5] = {{0}}, X[5][5] = {{0}};
    tilted(pose, n);
    const double *p = pose->p;
    if (camera->thickness != 0) pz -= glass_displacement(camera, (p[0] * p[0] + p[1] * p[1]) / (p[2] * p[2]));
    /* change of e for a change of (u, v) by one pixel */
    double du[2][2] = {{c / a, -s / b}, {s / a, c / b}};
    Lens lens = distort(camera, m->x0, m->y0);
    double by_x[2], by_y[2];
    for (int i = 0; i < 2; i++) {
        by_x[i] = camera->fx * lens.xx * du[0][i] + camera->fy * lens.xy * du[1][i];
        by_y[i] = camera->fx * lens.xy * du[0][i] + camera->fy * lens.yy * du[1][i];
    }
    for (int k = 0; k < POINTS; k++) {
        double x = bound->x[k], y = bound->y[k], ec = e->c[k], es = e->s[k];
        double mx = ec * by_x[0] + es * by_x[1], my = ec * by_y[0] + es * by_y[1], mz = -(mx * x + my * y);
        /* 1 / depth */
        double over = (n[0] * x + n[1] * y + n[2]) / (n[0] * p[0] + n[1] * p[1] + n[2] * pz);
        /* motion of the boundary along the normal, over depth */
        double along = mx * n[0] + my * n[1] + mz * n[2];
        double moved[5] = {mx * over, my * over, mz * over, along * (x - p[0] * over), along * (y - p[1] * over)};
        /* weights of a point's motion in (w, V) */
        double cc = (ec * ec - es * es) * 2 / POINTS, ss = 2 * ec * es * 2 / POINTS;
        double to[5] = {2 * ec / POINTS, 2 * es / POINTS, 1.0 / POINTS + cc, 1.0 / POINTS - cc, ss};
        for (int i = 0; i < 5; i++)
            for (int j = 0; j < 5; j++) D[j][i] += to[i] * moved[j];  /* transposed */
    }
    for (int i = 0; i < parts; i++) X[i][i] = 1;
    solve5(D, X, parts);  /* X^T: the first rows of D^-1 */
    double turn = max_of(a - b, ROUND * a) * (a + b) / (2 * a * b);
    for (int i = 0; i < parts; i++) {
        G[i][0] = X[0][i] * du[0][0] + X[1][i] * du[0][1], G[i][1] = X[0][i] * du[1][0] + X[1][i] * du[1][1];
        G[i][2] = X[2][i] / a, G[i][3] = X[3][i] / b, G[i][4] = X[4][i] * turn;
    }
}

/* Compute an ellipse's boundary in ideal coordinates, the affine map that approximates it, and its
   cone. */
static Affine linearize(const Camera *camera, const Circle *e, const double *center, double axes[2][2], Boundary *b, double Q[3][3]) {
    if (has_lens(camera)) {
        for (int k = 0; k < POINTS; k++) {
            double u = center[0] + axes[0][0] * e->c[k] + axes[0][1] * e->s[k];
            double v = center[1] + axes[1][0] * e->c[k] + axes[1][1] * e->s[k];
            undistort(camera, (u - camera->cx) / camera->fx, (v - camera->cy) / camera->fy, b->x + k, b->y + k);
        }
        return fit_cone(e, b, Q);
    }
    const double circle[5] = {1, 0, 1, 0, 0};
    Affine m = {(center[0] - camera->cx) / camera->fx, axes[0][0] / camera->fx, axes[0][1] / camera->fx,
                (center[1] - camera->cy) / camera->fy, axes[1][0] / camera->fy, axes[1][1] / camera->fy};
    for (int k = 0; k < POINTS; k++) {
        b->x[k] = m.x0 + m.xa * e->c[k] + m.xb * e->s[k];
        b->y[k] = m.y0 + m.ya * e->c[k] + m.yb * e->s[k];
    }
    cone(&m, circle, Q);
    return m;
}

void circle_poses(int64_t n, const double *centers, const double *semi_axes, const double *angles, const double *covs,
                     const double *radii, const double *camera_, double *uv, double *poses, double *cov_p) {
    Camera camera;
    Circle e = unit_circle();
    memcpy(&camera, camera_, sizeof camera);
    for (int64_t i = 0; i < n; i++) {
        double a = semi_axes[2 * i], b = semi_axes[2 * i + 1], c = cos(angles[i]), s = sin(angles[i]), Q[3][3], G[5][5];
        double axes[2][2] = {{a * c, -b * s}, {a * s, b * c}};
        Boundary bound;
        Pose both[2];
        Affine m = linearize(&camera, &e, centers + 2 * i, axes, &bound, Q);
        both_circles(Q, radii[i], both);
        if (camera.thickness != 0)
            for (int k = 0; k < 2; k++) both[k] = through_glass(&camera, &e, &bound, both + k, radii[i]);
        int first = both[1].n[2] < both[0].n[2];  /* the pose more face-on to the camera axis */
        for (int k = 0; k < 3; k++) {
            poses[3 * i + k] = both[first].p[k], poses[3 * (n + i) + k] = both[first].n[k];
            poses[3 * (2 * n + i) + k] = both[1 - first].p[k], poses[3 * (3 * n + i) + k] = both[1 - first].n[k];
        }
        derivative(&camera, &e, &bound, &m, both + first, a, b, angles[i], 3, G);
        sandwich5(G, covs + 25 * i, 3, cov_p + 9 * i);
        project(&camera, both[first].p, uv + 2 * i);
    }
}

void circle_covariances(int64_t n, const double *centers, const double *semi_axes, const double *angles, const double *covs,
                           const double *p, const double *normals, const double *camera_, double *out) {
    Camera camera;
    Circle e = unit_circle();
    memcpy(&camera, camera_, sizeof camera);
    for (int64_t i = 0; i < n; i++) {
        double a = semi_axes[2 * i], b = semi_axes[2 * i + 1], c = cos(angles[i]), s = sin(angles[i]), Q[3][3], G[5][5];
        double axes[2][2] = {{a * c, -b * s}, {a * s, b * c}};
        Boundary bound;
        Pose pose;
        memcpy(pose.p, p + 3 * i, sizeof pose.p), memcpy(pose.n, normals + 3 * i, sizeof pose.n);
        Affine m = linearize(&camera, &e, centers + 2 * i, axes, &bound, Q);
        derivative(&camera, &e, &bound, &m, &pose, a, b, angles[i], 5, G);
        sandwich5(G, covs + 25 * i, 5, out + 25 * i);
    }
}

void cones(int64_t n, const double *centers, const double *shapes, const double *camera_, double *out) {
    Camera camera;
    Circle e = unit_circle();
    memcpy(&camera, camera_, sizeof camera);
    for (int64_t i = 0; i < n; i++) {
        double axes[2][2] = {{shapes[3 * i], shapes[3 * i + 1]}, {shapes[3 * i + 1], shapes[3 * i + 2]}}, Q[3][3];
        Boundary bound;
        linearize(&camera, &e, centers + 2 * i, axes, &bound, Q);
        memcpy(out + 9 * i, Q, sizeof Q);
    }
}

void circles_on_cones(int64_t n, const double *Q, const double *radii, double *poses) {
    for (int64_t i = 0; i < n; i++) {
        Pose both[2];
        double own[3][3];
        memcpy(own, Q + 9 * i, sizeof own);
        both_circles(own, radii[i], both);
        for (int k = 0; k < 2; k++) {
            memcpy(poses + 3 * (k * n + i), both[k].p, 3 * sizeof(double));
            memcpy(poses + 3 * ((2 + k) * n + i), both[k].n, 3 * sizeof(double));
        }
    }
}
