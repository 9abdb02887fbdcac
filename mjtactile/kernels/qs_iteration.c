/* Parts of a solution step: see qs_step.h; qs_solve.c combines them. */
#include "qs_step.h"

#include <math.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

#define RELEASED 2.0       /* pull on a node above which it is released, Pa */
#define ATTACHED 2e-7      /* depth of a node in an obstacle above which it is held, m */
#define LONGEST_SHIFT 5e-4 /* maximum in-plane step, m */
/* steps that evaluate the obstacles; later ones follow their slopes, otherwise nodes at an edge
   alternate */
#define CHECKS 3
#define EDGE_HALVES 20
#define SHORT 2e-4         /* height step below which nodes may be released, m */
#define MAX_DRAG 2.0       /* maximum shear per normal force */
#define FINE 1e-8          /* tolerance below which double precision is used, m */

static long doubles_of(const Membrane *f) { return qs_contact_size(f) + (3 + 1 + 3 + 3) * f->count + 8; }

static long floats_of(const Membrane *f) {
    return (3 + 3 + 1 + 1 + 3 + 1 + 1 + 1 + 1 + 2 + 4) * f->count + qs_inplane_workspace_size(f) + qs_normal_workspace_size(f) +
           qs_anderson_size(4 * f->count);
}

long qs_workspace_size_of(const Membrane *f) { return doubles_of(f) + floats_of(f) / 2 + 1; }

int64_t qs_workspace_size(const double *numbers) {
    const Membrane f = qs_membrane(numbers, 0);
    return qs_workspace_size_of(&f);
}

int64_t qs_factors_size(const double *numbers) {
    const Membrane f = qs_membrane(numbers, 0);
    return qs_normal_size(&f) + 2 * ((qs_inplane_size(&f) + 1) / 2);
}

static float *take_floats(float **from, long n) {
    float *here = *from;
    *from += n;
    return here;
}

Work qs_work_in(const Membrane *f, const RestHeights *rest, const float *plane_factor, double *room) {
    const long n = f->count;
    Work w = {.plane_factor = plane_factor};
    w.seen = qs_contact_in(f, &room);
    w.x = qs_take(&room, 3 * n + 8), w.force = qs_take(&room, n);
    memset(w.x, 0, (3 * n + 8) * sizeof *w.x);
    w.fine.elastic = qs_take(&room, 3 * n), w.fine.gradient = qs_take(&room, 3 * n);
    w.fine.along_x = w.seen.along_x, w.fine.along_y = w.seen.along_y;
    float *floats = (float *)room;
    w.fast.elastic = take_floats(&floats, 3 * n), w.fast.gradient = take_floats(&floats, 3 * n);
    w.fast.along_x = take_floats(&floats, n), w.fast.along_y = take_floats(&floats, n);
    w.residual = take_floats(&floats, 3 * n), w.pulls = take_floats(&floats, n), w.swells = take_floats(&floats, n);
    w.moved = take_floats(&floats, n), w.pushed = take_floats(&floats, n), w.plane = take_floats(&floats, 2 * n);
    w.global.area_by = take_floats(&floats, n), w.global.volume_by = take_floats(&floats, n);
    w.global.y1 = take_floats(&floats, n), w.global.y2 = take_floats(&floats, n);
    w.plane_room = take_floats(&floats, qs_inplane_workspace_size(f));
    w.heights = qs_normal_in(f, rest, &floats);
    w.learnt = qs_anderson_in(4 * n, 3 * n, &floats);
    return w;
}

static double dot(const float *a, const float *b, long n) {
    float sum = 0;
    for (long i = 0; i < n; i++) sum += a[i] * b[i];
    return (double)sum;
}

void update_membrane(const Membrane *f, const Settings *set, int parts, Work *w) {
    const long n = f->count, first = w->heights.first, last = w->heights.last, line = f->line;
    const long from = parts == QS_PLANE ? 0 : 2 * n, to = parts == QS_PLANE ? 2 * n : 3 * n;
    const int fine = set->tolerance < FINE;
    if (parts == QS_HEIGHTS) memset(w->seen.along_x, 0, n * sizeof(double)), memset(w->seen.along_y, 0, n * sizeof(double));
    if (fine) w->sums = qs_elastic(f, w->x, QS_ALL, first, last, &w->fine);
    else w->sums = qs_elasticFloat(f, w->x, parts, first, last, &w->fast);
    evaluate_gas(f, set, w->sums.volume, &w->pressure, &w->gas_stiffness);
    if (fine) {
        for (long k = from; k < to; k++) w->residual[k] = (float)(w->fine.elastic[k] - w->pressure * w->fine.gradient[k]);
    } else {
        const float pressure = (float)w->pressure;
        for (long k = from; k < to; k++) w->residual[k] = w->fast.elastic[k] - pressure * w->fast.gradient[k];
    }
    if (parts == QS_PLANE) return;
    for (long k = 0; k < n; k++) {
        w->pulls[k] = fine ? (float)w->fine.elastic[2 * n + k] : w->fast.elastic[2 * n + k];
        w->swells[k] = fine ? (float)w->fine.gradient[2 * n + k] : w->fast.gradient[2 * n + k];
    }
    if (fine) return;
    for (long k = first * line; k < last * line; k++) w->seen.along_x[k] = (double)w->fast.along_x[k];
    for (long k = first * line; first < last && k < max_of(last + 1, f->columns - 1) * line; k++) w->seen.along_y[k] = (double)w->fast.along_y[k];
}

void update_obstacles(const Membrane *f, const Bodies *bodies, double lifted, int step, Work *w) {
    if (step < CHECKS) {
        evaluate_obstacles(f, bodies, w->x, &w->seen);
        for (long k = w->seen.box[0] * f->line; k < w->seen.box[1] * f->line; k++)
            if (w->seen.touching[k]) find_edges(f, bodies, w->x, k, EDGE_HALVES, &w->seen);
    } else {
        extrapolate_obstacles(f, w->x, &w->seen);
    }
    correct_round_obstacles(f, &w->seen);
    if (lifted != 0)
        for (long k = 0; k < f->count; k++) w->seen.obstacle[k] += lifted;
}

/* -- heights ----------------------------------------------------------------------------------- */

int widen_window(const Membrane *f, double near, Work *w) {
    const double *z = w->x + 2 * f->count;
    long first = f->columns, last = -1;
    for (long k = w->seen.box[0] * f->line; k < w->seen.box[1] * f->line; k++) {
        if (!w->seen.touching[k] && !(w->seen.obstacle[k] - w->seen.lower[k] - z[k] < near)) continue;
        const long i = k / f->line;
        first = i < first ? i : first, last = i > last ? i : last;
    }
    if (last < 0) first = last = f->columns / 2;
    else first -= 1, last += 1;
    Heights *h = &w->heights;
    if (h->first <= first && last <= h->last) return 0;
    h->first = h->first < first ? h->first : first, h->last = h->last > last ? h->last : last;
    return 1;
}

static int is_free(const Membrane *f, long node) { return qs_free(f, node / f->line, node % f->line); }

void stiffen_edges(const Membrane *f, const double *z, double by, Work *w) {
    const ContactNodes *s = &w->seen;
    float *residual = w->residual + 2 * f->count;
    for (long k = s->box[0] * f->line; k < s->box[1] * f->line; k++) {
        if (!s->touching[k]) continue;
        double *links[4] = {s->along_x + k, s->along_x + k - f->line, s->along_y + k, s->along_y + k - 1};
        for (int side = 0; side < 4; side++) {
            const double spring = by * s->spring[side * f->count + k];
            if (spring == 0) continue;
            const float force = (float)(-spring * height_over_edge(f, s, z, k, side));
            *links[side] += spring;
            residual[k] += force;
            if (is_free(f, k + qs_next(f, side))) residual[k + qs_next(f, side)] -= force;
        }
    }
}

int prepare_heights(const Membrane *f, const double *z, Work *w) {
    GlobalTerms *all = &w->global;
    const float over_tension = (float)(1 / max_of(w->sums.tension, 1e-3));
    for (long k = 0; k < f->count; k++) all->area_by[k] = w->pulls[k] * over_tension, all->volume_by[k] = w->swells[k];
    all->tension = f->numbers.tension_slope / f->numbers.opening, all->gas = w->gas_stiffness;
    w->heights.scale = (float)w->sums.tension / *w->heights.rest->tension;
    return qs_normal_factor(f, z, &w->seen, &w->heights);
}

void step_heights(const Membrane *f, const double *z, int fresh, Work *w) {
    GlobalTerms *all = &w->global;
    const long n = f->count;
    const uint8_t *touching = w->seen.touching;
    const float *residual = w->residual + 2 * n;
    float *y0 = w->heights.solved, *y1 = y0 + w->heights.stride, *y2 = y1 + w->heights.stride;
    const double c1 = all->tension, c2 = all->gas;
    for (long k = 0; k < n; k++) w->moved[k] = touching[k] ? (float)(w->seen.obstacle[k] - w->seen.lower[k] - z[k]) : 0;
    memset(w->pushed, 0, n * sizeof *w->pushed);
    qs_normal_times(f, z, &w->seen, &w->heights, 0, w->moved, w->pushed);
    const float held_1 = (float)(c1 * dot(all->area_by, w->moved, n)), held_2 = (float)(c2 * dot(all->volume_by, w->moved, n));
    for (long k = 0; k < n; k++)
        y0[k] = touching[k] ? 0 : -(residual[k] + w->pushed[k] + held_1 * all->area_by[k] + held_2 * all->volume_by[k]);
    if (fresh)
        for (long k = 0; k < n; k++) y1[k] = touching[k] ? 0 : all->area_by[k], y2[k] = touching[k] ? 0 : all->volume_by[k];
    qs_normal_solve(f, fresh ? 3 : 1, &w->heights);
    if (fresh) memcpy(all->y1, y1, n * sizeof *y1), memcpy(all->y2, y2, n * sizeof *y2);
    const double m11 = 1 + c1 * dot(all->area_by, all->y1, n), m12 = c1 * dot(all->area_by, all->y2, n);
    const double m21 = c2 * dot(all->volume_by, all->y1, n), m22 = 1 + c2 * dot(all->volume_by, all->y2, n);
    const double r1 = c1 * dot(all->area_by, y0, n), r2 = c2 * dot(all->volume_by, y0, n), det = m11 * m22 - m12 * m21;
    const float t1 = (float)((r1 * m22 - r2 * m12) / det), t2 = (float)((m11 * r2 - m21 * r1) / det);
    for (long k = 0; k < n; k++) w->moved[k] = touching[k] ? w->moved[k] : y0[k] - t1 * all->y1[k] - t2 * all->y2[k];
    qs_normal_times(f, z, &w->seen, &w->heights, 1, w->moved, w->pushed);
    const float all_1 = (float)(c1 * dot(all->area_by, w->moved, n)), all_2 = (float)(c2 * dot(all->volume_by, w->moved, n));
    for (long k = 0; k < n; k++)
        w->pushed[k] = touching[k] ? -(residual[k] + w->pushed[k] + all_1 * all->area_by[k] + all_2 * all->volume_by[k]) : 0;
}

double largest_of(const float *values, long n) {
    float largest[8] = {0}, nothing[8] = {0};
    for (long k = 0; k < n; k += 8)
        for (long l = 0; l < 8; l++) {
            const float size = fabsf(values[k + l]);
            largest[l] = size > largest[l] ? size : largest[l], nothing[l] += 0 * size;
        }
    for (long l = 1; l < 8; l++) largest[0] = max_float(largest[0], largest[l]), nothing[0] += nothing[l];
    return (double)(largest[0] + nothing[0]);
}

/* Update the nodes in contact from the heights, and after a step also from the contact forces.
   Returns 1 if the set changed. */
static int decide_contact(const Membrane *f, const Bodies *bodies, double loose, int after_step, int may_release, Work *w) {
    const double *z = w->x + 2 * f->count;
    const double released = -loose * RELEASED * f->dx * f->dy, attached = loose * ATTACHED;
    ContactNodes *s = &w->seen;
    int changed = 0;
    for (long i = max_of(s->box[0], 1); i < min_of(s->box[1], f->columns - 1); i++)
        for (long k = i * f->line + s->box[2]; k < i * f->line + s->box[3]; k++) {
            if (!qs_free(f, i, k % f->line)) continue;
            const double over = z[k] + (after_step ? (double)w->moved[k] : 0) - s->obstacle[k] + s->lower[k];
            const double force = after_step ? (double)w->pushed[k] : w->force[k];
            const int touches = s->touching[k] ? isfinite(over) && (!may_release || force > released) : over > attached;
            if (touches == s->touching[k]) continue;
            s->touching[k] = (uint8_t)touches, changed = 1;
            if (touches) find_edges(f, bodies, w->x, k, EDGE_HALVES, s);
        }
    return changed;
}

int settle_heights(const Membrane *f, const Settings *set, const Bodies *bodies, double loose, int first, int max_sets, Work *w,
                          int *changed) {
    const double *z = w->x + 2 * f->count;
    int other = decide_contact(f, bodies, loose, 0, 1, w);
    for (int sets = 0; sets < max_sets; sets++) {
        if (widen_window(f, 0, w)) update_membrane(f, set, QS_HEIGHTS, w), first = 1;
        const double pulling = find_springs(f, z, &w->seen);
        stiffen_edges(f, z, 1, w);
        const int fresh = first || other || pulling != w->pulled;
        if (fresh) {
            *changed = 1, first = 0, w->pulled = pulling;
            if (prepare_heights(f, z, w)) return 1;
        }
        step_heights(f, z, fresh, w);
        if (sets == max_sets - 1) return 0;
        /* after a long step, forces do not indicate the nodes to release */
        if (!(other = decide_contact(f, bodies, loose, 1, largest_of(w->moved, f->count) < SHORT, w))) return 0;
        stiffen_edges(f, z, -1, w);
    }
    return 0;
}

/* -- in the plane ------------------------------------------------------------------------------ */

/* Return the shear per normal force along axis `c` that is added to the frictionless forces. */
static double drag_of(const Membrane *f, const Settings *set, long c, const Work *w) {
    double normal = 0, along = 0;
    if (!set->sticks) return 0;
    for (long k = 0; k < f->count; k++) normal += w->force[k], along += w->force[k] * w->seen.slope[c * f->count + k];
    return normal > 0 ? clip((set->shear[c] - along) / normal, -MAX_DRAG, MAX_DRAG) : 0;
}

double step_plane(const Membrane *f, const Settings *set, Work *w) {
    const long n = f->count;
    for (long c = 0; c < 2; c++) {
        const double drag = drag_of(f, set, c, w);
        for (long k = 0; k < n; k++) w->plane[c * n + k] = (float)(w->force[k] * (w->seen.slope[c * n + k] + drag)) - w->residual[c * n + k];
    }
    qs_inplane_solve(f, w->plane_factor, w->plane, w->plane_room);
    const double largest = largest_of(w->plane, 2 * n);
    if (largest > LONGEST_SHIFT)
        for (long k = 0; k < 2 * n; k++) w->plane[k] *= (float)(LONGEST_SHIFT / largest);
    return largest;
}
