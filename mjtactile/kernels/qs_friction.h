/* State and inputs of a quasi-static membrane in a moving scene, and rotations of its frame. */
#ifndef MJTACTILE_QS_FRICTION_H
#define MJTACTILE_QS_FRICTION_H
#include <stdint.h>
#include "quasistatic.h"

#define QS_LEAST 1e-4   /* force below which nothing sticks, N */

/* State of a membrane between updates, all doubles. sim/sensor/quasistatic_gas.py has the
   indices. */
typedef struct {
    double touching;                /* number of bodies in contact */
    double wrench[6];               /* wrench on the membrane about the origin of S */
    double middle[3], radius, slides;
    double slid;                    /* sliding distance since first touch, m: bodies weighted by force */
    double near;                    /* number of near bodies */
    double status, lost, solved;    /* of the last solution; steps in a row without one */
    double lift;                    /* height by which the obstacles are raised for a solution, m */
    double pause;                   /* steps until the next attempt to find a solution */
    double uncertain;               /* extrapolated force, N, while there is no solution */
    double gripped;                 /* nodes of the sticking stiffness */
    double gas, sealed;             /* gas settings at the last solution */
    double time;                    /* time of the last update, s */
    double gas_observed, sealed_seen;   /* gas settings at the last update */
} Memory;

/* State of one MuJoCo body at the membrane, all doubles. A body is a set of bodies that are fixed
   to each other. */
typedef struct {
    double touching, near, known;   /* 1 in contact; near; with a pose of the last solution */
    double wrench[6];               /* wrench on the membrane about the origin of S */
    double middle[3], radius, slides;
    double shear[3];                /* load of the body on the membrane, N, N, N m */
    double gripped;                 /* its nodes of the sticking stiffness */
    double carried[6];              /* frictionless wrench of the last solution */
    /* stiffness against indentation by the tension, N/m; volume that the indentation displaces,
       m^3/m; stiffness with the gas, N/m */
    double tension, lifted, normal;
    double R[9], p[3];              /* pose at the last update */
    double R_rest[9], p_rest[3];    /* pose at the last solution */
    /* displacement of the body's origin, m, and rotation, rad, since the previous update */
    double moved[6];
} Patch;
#define QS_PATCH 57

/* Inputs: friction coefficient; stiffness of bulge and gas, Pa/m^3; time step, s; half width of the
   frame, m; spacing of nodes, m; time, s; reach of the membrane from the center of its frame, m. */
typedef struct { double friction, bulge, gas, step, half, spacing, time, reach; } Given;

/* Compute the 3 x 3 product A B, or A^T B. */
static inline void times(const double *A, const double *B, int transpose, double *out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 3; k++) sum += (transpose ? A[3 * k + i] : A[3 * i + k]) * B[3 * k + j];
            out[3 * i + j] = sum;
        }
}
static inline void into(const double *R, const double *v, double *out) { /* R^T v */
    for (int i = 0; i < 3; i++) out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}
static inline void outof(const double *R, const double *v, double *out) { /* R v */
    for (int i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}
static inline void across(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* Loads of the nodes in contact (2, count), N; displacements by which they lag behind their bodies
   (2, count), m; patch of each node at the last sticking stiffness, plus one; loads by unit motions of
   the patches (3 slots, 2, count); workspace for a list of nodes (count). */
typedef struct { const int32_t *patch; double *load, *lag, *unit; int32_t *node; } Held;

/* Return the position of a node in the plane, along x or y. */
static inline double qs_x_of(const Membrane *f, const double *x, long k) { return k / f->rows * f->dx - f->numbers.length_x / 2 + x[k]; }
static inline double qs_y_of(const Membrane *f, const double *x, long k) {
    return k % f->rows * f->dy - f->numbers.length_y / 2 + x[f->count + k];
}

/* Return component `c` of the rigid motions x, y and rotation of a point at `off` from the center. */
static inline double qs_rigid(int c, int axis, const double off[2]) { return c < 2 ? c == axis : axis ? off[0] : -off[1]; }

/* Compute the stiffness `grip` (3 slots, 3 slots) of the contact nodes against x, y and rotation of
   the patches about their centers, and their loads. The nodes of a patch move as one rigid set. A
   node joins the contact without a load: the others were displaced before. The others take over the
   loads of nodes that leave. Returns 1 if memory runs out. */
int qs_find_grip(const Membrane *f, const double *x, const double *compliance, long slots, double *grip, Held *h, Memory *m,
                     Patch *patches);

/* Move the patches by `along` (slots, 3) against the membrane, up to Coulomb's limit of each node for
   the forces `pressed` (slots). Return the sliding distance, m, of the mean of the patches weighted by
   force: parts of a soft body that are pressed apart slide in opposite directions. Returns -1 if
   memory runs out. */
double qs_apply_friction(const Membrane *f, const Given *g, const double *compliance, const double *x, const double *force, long slots,
                         const double *pressed, const double *along, Held *h, Patch *patches);

#endif
