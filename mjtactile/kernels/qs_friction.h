/* State and inputs of a quasi-static membrane in a moving scene, and rotations of its frame. */
#ifndef MJTACTILE_QS_FRICTION_H
#define MJTACTILE_QS_FRICTION_H

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

#endif
