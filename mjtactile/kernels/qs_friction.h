/* What is remembered of a film in a scene that moves, what it is given, and turns of its frame. */
#ifndef MJTACTILE_FILM_HOLD_H
#define MJTACTILE_FILM_HOLD_H

/* What is remembered, all of it doubles; film_memory.py knows the places. */
typedef struct {
    double body;                    /* that touches, plus one; 0: nothing does */
    double wrench[6];               /* of it on the film about the origin of S */
    double middle[3], radius, slides;
    double strain[3], shear[3];     /* m, m, rad; N, N, N m of the body on the film */
    double near, status, lost, solved;
    double grip[9], gripped, normal;
    double R[9], p[3];              /* of the body at the last look */
    double R_rest[9], p_rest[3];    /* and at the last solution */
    double gas, sealed;             /* of that */
    double moved[6];                /* m of the body's origin and rad, since the look before */
    double time;                    /* s, of the last look */
    double slid;                    /* m over the film since it touched */
    double gas_observed, sealed_seen;   /* at the last look */
} Memory;

/* Given: friction, Pa/m^3 of bulge and gas, time step s, half width of the frame m, spacing of
   nodes m, time s, how far the film reaches from the middle of its frame m. */
typedef struct { double friction, bulge, gas, step, half, spacing, time, reach; } Given;

static inline void times(const double *A, const double *B, int transpose, double *out) { /* 3 x 3; A^T B */
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
