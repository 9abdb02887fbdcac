/* Several steps of a scene with quasi-static membranes, without a return to Python: membranes,
   their forces, the goals of jaws and lift, and MuJoCo's own step, which is called by its address.
   Arrays: sim/batched_quasistatic_step.py. */
#include <math.h>
#include <string.h>

#include "kernels.h"
#include "qs_friction.h"

typedef void (*OfMuJoCo)(const void *model, void *data);
enum { FOLLOW = 38, PUSH = 22, HOLD = 43, EVENTS = 4 };
enum { RAN, UNSOLVED, HURRIES, BROKE };
enum { OPENING_GOAL, OPENING, LIFT_GOAL, LIFT, JAW_STEP, REACH, LIFT_STEP, OFFSET };

/* Return an argument of another kernel, stored in 64 bits: numbers, or addresses (`AT`). */
static double double_from_bits(int64_t word) {
    double value;
    memcpy(&value, &word, sizeof value);
    return value;
}
#define AT(type, k) ((type *)(intptr_t)w[k])

static int64_t call_follow(const int64_t *w) {
    return qs_follow(AT(double, 0), AT(double, 1), w[2], w[3], w[4], AT(float, 5), AT(double, 6), w[7], AT(double, 8), AT(double, 9),
                       w[10], AT(double, 11), w[12], AT(double, 13), AT(double, 14), AT(double, 15), AT(double, 16), AT(double, 17),
                       AT(double, 18), AT(double, 19), w[20], w[21], AT(double, 22), AT(double, 23), w[24], AT(double, 25),
                       AT(double, 26), AT(int64_t, 27), AT(int64_t, 28), AT(double, 29), w[30], AT(int64_t, 31), AT(double, 32),
                       AT(double, 33), AT(double, 34), AT(int32_t, 35), AT(double, 36));
}
static int64_t call_push(const int64_t *w) {
    return qs_push(AT(double, 0), w[1], AT(double, 2), AT(int64_t, 3), AT(double, 4), w[5], w[6], AT(int32_t, 7), AT(int32_t, 8),
                     AT(int32_t, 9), w[10], AT(int32_t, 11), AT(int32_t, 12), AT(double, 13), AT(double, 14), AT(double, 15),
                     AT(double, 16), w[17], AT(double, 18), AT(double, 19));
}
static int64_t add(const int64_t *w) {
    return qs_add(w[0], w[1], AT(double, 2), w[3], AT(double, 4), double_from_bits(w[5]), AT(double, 6), AT(double, 7), AT(double, 8),
                  AT(double, 9), AT(double, 10), AT(double, 11), AT(double, 12));
}

static double step_toward(double start, double goal, double limit) { return start + fmin(fmax(goal - start, -limit), limit); }

static void drive_actuators(double *goals, int64_t reads, const int64_t *read, const double *per, const double *qpos, int64_t drives,
                            const int64_t *control, const double *affine, double *ctrl) {
    double opening = goals[OFFSET];
    for (int64_t k = 0; k < reads; k++) opening += per[k] * qpos[read[k]];
    const double goal = step_toward(goals[OPENING_GOAL], goals[OPENING], goals[JAW_STEP]);
    goals[OPENING_GOAL] = step_toward(opening, goal, goals[REACH]);
    goals[LIFT_GOAL] = step_toward(goals[LIFT_GOAL], goals[LIFT], goals[LIFT_STEP]);
    for (int64_t k = 0; k < drives; k++)
        ctrl[control[k]] = affine[3 * k] + affine[3 * k + 1] * goals[OPENING_GOAL] + affine[3 * k + 2] * goals[LIFT_GOAL];
}

int64_t qs_steps(int64_t count, const int64_t *mujoco, double time, double step, int64_t membranes, const int64_t *follows,
                   const int64_t *pushes, const int64_t *adds, double *goals, int64_t reads, const int64_t *read, const double *per,
                   int64_t nq, const double *qpos, int64_t drives, const int64_t *control, const double *affine, int64_t nu,
                   double *ctrl, int64_t nv, const double *qvel, int64_t movers, const int64_t *mover, const double *hurry,
                   int64_t iterations, const int32_t *solver_iterations, double *wrenches, int64_t *events) {
    void *const model = (void *)(intptr_t)mujoco[2], *const data = (void *)(intptr_t)mujoco[3];
    const OfMuJoCo kinematics = (OfMuJoCo)(intptr_t)mujoco[0], advance = (OfMuJoCo)(intptr_t)mujoco[1];
    memset(events, 0, EVENTS * sizeof *events);
    (void)nu;
    for (int64_t i = 0; i < count; i++) {
        drive_actuators(goals, reads, read, per, qpos, drives, control, affine, ctrl);
        kinematics(model, data);
        int64_t adding = 0;
        for (int64_t f = 0; f < membranes; f++) {
            const int64_t *w = follows + FOLLOW * f;
            const int64_t *p = pushes + PUSH * f;
            ((Given *)(intptr_t)w[18])->time = time;
            const int64_t code = call_follow(w);
            if (code < 0) return code;
            const Memory *memory = (const Memory *)(intptr_t)w[32];
            memcpy(wrenches + 6 * (membranes * i + f), memory->wrench, 6 * sizeof *wrenches);
            if (memory->lost > 0) events[BROKE] = 1;
            const int64_t now = call_push(p);
            int64_t *const pushing = AT(int64_t, 37);
            if (now || *pushing) adding = 1;
            *pushing = now;
            memcpy((double *)(intptr_t)p[20], (const double *)(intptr_t)p[18], 2 * nv * sizeof(double));
            memcpy((double *)(intptr_t)p[21], (const double *)(intptr_t)p[19], p[1] * HOLD * sizeof(double));
        }
        if (adding) add(adds);
        advance(model, data);
        time += step;
        events[RAN] = i + 1;
        events[UNSOLVED] += solver_iterations[0] >= iterations;
        double sum = 0;
        for (int64_t k = 0; k < nq; k++) sum += qpos[k] * qpos[k];
        for (int64_t k = 0; k < nv; k++) sum += qvel[k] * qvel[k];
        for (int64_t k = 0; k < movers; k++) events[HURRIES] |= fabs(qvel[mover[k]]) > hurry[k];
        if (!isfinite(sum) || events[BROKE] || events[HURRIES]) break;
    }
    return 0;
}
