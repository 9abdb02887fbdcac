/* Poses of the obstacles in a moving scene, and the equilibrium of the membrane on them. */
#include <math.h>
#include <string.h>

#include "qs_scene.h"
#include "qs_workspace.h"
#include "kernels.h"
#include "small_linalg.h"

#define AWAY 10.0       /* position of geoms that are not near, m */
/* steps without a solution after which the obstacles are raised until there is one, m; a body that
   arrives is not awaited */
#define LATE 2
#define FIRST_LIFT 2e-5 /* m */
#define DOUBLINGS 10
/* steps between attempts without a lift, and with half of it */
#define EASE 8
#define LOWER 4
#define PAUSE 32        /* steps until the next attempt if no lift has a solution */
/* numbers of a geom: center and half-extents, m, of its bounding box, in its own frame */
#define BOUNDS 6

/* Replace a number; return 1 if it changes. */
static int replace_number(double value, double *where) {
    const int changes = *where != value;
    *where = value;
    return changes;
}

/* Return 1 if the bounding box of a geom, with pose `at` and `turned` in S, overlaps the chamber and
   its bulge. No axis of either box separates the two; a floor behind the sensor is separated by its
   own normal only. */
static int is_near_box(const Scene *s, const double *box, const double at[3], const double turned[9]) {
    const double middle = (s->top - s->depth) / 2, half[3] = {s->half_x, s->half_y, (s->top + s->depth) / 2};
    for (int i = 0; i < 3; i++) {
        const double *row = turned + 3 * i;
        double along = (i == 2 ? middle : 0) - at[i], across = 0, size = half[i], own = box[3 + i];
        for (int k = 0; k < 3; k++) {
            along -= row[k] * box[k], size += fabs(row[k]) * box[3 + k];
            across += turned[3 * k + i] * ((k == 2 ? middle : 0) - at[k]), own += fabs(turned[3 * k + i]) * half[k];
        }
        if (fabs(along) > size || fabs(across - box[i]) > own) return 0;
    }
    return 1;
}

int qs_place_obstacles(const Scene *s, double *rows, Memory *m, Patch *patches) {
    int moved = 0;
    for (long k = 0; k < s->slots; k++) patches[k].near = 0;
    m->near = 0;
    for (long k = 0; k < s->geoms; k++) {
        double off[3], at[3], turned[9], *row = rows + QS_OBSTACLE * k;
        for (int i = 0; i < 3; i++) off[i] = s->geom_xpos[3 * s->geom[k] + i] - s->p[i];
        into(s->R, off, at);
        times(s->R, s->geom_xmat + 9 * s->geom[k], 1, turned);
        const int is_near = is_near_box(s, s->bounds + BOUNDS * k, at, turned);
        if (!is_near) {
            for (int i = 0; i < 3; i++) moved |= replace_number(AWAY, row + 13 + i);
            continue;
        }
        for (int i = 0; i < 9; i++) moved |= replace_number(turned[i], row + 4 + i);
        for (int i = 0; i < 3; i++) moved |= replace_number(at[i], row + 13 + i);
        Patch *own = patches + s->slot[k];
        if (!own->near) own->near = 1, m->near += 1;
    }
    return moved;
}

void qs_pose_of(const Scene *s, long slot, double R_SB[9], double p_SB[3]) {
    double off[3];
    const long body = s->of[slot];
    times(s->R, s->xmat + 9 * body, 1, R_SB);
    for (int i = 0; i < 3; i++) off[i] = s->xpos[3 * body + i] - s->p[i];
    into(s->R, off, p_SB);
}

int qs_is_clear(const Membrane *f, const double *x, long geoms, const double *body, const double *bounds) {
    double top = 0;
    for (long k = 0; k < f->count; k++) top = max_of(top, x[2 * f->count + k]);
    for (long k = 0; k < geoms; k++) {
        const double *row = body + QS_OBSTACLE * k, *up = row + 10, *box = bounds + BOUNDS * k;
        if (row[13] >= AWAY) continue;
        double bottom = row[15];
        for (int i = 0; i < 3; i++) bottom += up[i] * box[i] - fabs(up[i]) * box[3 + i];
        if (bottom < top + f->numbers.half_thickness) return 0;
    }
    return 1;
}

/* Attempt a solution with the obstacles raised by `lift`, m; of what is `touching`, some must stay in
   contact. On failure the state is kept. Returns the status, or a negative error. */
static int64_t attempt_solution(const Solution *c, const double *settings, double lift, int touching, long nodes, double *keep) {
    double *kept_force = keep + 3 * nodes, kept_found[FOUND];
    memcpy(keep, c->x, 3 * nodes * sizeof *keep), memcpy(kept_force, c->force, nodes * sizeof *keep);
    memcpy(kept_found, c->found, sizeof kept_found);
    if (lift > 0)
        for (long k = 0; k < c->geoms; k++) c->body[QS_OBSTACLE * k + 15] += lift;
    const int64_t code = qs_solve(c->numbers, c->law, c->columns, c->rows, c->keeping, c->kept, c->rest, c->roomy, c->room, 1, 0, 1, settings,
                                  c->geoms, c->body, c->pooled, c->pool, c->x, c->force, c->trend, c->found);
    if (code < 0) return code;
    int64_t status = (int64_t)c->found[STATUS];
    if (status == CONVERGED && lift > 0 && touching && !(-c->found[FORCE_Z] > QS_LEAST)) status = NOT_CONVERGED; /* too high */
    if (status == CONVERGED) return CONVERGED;
    memcpy(c->x, keep, 3 * nodes * sizeof *keep), memcpy(c->force, kept_force, nodes * sizeof *keep);
    memcpy(c->found, kept_found, sizeof kept_found), memset(c->trend, 0, 4 * nodes * sizeof *keep);
    return status;
}

int64_t qs_solve_scene(const Solution *c, const Scene *s, const double *settings, long nodes, double *keep, Memory *m, Patch *patches) {
    int64_t status;
    m->solved = 1;
    if (m->pause > 0) return m->pause -= 1, m->lost += 1, 0;
    if (m->lift == 0 || (long)m->lost % EASE == 0) {
        status = attempt_solution(c, settings, 0, 0, nodes, keep);
        if (status < 0) return status;
        m->status = (double)status;
        if (status == CONVERGED) return m->lost = 0, m->lift = 0, 1;
    }
    m->lost += 1;
    if (m->touching && m->lost <= LATE) return 0;
    double once[sizeof(Settings) / sizeof(double)], lift = m->lift > 0 ? m->lift : FIRST_LIFT;
    memcpy(once, settings, sizeof once);
    if (m->lift > FIRST_LIFT && (long)m->lost % LOWER == 0) lift /= 2;
    for (int k = 0; k < DOUBLINGS; k++, lift *= 2) {
        qs_place_obstacles(s, c->body, m, patches);
        ((Settings *)once)->again = k % 3 == 2; /* from rest, in small steps: slower, but surer */
        if ((status = attempt_solution(c, once, lift, m->touching > 0, nodes, keep)) < 0) return status;
        if (status == CONVERGED) return m->lift = lift, 1;
    }
    m->lift = FIRST_LIFT, m->pause = PAUSE;
    return 0;
}
