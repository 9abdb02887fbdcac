/* The film at rest on bodies: see film.h, and mjtactile/film for the equations.

   Unknown are displacements of the nodes and the contact's forces along z. A step solves twice, each time with a matrix that is
   good enough: for the heights with a film's under the sheet's local tension (film_heights.h), plus what tension and gas add when
   the whole sheet moves (rank two), and in the plane with the stiffness of the sheet at rest (film_plane.h). Residuals are exact,
   so that where the steps end does not depend on the matrices. Matrices and forces are in single precision, which leaves some
   nanometres; places are not. */
#include "film.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "band.h"
#include "film_heights.h"
#include "film_learn.h"
#include "film_plane.h"
#include "film_work.h"
#include "kernels.h"
#include "small.h"

#define RELEASED 2.0       /* Pa that may pull at a node before it is let go */
#define ATTACHED 2e-7      /* m that a node may be in a body before it is held */
#define PATIENCE 8         /* steps after which both grow, up to MOST_LOOSE times: on flat faces nodes come and go for next to nothing */
#define MOST_LOOSE 10
#define LONGEST_SHIFT 5e-4 /* m, of a step in the plane */
#define LOOKS 3            /* steps that ask the bodies; later ones follow their slopes, else nodes at an edge come and go */
#define EDGE_HALVES 20
#define MOST_SETS 4        /* of nodes that touch, tried in a step */
#define QUICK 3            /* steps that do so */
#define SHORT 2e-4         /* m */
#define NEAR 2e-4          /* m, of what may touch soon */
#define FIRST_STEP 1e-4    /* m, that the first step is thought to come after */
#define MOST_TREND 2.0
#define LEAST_EXPLAINED 0.5  /* of the gaps between bodies and the sheet, squared */
#define LEAST_SHARE 0.05     /* by which steps are thought to shrink at best; they do so by 0.3 at last, which far from rest comes sooner */
#define LEAST_SHARE_FAR 0.3
#define LEAST_TURN 0.05    /* of a cell's shadow: below, the sheet is inside out */
#define FINE 1e-8          /* m, of a tolerance that wants double precision */
#define JUMPS 16

/* What tension and gas add to the heights' stiffness: tension a a^T + gas v v^T, a the area's and v the volume's slopes by heights,
   (count) each; y1 and y2 are what they move. */
typedef struct { double tension, gas; float *area_by, *volume_by, *y1, *y2; } Whole;

typedef struct {
    Seen seen;
    double *x, *force;                   /* (3, count), (count); x has room behind it */
    SheetFields fine;
    SheetFieldsFloat fast;
    float *residual;                     /* (3, count): elastic forces less the gas's */
    float *pulls, *swells;               /* (count) elastic forces and the volume's slopes by heights */
    float *moved, *pushed, *plane, *plane_room;
    Whole whole;
    Heights heights;
    Learnt learnt;
    const float *plane_factor;
    double pulled;                       /* which edges' springs are in the factor */
    double pressure, gas_stiffness;
    SheetSums sums;
} Work;

static long doubles_of(const Film *f) { return film_seen_size(f) + (3 + 1 + 3 + 3) * f->count + 8; }

static long floats_of(const Film *f) {
    return (3 + 3 + 1 + 1 + 3 + 1 + 1 + 1 + 1 + 2 + 4) * f->count + film_plane_room(f) + film_heights_room(f) +
           film_learn_room(4 * f->count);
}

static long room_of(const Film *f) { return doubles_of(f) + floats_of(f) / 2 + 1; }

int64_t film_room(const double *numbers) {
    const Film f = film_of(numbers, 0);
    return room_of(&f);
}

int64_t film_kept(const double *numbers) {
    const Film f = film_of(numbers, 0);
    return film_heights_size(&f) + 2 * ((film_plane_size(&f) + 1) / 2);
}

static float *take_floats(float **from, long n) {
    float *here = *from;
    *from += n;
    return here;
}

static Work work_in(const Film *f, const RestHeights *rest, const float *plane_factor, double *room) {
    const long n = f->count;
    Work w = {.plane_factor = plane_factor};
    w.seen = film_seen_in(f, &room);
    w.x = film_take(&room, 3 * n + 8), w.force = film_take(&room, n);
    memset(w.x, 0, (3 * n + 8) * sizeof *w.x);
    w.fine.elastic = film_take(&room, 3 * n), w.fine.gradient = film_take(&room, 3 * n);
    w.fine.along_x = w.seen.along_x, w.fine.along_y = w.seen.along_y;
    float *floats = (float *)room;
    w.fast.elastic = take_floats(&floats, 3 * n), w.fast.gradient = take_floats(&floats, 3 * n);
    w.fast.along_x = take_floats(&floats, n), w.fast.along_y = take_floats(&floats, n);
    w.residual = take_floats(&floats, 3 * n), w.pulls = take_floats(&floats, n), w.swells = take_floats(&floats, n);
    w.moved = take_floats(&floats, n), w.pushed = take_floats(&floats, n), w.plane = take_floats(&floats, 2 * n);
    w.whole.area_by = take_floats(&floats, n), w.whole.volume_by = take_floats(&floats, n);
    w.whole.y1 = take_floats(&floats, n), w.whole.y2 = take_floats(&floats, n);
    w.plane_room = take_floats(&floats, film_plane_room(f));
    w.heights = film_heights_in(f, rest, &floats);
    w.learnt = film_learn_in(4 * n, 3 * n, &floats);
    return w;
}

static double dot(const float *a, const float *b, long n) {
    float sum = 0;
    for (long i = 0; i < n; i++) sum += a[i] * b[i];
    return (double)sum;
}

/* Forces on the nodes, of heights or in the plane, and what goes with them. */
static void see_sheet(const Film *f, const Settings *set, int parts, Work *w) {
    const long n = f->count, first = w->heights.first, last = w->heights.last, line = f->line;
    const long from = parts == FILM_PLANE ? 0 : 2 * n, to = parts == FILM_PLANE ? 2 * n : 3 * n;
    const int fine = set->tolerance < FINE;
    if (parts == FILM_HEIGHTS) memset(w->seen.along_x, 0, n * sizeof(double)), memset(w->seen.along_y, 0, n * sizeof(double));
    if (fine) w->sums = film_sheet(f, w->x, FILM_ALL, first, last, &w->fine);
    else w->sums = film_sheetFloat(f, w->x, parts, first, last, &w->fast);
    gas_of(f, set, w->sums.volume, &w->pressure, &w->gas_stiffness);
    if (fine) {
        for (long k = from; k < to; k++) w->residual[k] = (float)(w->fine.elastic[k] - w->pressure * w->fine.gradient[k]);
    } else {
        const float pressure = (float)w->pressure;
        for (long k = from; k < to; k++) w->residual[k] = w->fast.elastic[k] - pressure * w->fast.gradient[k];
    }
    if (parts == FILM_PLANE) return;
    for (long k = 0; k < n; k++) {
        w->pulls[k] = fine ? (float)w->fine.elastic[2 * n + k] : w->fast.elastic[2 * n + k];
        w->swells[k] = fine ? (float)w->fine.gradient[2 * n + k] : w->fast.gradient[2 * n + k];
    }
    if (fine) return;
    for (long k = first * line; k < last * line; k++) w->seen.along_x[k] = (double)w->fast.along_x[k];
    for (long k = first * line; first < last && k < most(last + 1, f->columns - 1) * line; k++) w->seen.along_y[k] = (double)w->fast.along_y[k];
}

/* -- heights ----------------------------------------------------------------------------------------------------------- */

/* The lines that what touches, or is about to, has about it; 0 where all of them are in the window already. */
static int widen_window(const Film *f, double near, Work *w) {
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

static int is_free(const Film *f, long node) { return film_free(f, node / f->line, node % f->line); }

/* Edges' springs into residual and links; `by` -1 takes them out again. */
static void stiffen_edges(const Film *f, const double *z, double by, Work *w) {
    const Seen *s = &w->seen;
    float *residual = w->residual + 2 * f->count;
    for (long k = s->box[0] * f->line; k < s->box[1] * f->line; k++) {
        if (!s->touching[k]) continue;
        double *links[4] = {s->along_x + k, s->along_x + k - f->line, s->along_y + k, s->along_y + k - 1};
        for (int side = 0; side < 4; side++) {
            const double spring = by * s->spring[side * f->count + k];
            if (spring == 0) continue;
            const float force = (float)(-spring * rises_over_edge(f, s, z, k, side));
            *links[side] += spring;
            residual[k] += force;
            if (is_free(f, k + film_next(f, side))) residual[k + film_next(f, side)] -= force;
        }
    }
}

/* All that a step of the heights needs but its residual. */
static int prepare_heights(const Film *f, const double *z, Work *w) {
    Whole *all = &w->whole;
    const float over_tension = (float)(1 / most(w->sums.tension, 1e-3));
    for (long k = 0; k < f->count; k++) all->area_by[k] = w->pulls[k] * over_tension, all->volume_by[k] = w->swells[k];
    all->tension = f->numbers.tension_slope / f->numbers.opening, all->gas = w->gas_stiffness;
    w->heights.scale = (float)w->sums.tension / *w->heights.rest->tension;
    return film_heights_factor(f, z, &w->seen, &w->heights);
}

/* The heights' step `moved` and what it leaves for the contact to carry, `pushed`. `fresh`: the factor is new. */
static void step_heights(const Film *f, const double *z, int fresh, Work *w) {
    Whole *all = &w->whole;
    const long n = f->count;
    const uint8_t *touching = w->seen.touching;
    const float *residual = w->residual + 2 * n;
    float *y0 = w->heights.solved, *y1 = y0 + w->heights.apart, *y2 = y1 + w->heights.apart;
    const double c1 = all->tension, c2 = all->gas;
    for (long k = 0; k < n; k++) w->moved[k] = touching[k] ? (float)(w->seen.obstacle[k] - w->seen.lower[k] - z[k]) : 0;
    memset(w->pushed, 0, n * sizeof *w->pushed);
    film_heights_times(f, z, &w->seen, &w->heights, 0, w->moved, w->pushed);
    const float held_1 = (float)(c1 * dot(all->area_by, w->moved, n)), held_2 = (float)(c2 * dot(all->volume_by, w->moved, n));
    for (long k = 0; k < n; k++)
        y0[k] = touching[k] ? 0 : -(residual[k] + w->pushed[k] + held_1 * all->area_by[k] + held_2 * all->volume_by[k]);
    if (fresh)
        for (long k = 0; k < n; k++) y1[k] = touching[k] ? 0 : all->area_by[k], y2[k] = touching[k] ? 0 : all->volume_by[k];
    film_heights_solve(f, fresh ? 3 : 1, &w->heights);
    if (fresh) memcpy(all->y1, y1, n * sizeof *y1), memcpy(all->y2, y2, n * sizeof *y2);
    const double m11 = 1 + c1 * dot(all->area_by, all->y1, n), m12 = c1 * dot(all->area_by, all->y2, n);
    const double m21 = c2 * dot(all->volume_by, all->y1, n), m22 = 1 + c2 * dot(all->volume_by, all->y2, n);
    const double r1 = c1 * dot(all->area_by, y0, n), r2 = c2 * dot(all->volume_by, y0, n), det = m11 * m22 - m12 * m21;
    const float t1 = (float)((r1 * m22 - r2 * m12) / det), t2 = (float)((m11 * r2 - m21 * r1) / det);
    for (long k = 0; k < n; k++) w->moved[k] = touching[k] ? w->moved[k] : y0[k] - t1 * all->y1[k] - t2 * all->y2[k];
    film_heights_times(f, z, &w->seen, &w->heights, 1, w->moved, w->pushed);
    const float all_1 = (float)(c1 * dot(all->area_by, w->moved, n)), all_2 = (float)(c2 * dot(all->volume_by, w->moved, n));
    for (long k = 0; k < n; k++)
        w->pushed[k] = touching[k] ? -(residual[k] + w->pushed[k] + all_1 * all->area_by[k] + all_2 * all->volume_by[k]) : 0;
}

/* Which nodes touch where heights have moved and contacts push as they do; returns whether others did before. */
static int decide_contact(const Film *f, const Bodies *bodies, double loose, int after_step, int may_release, Work *w) {
    const double *z = w->x + 2 * f->count;
    const double released = -loose * RELEASED * f->dx * f->dy, attached = loose * ATTACHED;
    Seen *s = &w->seen;
    int changed = 0;
    for (long i = most(s->box[0], 1); i < least(s->box[1], f->columns - 1); i++)
        for (long k = i * f->line + s->box[2]; k < i * f->line + s->box[3]; k++) {
            if (!film_free(f, i, k % f->line)) continue;
            const double over = z[k] + (after_step ? (double)w->moved[k] : 0) - s->obstacle[k] + s->lower[k];
            const double force = after_step ? (double)w->pushed[k] : w->force[k];
            const int touches = s->touching[k] ? isfinite(over) && (!may_release || force > released) : over > attached;
            if (touches == s->touching[k]) continue;
            s->touching[k] = (uint8_t)touches, changed = 1;
            if (touches) find_edges(f, bodies, w->x, k, EDGE_HALVES, s);
        }
    return changed;
}

/* Largest size of a whole number of eights; NaN where one is no number. */
static double largest_of(const float *values, long n) {
    float largest[8] = {0}, nothing[8] = {0};
    for (long k = 0; k < n; k += 8)
        for (long l = 0; l < 8; l++) {
            const float size = fabsf(values[k + l]);
            largest[l] = size > largest[l] ? size : largest[l], nothing[l] += 0 * size;
        }
    for (long l = 1; l < 8; l++) largest[0] = most_float(largest[0], largest[l]), nothing[0] += nothing[l];
    return (double)(largest[0] + nothing[0]);
}

/* Heights and contact, with the sheet's stiffness as it is now; found anew as long as others touch. */
static int settle_heights(const Film *f, const Settings *set, const Bodies *bodies, double loose, int first, int most_sets, Work *w,
                          int *changed) {
    const double *z = w->x + 2 * f->count;
    int other = decide_contact(f, bodies, loose, 0, 1, w);
    for (int sets = 0; sets < most_sets; sets++) {
        if (widen_window(f, 0, w)) see_sheet(f, set, FILM_HEIGHTS, w), first = 1;
        const double pulling = find_springs(f, z, &w->seen);
        stiffen_edges(f, z, 1, w);
        const int fresh = first || other || pulling != w->pulled;
        if (fresh) {
            *changed = 1, first = 0, w->pulled = pulling;
            if (prepare_heights(f, z, w)) return 1;
        }
        step_heights(f, z, fresh, w);
        if (sets == most_sets - 1) return 0;
        /* after a long step forces say little of who will let go */
        if (!(other = decide_contact(f, bodies, loose, 1, largest_of(w->moved, f->count) < SHORT, w))) return 0;
        stiffen_edges(f, z, -1, w);
    }
    return 0;
}

/* -- in the plane ------------------------------------------------------------------------------------------------------ */

/* The step (2, count) into `plane`; returns its largest. Frictionless: a contact pushes along the body's normal. */
static double step_plane(const Film *f, Work *w) {
    const long n = f->count;
    for (long c = 0; c < 2; c++)
        for (long k = 0; k < n; k++) w->plane[c * n + k] = (float)(w->force[k] * w->seen.slope[c * n + k]) - w->residual[c * n + k];
    film_plane_solve(f, w->plane_factor, w->plane, w->plane_room);
    const double largest = largest_of(w->plane, 2 * n);
    if (largest > LONGEST_SHIFT)
        for (long k = 0; k < 2 * n; k++) w->plane[k] *= (float)(LONGEST_SHIFT / largest);
    return largest;
}

/* -- all of it --------------------------------------------------------------------------------------------------------- */

/* Goes on as the film last went, `trend` (4, nodes) of displacements and forces, as far as the bodies that touch did. */
static void go_on(const Film *f, const double *trend, Work *w) {
    const long n = f->count, nodes = f->columns * f->rows;
    const Seen *s = &w->seen;
    double along = 0, trends = 0, gaps = 0;
    for (long i = s->box[0]; i < s->box[1]; i++)
        for (long j = s->box[2]; j < s->box[3]; j++) {
            const long k = i * f->line + j, node = i * f->rows + j;
            if (!s->touching[k] || isinf(s->obstacle[k])) continue;
            const double gap = s->obstacle[k] - s->lower[k] - w->x[2 * n + k];
            const double went = trend[2 * nodes + node] - s->slope[k] * trend[node] - s->slope[n + k] * trend[nodes + node];
            along += gap * went, trends += square(went), gaps += square(gap);
        }
    const double share = along / trends; /* not finite where nothing went on */
    if (!(fabs(share) < MOST_TREND && along * share > LEAST_EXPLAINED * gaps)) return;
    for (long i = 0; i < 3 * f->columns; i++)
        for (long j = 0; j < f->rows; j++) w->x[i * f->line + j] += share * trend[i * f->rows + j];
    for (long i = 0; i < f->columns; i++)
        for (long j = 0; j < f->rows; j++) {
            const long k = i * f->line + j;
            w->force[k] = s->touching[k] ? most(w->force[k] + share * trend[3 * nodes + i * f->rows + j], 0) : 0;
        }
    follow_bodies(f, w->x, &w->seen);
}

/* Writes padded fields, and, into `change`, what that changed. */
static void hand_over(const Film *f, long fields, const double *from, double *to, double *change) {
    for (long i = 0; i < fields * f->columns; i++)
        for (long j = 0; j < f->rows; j++) {
            const double value = from[i * f->line + j];
            change[i * f->rows + j] = value - to[i * f->rows + j], to[i * f->rows + j] = value;
        }
}

/* Bodies at the nodes, `lifted` m off where they are. */
static void look(const Film *f, const Bodies *bodies, double lifted, int step, Work *w) {
    if (step < LOOKS) {
        see_bodies(f, bodies, w->x, &w->seen);
        for (long k = w->seen.box[0] * f->line; k < w->seen.box[1] * f->line; k++)
            if (w->seen.touching[k]) find_edges(f, bodies, w->x, k, EDGE_HALVES, &w->seen);
    } else {
        follow_bodies(f, w->x, &w->seen);
    }
    lower_round_bodies(f, &w->seen);
    if (lifted != 0)
        for (long k = 0; k < f->count; k++) w->seen.obstacle[k] += lifted;
}

/* Heights and plane by one step; the larger of both, or NaN. `wider`: the window is another. */
static double step_both(const Film *f, const Settings *set, const Bodies *bodies, int step, int wider, Work *w, double *lift,
                        int *changed) {
    const long n = f->count;
    const double loose = step < PATIENCE ? 1 : least(step - PATIENCE + 1, MOST_LOOSE);
    if (settle_heights(f, set, bodies, loose, wider, step < QUICK ? MOST_SETS : 1, w, changed)) return NAN;
    double *z = w->x + 2 * n;
    float *now = w->learnt.now;
    for (long k = 0; k < n; k++) {
        now[2 * n + k] = w->moved[k], now[3 * n + k] = w->pushed[k] - (float)w->force[k];
        z[k] += (double)w->moved[k], w->force[k] = (double)w->pushed[k];
    }
    *lift = largest_of(w->moved, n);
    see_sheet(f, set, FILM_PLANE, w);
    const double shift = step_plane(f, w);
    for (long k = 0; k < 2 * n; k++) now[k] = w->plane[k], w->x[k] += (double)w->plane[k];
    return isfinite(*lift) && isfinite(shift) ? most(*lift, shift) : NAN;
}

/* Returns a status. */
static int come_to_rest(const Film *f, const Settings *set, const Bodies *bodies, double lifted, const double *trend, double *found, Work *w) {
    const long n = f->count;
    double last_before = FIRST_STEP, lift;
    int far = 0;
    Learnt *l = &w->learnt;
    film_forget(l);
    const int narrow = trend && !f->lopsided; /* second tries see all; beyond a window the sheet is what it is when turned */
    w->heights.first = narrow ? f->columns : 0, w->heights.last = narrow ? -1 : f->columns - 1;
    see_touch(f, w->force, &w->seen), find_floors(f, bodies, &w->seen);
    for (int step = 0; step < (int)set->most_steps; step++) {
        look(f, bodies, lifted, step, w);
        const int misplaced = step ? CONVERGED : against_the_frame(f, set, &w->seen);
        if (misplaced) return misplaced;
        if (!step && trend) go_on(f, trend, w);
        /* a first step's window has no factor yet, also where it is whole from the beginning and nothing touches */
        const int wider = widen_window(f, step ? 0 : NEAR, w) || !step;
        see_sheet(f, set, FILM_HEIGHTS, w);
        if (w->sums.least_turn < LEAST_TURN) return INSIDE_OUT;
        if (!isfinite(w->sums.area)) return BROKEN_DOWN;
        int changed = 0;
        const double last = step_both(f, set, bodies, step, wider, w, &lift, &changed);
        if (isnan(last)) return BROKEN_DOWN;
        found[STEPS] += 1, found[LAST_STEP] = last, found[PRESSURE] = w->pressure, found[VOLUME] = w->sums.volume;
        found[STRETCHED_AREA] = w->sums.area, found[TENSION] = w->sums.tension;
        /* steps shrink by a share that the last two tell; what all that would follow add up to is left */
        if (!step) far = lift > SHORT;
        const double shrinks = clip(last / last_before, far ? LEAST_SHARE_FAR : LEAST_SHARE, 0.9);
        if ((!changed || !step) && last * shrinks / (1 - shrinks) < set->tolerance) return CONVERGED;
        last_before = last;
        if (!film_learn(l, changed)) continue;
        for (long k = 0; k < 3 * n; k++) w->x[k] += (double)(l->now[k] - l->last[k]);
        for (long k = 0; k < n; k++)
            w->force[k] = w->seen.touching[k] ? w->force[k] + (double)(l->now[3 * n + k] - l->last[3 * n + k]) : 0;
    }
    return NOT_CONVERGED;
}

/* Too large a jump: from rest, with bodies that come in smaller ones. */
static int come_from_rest(const Film *f, const Settings *set, const Bodies *bodies, const double *rest, double *found, Work *w) {
    film_pad(f, 3, rest, w->x), memset(w->force, 0, f->count * sizeof *w->force);
    see_touch(f, w->force, &w->seen), see_bodies(f, bodies, w->x, &w->seen);
    double deep = 0;
    int status = NOT_CONVERGED;
    for (long k = 0; k < f->count; k++) deep = most(deep, w->x[2 * f->count + k] - w->seen.obstacle[k]);
    for (int jump = JUMPS - 1; jump >= 0; jump--) {
        status = come_to_rest(f, set, bodies, deep * jump / JUMPS, 0, found, w);
        if (status != CONVERGED && status != NOT_CONVERGED) break;
    }
    return status;
}

/* Whether what was found is what a film can tell of. */
static int can_be(const Film *f, const Bodies *bodies, const Work *w) {
    if (f->numbers.neo_hookean != 0 && (w->sums.least_root - f->numbers.law_middle) * f->numbers.law_per_unit < -1) return OVERSTRETCHED;
    return goes_through(f, bodies, w->x, &w->seen) ? GOES_THROUGH : CONVERGED;
}

int64_t film_solve(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                   const double *rest, int64_t roomy, double *room, int64_t environments, int64_t begin, int64_t end,
                   const double *settings, int64_t bodies, const double *body, int64_t pooled, const double *pool, double *x,
                   double *force, double *trend, double *found) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > FILM_MOST_LINE || keeping < film_kept(numbers)) return REFUSED;
    if (roomy < room_of(&f) || begin < 0 || end > environments) return REFUSED;
    (void)pooled;
    const long n = f.count, nodes = columns * rows;
    const RestHeights at_rest = film_heights_at(&f, (float *)kept);
    Work w = work_in(&f, &at_rest, kept + film_heights_size(&f), room);
    long faced = 0;
    for (long b = begin * bodies; b < end * bodies; b++) faced = (long)most(faced, film_faces_of((const FilmBody *)body + b));
    faced *= bodies;
    double *faces = faced ? malloc(faced * sizeof *faces) : 0;
    if (faced && !faces) return NO_MEMORY;
    for (long e = begin; e < end; e++) {
        double *own_x = x + e * 3 * nodes, *own_force = force + e * nodes, *own_trend = trend + e * 4 * nodes, *own = found + e * FOUND;
        const Bodies own_bodies = {bodies, body + e * bodies * FILM_BODY, pool, faces};
        if (faces) film_faces(&own_bodies, faces);
        const Settings *set = (const Settings *)settings + e;
        memset(own, 0, FOUND * sizeof *own);
        film_pad(&f, 3, own_x, w.x), film_pad(&f, 1, own_force, w.force);
        int status = come_to_rest(&f, set, &own_bodies, 0, own_trend, own, &w);
        if (status == CONVERGED) status = can_be(&f, &own_bodies, &w);
        if (set->again && (status == GOES_THROUGH || status == NOT_CONVERGED || status == INSIDE_OUT || status == BROKEN_DOWN))
            status = come_from_rest(&f, set, &own_bodies, rest, own, &w);
        if (status == CONVERGED) status = can_be(&f, &own_bodies, &w);
        own[STATUS] = status;
        for (long k = 0; k < n; k++) w.seen.cell[k] = (double)w.swells[k];
        if (status == CONVERGED) add_up(&f, w.x, w.force, own, &w.seen);
        hand_over(&f, 3, w.x, own_x, own_trend), hand_over(&f, 1, w.force, own_force, own_trend + 3 * nodes);
    }
    free(faces);
    return 0;
}

/* Where a film that is at rest on bodies makes a step of its heights: all that this takes but the bodies' own change. */
static int begin_answer(const Film *f, const Settings *set, const Bodies *bodies, Work *w) {
    const double *z = w->x + 2 * f->count;
    see_touch(f, w->force, &w->seen), look_narrowly(f, bodies, &w->seen);
    w->heights.first = f->lopsided ? 0 : f->columns, w->heights.last = f->lopsided ? f->columns - 1 : -1;
    look(f, bodies, 0, 0, w), widen_window(f, 0, w);
    see_sheet(f, set, FILM_HEIGHTS, w);
    find_springs(f, z, &w->seen), stiffen_edges(f, z, 1, w);
    memset(w->residual + 2 * f->count, 0, f->count * sizeof *w->residual);
    return prepare_heights(f, z, w);
}

int64_t film_answer(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                    int64_t roomy, double *room, const double *settings, int64_t bodies, int64_t changes, const double *body,
                    int64_t pooled, const double *pool, const double *steps, const double *x, const double *force, double *by_z,
                    double *by_force) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > FILM_MOST_LINE || keeping < film_kept(numbers)) return REFUSED;
    if (roomy < room_of(&f)) return REFUSED;
    (void)pooled;
    const long n = f.count, nodes = columns * rows;
    const RestHeights at_rest = film_heights_at(&f, (float *)kept);
    const Bodies base = {bodies, body, pool, 0};
    Work w = work_in(&f, &at_rest, kept + film_heights_size(&f), room);
    Seen *s = &w.seen;
    film_pad(&f, 3, x, w.x), film_pad(&f, 1, force, w.force);
    if (begin_answer(&f, (const Settings *)settings, &base, &w)) return NOT_DEFINITE;
    const double *z = w.x + 2 * n;
    double *was = w.fine.elastic;
    for (long k = 0; k < n; k++) was[k] = s->obstacle[k] - s->lower[k];
    for (long a = 0; a < changes; a++) {
        const Bodies changed = {bodies, body + (1 + a) * bodies * FILM_BODY, pool, 0};
        look(&f, &changed, 0, 0, &w);
        for (long k = 0; k < n; k++) {
            const double rise = (s->obstacle[k] - s->lower[k] - was[k]) / steps[a];
            s->obstacle[k] = z[k] + (isfinite(rise) ? rise : 0), s->lower[k] = 0; /* a step is from where the film is */
        }
        step_heights(&f, z, a == 0, &w);
        for (long i = 0; i < columns; i++)
            for (long j = 0; j < rows; j++) {
                const long to = a * nodes + i * rows + j, from = i * f.line + j;
                by_z[to] = (double)w.moved[from], by_force[to] = (double)w.pushed[from];
            }
    }
    return 0;
}

/* The sheet's stiffness at `x`, less that of a gas, in memory of its own, to be freed by `block[0]`; 1: there is none left. */
static int stiffness_at(const Film *f, const double *x, double pressure, Stencil *stencil) {
    float *room = malloc(film_stencil_size(f) * sizeof *room);
    if (!room) return 1;
    *stencil = film_stencil_in(f, &room);
    film_stencil(f, x, pressure, stencil);
    return 0;
}

int64_t film_keep(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *x, int64_t roomy, double *room,
                  int64_t keeping, float *kept) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > FILM_MOST_LINE || keeping < film_kept(numbers)) return REFUSED;
    if (roomy < room_of(&f)) return REFUSED;
    RestHeights rest = film_heights_at(&f, kept);
    Work w = work_in(&f, &rest, kept, room);
    Stencil stencil;
    film_pad(&f, 3, x, w.x);
    if (film_heights_rest(&f, w.x, &w.fine, &rest)) return NOT_DEFINITE;
    if (stiffness_at(&f, w.x, 0, &stencil)) return NO_MEMORY;
    const int code = film_plane_factor(&f, &stencil, kept + film_heights_size(&f));
    free(stencil.block[0]);
    return code ? NOT_DEFINITE : 0;
}

int64_t film_stiffness(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *x, double pressure,
                       int64_t roomy, double *room, double *factor) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < 3 * f.count + LANES) return REFUSED;
    Stencil stencil;
    film_pad(&f, 3, x, room), memset(room + 3 * f.count, 0, LANES * sizeof *room);
    if (stiffness_at(&f, room, pressure, &stencil)) return NO_MEMORY;
    film_stencil_band(&f, &stencil, factor);
    free(stencil.block[0]);
    return band_cholesky(3 * f.inner, FILM_WIDTH(&f), factor) ? NOT_DEFINITE : 0;
}
