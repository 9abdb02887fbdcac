/* Forces of membranes on MuJoCo's degrees of freedom in a moving scene, and stiffness with which
   they hold free bodies. Frame S unless a name contains W. */
#include <math.h>
#include <string.h>

#include "qs_friction.h"
#include "kernels.h"
#include "small_linalg.h"

#define TILT 0.25       /* tilt stiffness over stiffness times radius^2: a disc on an even bed */
/* fraction of stiffness times step that damps a free body; from 0.5 on, every step is stable, but a
   heavy body oscillates on */
#define SHARE 0.75
/* stiffness of parts of one object that move against each other side by side, over that of a part alone:
   they take over each other's load. Overlapping ellipsoids have 5 to 75; twice this value slows the grip's
   response, and hardly reduces the oscillation further */
#define SIDE_BY_SIDE 16
#define HOLD 43 /* numbers of a hold */
enum { JOINT_FREE, JOINT_BALL, JOINT_SLIDE, JOINT_HINGE };

/* Add the generalized force of a force and a torque, frame W, at `at` on a MuJoCo body to `out`. */
static void apply(long body, double sign, const double *F, const double *T, const double *at, const int32_t *parent, const int32_t *joints,
                  const int32_t *first, const int32_t *type, const int32_t *dof, const double *anchor, const double *axis,
                  const double *xpos, const double *xmat, double *out) {
    for (; body > 0; body = parent[body])
        for (long j = first[body]; j < first[body] + joints[body]; j++) {
            double arm[3], turn[3], local[3];
            const double *from = type[j] == JOINT_FREE ? xpos + 3 * body : anchor + 3 * j;
            for (int i = 0; i < 3; i++) arm[i] = at[i] - from[i];
            across(arm, F, turn);
            for (int i = 0; i < 3; i++) turn[i] += T[i];
            double *here = out + dof[j];
            if (type[j] == JOINT_FREE)
                for (int i = 0; i < 3; i++) *here++ += sign * F[i];
            if (type[j] <= JOINT_BALL) {
                into(xmat + 9 * body, turn, local);
                for (int i = 0; i < 3; i++) here[i] += sign * local[i];
            } else {
                const double *v = type[j] == JOINT_SLIDE ? F : turn, *a = axis + 3 * j;
                *here += sign * (a[0] * v[0] + a[1] * v[1] + a[2] * v[2]);
            }
        }
}

/* Compute the stiffness K of a patch for displacements along, and rotations about, the axes of S. */
static void stiffness_of(const Given *g, const Patch *m, const double *grip, long wide, double K[6]) {
    const double tilt = TILT * m->normal * square(max_of(m->radius, g->spacing / 4));
    K[0] = K[1] = 0, K[2] = m->normal, K[3] = K[4] = K[5] = tilt;
    if (!m->slides && m->gripped > 0) K[0] = grip[0], K[1] = grip[wide + 1], K[5] = grip[2 * wide + 2];
}

/* Add the damping of the joint axes between a body in contact and the body `carried` that has the free
   joint. These joints move parts of the object against each other, so their own velocity is damped. */
static void damp_joints(long body, long carried, const double K[6], double step, const double *R, const double *at, const int32_t *parent,
                        const int32_t *joints, const int32_t *first, const int32_t *type, const int32_t *dof, const double *anchor,
                        const double *axis, const double *xmat, double *out) {
    for (; body > 0 && body != carried; body = parent[body])
        for (long j = first[body]; j < first[body] + joints[body]; j++) {
            const long axes = type[j] == JOINT_BALL ? 3 : 1;
            for (long n = 0; n < axes; n++) {
                double a[3], arm[3], moves[6] = {0}, turned[3];
                for (int i = 0; i < 3; i++) a[i] = axes == 3 ? xmat[9 * body + 3 * i + n] : axis[3 * j + i];
                if (type[j] == JOINT_SLIDE) {
                    into(R, a, moves);
                } else {
                    for (int i = 0; i < 3; i++) arm[i] = at[i] - anchor[3 * j + i];
                    across(a, arm, turned);
                    into(R, turned, moves), into(R, a, moves + 3);
                }
                for (int i = 0; i < 6; i++) out[dof[j] + n] += SHARE * step * K[i] * square(moves[i]);
            }
        }
}

/* Compute the stiffness G^T K G of the hold on the body in contact, in the degrees of freedom of
   the free joint that carries it. Also compute their velocity relative to the membrane. `R_SB`,
   `p_SB`: pose of that joint's body; the body in contact is assumed to move with it. `K`: stiffness
   of the patch. */
static void joint_stiffness(const Given *g, const Patch *m, const double K[6], long dof, const double *R_SB, const double *p_SB,
                            double *hold, const double *R) {
    double G[36] = {0}, r[3], off[3], swing[3], moved[3];
    for (int i = 0; i < 3; i++) r[i] = m->middle[i] - p_SB[i], off[i] = p_SB[i] - m->p[i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) G[6 * i + j] = R[3 * j + i], G[6 * (3 + i) + 3 + j] = R_SB[3 * i + j];
    for (int j = 0; j < 3; j++) { /* v = v_o + w x r, w = R_SB w_B */
        const double w[3] = {R_SB[j], R_SB[3 + j], R_SB[6 + j]};
        double v[3];
        across(w, r, v);
        for (int i = 0; i < 3; i++) G[6 * i + 3 + j] = v[i];
    }
    hold[0] = (double)(dof + 1);
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 6; b++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += G[6 * k + a] * K[k] * G[6 * k + b];
            hold[1 + 6 * a + b] = sum;
        }
    across(m->moved + 3, off, swing);
    for (int i = 0; i < 3; i++) moved[i] = m->moved[i] + swing[i];
    outof(R, moved, hold + 37), into(R_SB, m->moved + 3, hold + 40);
    for (int i = 0; i < 6; i++) hold[37 + i] /= g->step;
}

/* Return the body with the free joint: `body` itself, or one to which it is jointed; 0 if there is none. */
static long free_body(long body, const int32_t *parent, const int32_t *joints, const int32_t *first, const int32_t *type) {
    while (body > 0 && !(joints[body] == 1 && type[first[body]] == JOINT_FREE)) body = parent[body];
    return body;
}

int64_t qs_push(const double *given, int64_t slots, const double *patch, const int64_t *body_of, const double *grip, int64_t carrier,
                int64_t nbody, const int32_t *parent, const int32_t *joints, const int32_t *first, int64_t njnt, const int32_t *type,
                const int32_t *dof, const double *anchor, const double *axis, const double *xpos, const double *xmat, int64_t nv,
                double *push, double *holds) {
    const Given *g = (const Given *)given;
    const double *R = xmat + 9 * carrier;
    int64_t pushes = 0;
    (void)nbody, (void)njnt;
    memset(push, 0, 2 * nv * sizeof *push);
    for (long s = 0; s < slots; s++) {
        const Patch *m = (const Patch *)patch + s;
        double *hold = holds + HOLD * s;
        hold[0] = 0;
        if (!m->touching) continue;
        pushes = 1;
        const long body = body_of[s];
        double F[3], T[3], at[3], turn[3], local[3];
        across(m->middle, m->wrench, turn);
        for (int i = 0; i < 3; i++) local[i] = m->wrench[3 + i] - turn[i];
        outof(R, m->wrench, F), outof(R, local, T), outof(R, m->middle, at);
        for (int i = 0; i < 3; i++) at[i] += xpos[3 * carrier + i];
        apply(carrier, 1, F, T, at, parent, joints, first, type, dof, anchor, axis, xpos, xmat, push);
        apply(body, -1, F, T, at, parent, joints, first, type, dof, anchor, axis, xpos, xmat, push);
        const long carried = free_body(body, parent, joints, first, type);
        if (carried <= 0) continue;
        double R_SB[9], p_SB[3], offset[3];
        times(R, xmat + 9 * carried, 1, R_SB);
        for (int i = 0; i < 3; i++) offset[i] = xpos[3 * carried + i] - xpos[3 * carrier + i];
        into(R, offset, p_SB);
        double K[6];
        stiffness_of(g, m, grip + 9 * slots * s + 3 * s, 3 * slots, K);
        joint_stiffness(g, m, K, dof[first[carried]], R_SB, p_SB, hold, R);
        for (long t = 0, count = 0; t < slots && body != carried; t++) {
            const Patch *other = (const Patch *)patch + t;
            count += other->touching && free_body(body_of[t], parent, joints, first, type) == carried;
            if (count < 2) continue;
            for (int i = 0; i < 6; i++) K[i] *= SIDE_BY_SIDE;
            break;
        }
        damp_joints(body, carried, K, g->step, R, at, parent, joints, first, type, dof, anchor, axis, xmat, push + nv);
    }
    return pushes;
}

/* Add the forces and the damping `pushes` (membranes, 2, nv) and the `holds` (held, 43) of all membranes to `applied`
   and `damping` (nv). */
int64_t qs_add(int64_t nv, int64_t membranes, const double *pushes, int64_t held, const double *holds, double step, const double *inertia,
                 const double *velocity, double *base, double *left, double *applied, const double *undamped, double *damping) {
    /* forces were written by others */
    if (memcmp(applied, left, nv * sizeof *left)) memcpy(base, applied, nv * sizeof *base);
    memcpy(applied, base, nv * sizeof *base);
    memcpy(damping, undamped, nv * sizeof *damping);
    for (long k = 0; k < membranes; k++)
        for (long i = 0; i < nv; i++) applied[i] += pushes[2 * k * nv + i], damping[i] += pushes[(2 * k + 1) * nv + i];
    for (long k = 0; k < held; k++) {
        const long dof = (long)holds[HOLD * k] - 1;
        if (dof < 0) continue;
        long first = 1, count = 0;
        double K[36] = {0}, against[6] = {0};
        for (long l = 0; l < held; l++) {
            if ((long)holds[HOLD * l] - 1 != dof) continue;
            if (l < k) first = 0;
            count++;
            for (int i = 0; i < 36; i++) K[i] += holds[HOLD * l + 1 + i];
            for (int i = 0; i < 6; i++) against[i] += holds[HOLD * l + 37 + i];
        }
        if (!first) continue;
        /* at least the stiffness, by Gershgorin in coordinates with an inertia of one */
        for (int a = 0; a < 6; a++) {
            double sum = 0;
            for (int b = 0; b < 6; b++) sum += fabs(K[6 * a + b]) / sqrt(inertia[dof + b]);
            sum *= SHARE * step * sqrt(inertia[dof + a]);
            damping[dof + a] += sum;
            applied[dof + a] += sum * (velocity[dof + a] - against[a] / (double)count);
        }
    }
    memcpy(left, applied, nv * sizeof *left);
    return 0;
}
