/* Equilibrium of the membrane on obstacles: see quasistatic.h. Equations:
   docs/theory/quasistatic_membrane.md.

   Unknowns are the displacements of the nodes and the contact forces along z. A step has two
   solves, each with an approximate matrix. The heights use the local tension of the membrane
   (qs_normal_solver.h), plus the rank-two term of tension and gas when the whole membrane moves.
   The in-plane displacements use the stiffness without contact (qs_inplane_solver.h). Residuals are
   exact, so that the result does not depend on the matrices. Matrices and forces are in single
   precision, with an error of some nanometers; positions are not. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "qs_step.h"
#include "kernels.h"
#include "small_linalg.h"

/* Steps after which RELEASED and ATTACHED (qs_iteration.c) grow, up to MAX_LOOSE times: on flat
   faces, nodes alternate for negligible differences. */
#define PATIENCE 8
#define MAX_LOOSE 10
#define MAX_SETS 4        /* maximum number of contact sets tried in a step */
#define QUICK 3            /* steps that try several sets */
#define FAR 2e-4           /* height change in a first step from far away, m */
#define NEAR 2e-4          /* distance of nodes that may soon be in contact, m */
#define FIRST_STEP 1e-4    /* assumed size of the step before the first one, m */
#define MAX_TREND 2.0
/* minimum explained fraction of the squared gaps between obstacles and membrane */
#define MIN_EXPLAINED 0.5
/* assumed minimum shrink ratio of the steps; it tends to 0.3, which is reached sooner far from
   equilibrium */
#define MIN_FRACTION 0.05
#define MIN_FRACTION_FAR 0.3
/* minimum ratio of a cell's projected area; below, the membrane is inverted */
#define MIN_TURN 0.05
#define JUMPS 16

/* Extrapolate the last change of the membrane, `trend` (4, nodes) of displacements and forces, by
   the ratio that fits the motion of the obstacles in contact. */
static void extrapolate(const Membrane *f, const double *trend, Work *w) {
    const long n = f->count, nodes = f->columns * f->rows;
    const ContactNodes *s = &w->seen;
    double along = 0, trends = 0, gaps = 0;
    for (long i = s->box[0]; i < s->box[1]; i++)
        for (long j = s->box[2]; j < s->box[3]; j++) {
            const long k = i * f->line + j, node = i * f->rows + j;
            if (!s->touching[k] || isinf(s->obstacle[k])) continue;
            const double gap = s->obstacle[k] - s->lower[k] - w->x[2 * n + k];
            const double went = trend[2 * nodes + node] - s->slope[k] * trend[node] - s->slope[n + k] * trend[nodes + node];
            along += gap * went, trends += square(went), gaps += square(gap);
        }
    const double fraction = along / trends; /* not finite without a previous change */
    if (!(fabs(fraction) < MAX_TREND && along * fraction > MIN_EXPLAINED * gaps)) return;
    for (long i = 0; i < 3 * f->columns; i++)
        for (long j = 0; j < f->rows; j++) w->x[i * f->line + j] += fraction * trend[i * f->rows + j];
    for (long i = 0; i < f->columns; i++)
        for (long j = 0; j < f->rows; j++) {
            const long k = i * f->line + j;
            w->force[k] = s->touching[k] ? max_of(w->force[k] + fraction * trend[3 * nodes + i * f->rows + j], 0) : 0;
        }
    extrapolate_obstacles(f, w->x, &w->seen);
}

/* Write padded fields in Python's layout, and their change into `change`. */
static void write_state(const Membrane *f, long fields, const double *from, double *to, double *change) {
    for (long i = 0; i < fields * f->columns; i++)
        for (long j = 0; j < f->rows; j++) {
            const double value = from[i * f->line + j];
            change[i * f->rows + j] = value - to[i * f->rows + j], to[i * f->rows + j] = value;
        }
}

/* Do one step of heights and in-plane displacements. Returns the larger of both, or NaN. `wider`:
   the window has changed. */
static double step_both(const Membrane *f, const Settings *set, const Bodies *bodies, int step, int wider, Work *w, double *lift,
                        int *changed) {
    const long n = f->count;
    const double loose = step < PATIENCE ? 1 : min_of(step - PATIENCE + 1, MAX_LOOSE);
    if (settle_heights(f, set, bodies, loose, wider, step < QUICK ? MAX_SETS : 1, w, changed)) return NAN;
    double *z = w->x + 2 * n;
    float *now = w->learnt.now;
    for (long k = 0; k < n; k++) {
        now[2 * n + k] = w->moved[k], now[3 * n + k] = w->pushed[k] - (float)w->force[k];
        z[k] += (double)w->moved[k], w->force[k] = (double)w->pushed[k];
    }
    *lift = largest_of(w->moved, n);
    update_membrane(f, set, QS_PLANE, w);
    const double shift = step_plane(f, set, w);
    for (long k = 0; k < 2 * n; k++) now[k] = w->plane[k], w->x[k] += (double)w->plane[k];
    return isfinite(*lift) && isfinite(shift) ? max_of(*lift, shift) : NAN;
}

/* Iterate to equilibrium. Returns a status. */
static int iterate_to_equilibrium(const Membrane *f, const Settings *set, const Bodies *bodies, double lifted, const double *trend,
                                  double *found, Work *w) {
    const long n = f->count;
    double last_before = FIRST_STEP, lift;
    int far = 0;
    Anderson *l = &w->learnt;
    qs_anderson_reset(l);
    /* a second attempt uses all lines; a window requires symmetry under half a turn */
    const int narrow = trend && !f->lopsided;
    w->heights.first = narrow ? f->columns : 0, w->heights.last = narrow ? -1 : f->columns - 1;
    mark_contact(f, w->force, &w->seen), find_lower_bounds(f, bodies, &w->seen);
    for (int step = 0; step < (int)set->max_steps; step++) {
        update_obstacles(f, bodies, lifted, step, w);
        const int misplaced = step ? CONVERGED : check_rim_contact(f, set, &w->seen);
        if (misplaced) return misplaced;
        if (!step && trend) extrapolate(f, trend, w);
        /* the window of a first step has no factor yet, even if it is complete and nothing is in
           contact */
        const int wider = widen_window(f, step ? 0 : NEAR, w) || !step;
        update_membrane(f, set, QS_HEIGHTS, w);
        if (w->sums.min_turn < MIN_TURN) return INVERTED;
        if (!isfinite(w->sums.area)) return NUMERICAL_FAILURE;
        int changed = 0;
        const double last = step_both(f, set, bodies, step, wider, w, &lift, &changed);
        if (isnan(last)) return NUMERICAL_FAILURE;
        found[STEPS] += 1, found[LAST_STEP] = last, found[PRESSURE] = w->pressure, found[VOLUME] = w->sums.volume;
        found[STRETCHED_AREA] = w->sums.area, found[TENSION] = w->sums.tension;
        /* the last two steps give the shrink ratio; the remaining error is the sum of all following
           steps */
        if (!step) far = lift > FAR;
        const double shrinks = clip(last / last_before, far ? MIN_FRACTION_FAR : MIN_FRACTION, 0.9);
        if ((!changed || !step) && last * shrinks / (1 - shrinks) < set->tolerance) return CONVERGED;
        last_before = last;
        if (!qs_anderson_update(l, changed)) continue;
        for (long k = 0; k < 3 * n; k++) w->x[k] += (double)(l->now[k] - l->last[k]);
        for (long k = 0; k < n; k++)
            w->force[k] = w->seen.touching[k] ? w->force[k] + (double)(l->now[3 * n + k] - l->last[3 * n + k]) : 0;
    }
    return NOT_CONVERGED;
}

/* Solve after a jump that was too large: start without contact, and bring the obstacles in by
   smaller jumps. */
static int solve_from_rest(const Membrane *f, const Settings *set, const Bodies *bodies, const double *rest, double *found, Work *w) {
    qs_pad(f, 3, rest, w->x), memset(w->force, 0, f->count * sizeof *w->force);
    mark_contact(f, w->force, &w->seen), evaluate_obstacles(f, bodies, w->x, &w->seen);
    double deep = 0;
    int status = NOT_CONVERGED;
    for (long k = 0; k < f->count; k++) deep = max_of(deep, w->x[2 * f->count + k] - w->seen.obstacle[k]);
    for (int jump = JUMPS - 1; jump >= 0; jump--) {
        status = iterate_to_equilibrium(f, set, bodies, deep * jump / JUMPS, 0, found, w);
        if (status != CONVERGED && status != NOT_CONVERGED) break;
    }
    return status;
}

/* Check that a result is within the model's range. Returns a status. */
static int check_validity(const Membrane *f, const Bodies *bodies, const Work *w) {
    if (f->numbers.neo_hookean != 0 && (w->sums.min_root - f->numbers.law_middle) * f->numbers.law_per_unit < -1) return OVERSTRETCHED;
    return penetrates_membrane(f, bodies, w->x, &w->seen) ? TUNNELLING : CONVERGED;
}

/* Return the maximum number of face values of a hull, for obstacles `from` to `to` - 1. */
static long max_faces(const double *body, long from, long to) {
    long found = 0;
    for (long b = from; b < to; b++) {
        const long own = qs_faces_of((const Obstacle *)body + b);
        if (own > found) found = own;
    }
    return found;
}

int64_t qs_solve(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                   const double *rest, int64_t roomy, double *room, int64_t environments, int64_t start, int64_t end,
                   const double *settings, int64_t bodies, const double *body, int64_t pooled, const double *pool, double *x,
                   double *force, double *trend, double *found) {
    const Membrane f = qs_membrane(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > QS_MAX_LINE || keeping < qs_factors_size(numbers)) return REFUSED;
    if (roomy < qs_workspace_size_of(&f) || start < 0 || end > environments) return REFUSED;
    (void)pooled;
    const long n = f.count, nodes = columns * rows;
    const RestHeights at_rest = qs_heights_at(&f, (float *)kept);
    Work w = qs_work_in(&f, &at_rest, kept + qs_normal_size(&f), room);
    const long faced = bodies * max_faces(body, start * bodies, end * bodies);
    double *faces = faced ? malloc(faced * sizeof *faces) : 0;
    if (faced && !faces) return NO_MEMORY;
    for (long e = start; e < end; e++) {
        double *own_x = x + e * 3 * nodes, *own_force = force + e * nodes, *own_trend = trend + e * 4 * nodes, *own = found + e * FOUND;
        const Bodies own_bodies = {bodies, body + e * bodies * QS_OBSTACLE, pool, faces};
        if (faces) qs_faces(&own_bodies, faces);
        const Settings *set = (const Settings *)settings + e;
        memset(own, 0, FOUND * sizeof *own);
        qs_pad(&f, 3, own_x, w.x), qs_pad(&f, 1, own_force, w.force);
        int status = iterate_to_equilibrium(&f, set, &own_bodies, 0, own_trend, own, &w);
        if (status == CONVERGED) status = check_validity(&f, &own_bodies, &w);
        if (set->again && (status == TUNNELLING || status == NOT_CONVERGED || status == INVERTED || status == NUMERICAL_FAILURE))
            status = solve_from_rest(&f, set, &own_bodies, rest, own, &w);
        if (status == CONVERGED) status = check_validity(&f, &own_bodies, &w);
        own[STATUS] = status;
        for (long k = 0; k < n; k++) w.seen.cell[k] = (double)w.swells[k];
        if (status == CONVERGED) sum_contact(&f, w.x, w.force, own, &w.seen);
        write_state(&f, 3, w.x, own_x, own_trend), write_state(&f, 1, w.force, own_force, own_trend + 3 * nodes);
    }
    free(faces);
    return 0;
}
