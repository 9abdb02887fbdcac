/* The film at rest on bodies: see film.h, and mjtactile/film for the equations.

   Unknown are displacements of the nodes and the contact's forces along z. A step solves twice, each time with a matrix that is
   good enough: in the plane with the stiffness of the sheet at rest, which never changes, and for the heights with that of a film
   under the sheet's local tension, plus what tension and gas add when the whole sheet moves (rank two). Residuals are exact, so
   that where the steps end does not depend on the matrices. */
#include "film.h"

#include <math.h>

#include <stdlib.h>
#include <string.h>

#include "band.h"
#include "film_work.h"
#include "kernels.h"
#include "small.h"

#define RELEASED 2.0       /* Pa that may pull at a node before it is let go */
#define ATTACHED 2e-7      /* m that a node may be in a body before it is held */
#define PATIENCE 8         /* steps after which both grow, up to MOST_LOOSE times: on flat faces nodes come and go for next to nothing */
#define MOST_LOOSE 10
#define LONGEST_SHIFT 5e-4 /* m, of a step in the plane */
#define SHELL 0.3
#define LOOKS 3             /* steps that ask the bodies; later ones follow their slopes, else nodes at an edge come and go */
#define NEAR_SINGULAR 1e-12
#define MOST_LEARNT 10      /* of a step, beyond which nothing is learnt */
#define EDGE_HALVES 20
#define MOST_SETS 4          /* of nodes that touch, tried in a step */
#define QUICK 3              /* steps that do so */
#define SHORT 2e-4           /* m */
#define FIRST_STEP 1e-4      /* m, that the first step is thought to come after */
#define MOST_TREND 2.0
#define LEAST_EXPLAINED 0.5  /* of the gaps between bodies and the sheet, squared */
#define LEAST_SHARE 0.05     /* by which steps are thought to shrink at best; they do so by 0.3 at last, which far from rest comes sooner */
#define LEAST_SHARE_FAR 0.3
#define LEAST_TURN 0.05    /* of a cell's shadow: below, the sheet is inside out */

long film_work_size(const Film *f) {
    return (3 + 3 + 5 + 2 + 2 + 1 + 8 + 4 + 2 + 2 + 8 * MEMORY + 12) * f->count + 7 * f->inner +
           f->inner * BAND_STRIDE(f->inner_rows + 1) + f->count / 8 + 1;
}

int64_t film_room(const double *numbers) {
    const Film f = film_of(numbers, 0);
    return film_work_size(&f);
}

static double *take(double **from, long n) {
    double *here = *from;
    *from += n;
    return here;
}

Work film_work(const Film *f, double *room) {
    const long n = f->count;
    Work w;
    w.fields.elastic = take(&room, 3 * n), w.fields.gradient = take(&room, 3 * n);
    w.fields.own = take(&room, n), w.fields.up = take(&room, n), w.fields.right = take(&room, n);
    w.fields.right_up = take(&room, n), w.fields.right_down = take(&room, n);
    w.obstacle = take(&room, n), w.level = take(&room, n), w.slope = take(&room, 2 * n), w.lower = take(&room, n);
    w.edge = take(&room, 4 * n), w.spring = take(&room, 4 * n), w.away = take(&room, 2 * n);
    w.residual = take(&room, n), w.moved = take(&room, n), w.pushed = take(&room, n);
    w.plane = take(&room, 2 * f->inner);
    w.y0 = take(&room, f->inner), w.pulled = 0;
    w.whole.area_by = take(&room, n), w.whole.volume_by = take(&room, n);
    w.whole.b1 = take(&room, f->inner), w.whole.b2 = take(&room, f->inner);
    w.whole.y1 = take(&room, f->inner), w.whole.y2 = take(&room, f->inner);
    w.band = take(&room, f->inner * BAND_STRIDE(f->inner_rows + 1));
    w.steps = take(&room, 4 * MEMORY * n), w.changes = take(&room, 4 * MEMORY * n);
    w.last_step = take(&room, 4 * n), w.now = take(&room, 4 * n), w.start = take(&room, 4 * n);
    w.touching = (uint8_t *)take(&room, n / 8 + 1);
    return w;
}

static double dot(const double *a, const double *b, long n) {
    double sum = 0;
    for (long i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* -- heights ----------------------------------------------------------------------------------------------------------- */

/* out = stiffness of the heights times `what`, at the inner nodes; `what` is zero on the frame. */
static void stiffness_times(const Film *f, const SheetFields *s, const double *what, double *out) {
    const long rows = f->rows;
    for (long i = 1; i < f->columns - 1; i++) {
        const long at = i * rows;
        for (long j = 1; j < rows - 1; j++) {
            const long k = at + j;
            out[k] = s->own[k] * what[k] + s->up[k] * what[k + 1] + s->up[k - 1] * what[k - 1] + s->right[k] * what[k + rows] +
                     s->right[k - rows] * what[k - rows] + s->right_up[k] * what[k + rows + 1] +
                     s->right_up[k - rows - 1] * what[k - rows - 1] + s->right_down[k] * what[k + rows - 1] +
                     s->right_down[k - rows + 1] * what[k - rows + 1];
        }
    }
}

/* Edges' springs into residual and stiffness; `by` -1 takes them out again. */
static void stiffen_edges(const Film *f, const double *z, double by, Work *w) {
    SheetFields *s = &w->fields;
    for (long k = f->rows; k < f->count - f->rows; k++) {
        if (!w->touching[k]) continue;
        double *links[4] = {s->right + k, s->right + k - f->rows, s->up + k, s->up + k - 1};
        for (int side = 0; side < 4; side++) {
            const double spring = by * w->spring[side * f->count + k];
            if (spring == 0) continue;
            const long other = k + film_next(f, side);
            const double force = -spring * rises_over_edge(f, w, z, k, side);
            *links[side] -= spring, s->own[k] += spring, s->own[other] += spring;
            w->residual[k] += force, w->residual[other] -= force;
        }
    }
}

/* Factor of the stiffness with the nodes that touch held. */
static int factor_heights(const Film *f, const Work *w) {
    const long rows = f->rows, inner_rows = f->inner_rows, stride = BAND_STRIDE(inner_rows + 1);
    const SheetFields *s = &w->fields;
    memset(w->band, 0, f->inner * stride * sizeof *w->band);
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < rows - 1; j++) {
            const long k = i * rows + j;
            double *column = w->band + ((i - 1) * inner_rows + j - 1) * stride;
            if (w->touching[k]) {
                column[0] = 1;
                continue;
            }
            column[0] = s->own[k];
            if (j < rows - 2 && !w->touching[k + 1]) column[1] = s->up[k];
            if (i == f->columns - 2) continue;
            if (j > 1 && !w->touching[k + rows - 1]) column[inner_rows - 1] += s->right_down[k];
            if (!w->touching[k + rows]) column[inner_rows] += s->right[k];
            if (j < rows - 2 && !w->touching[k + rows + 1]) column[inner_rows + 1] = s->right_up[k];
        }
    return band_cholesky(f->inner, inner_rows + 1, w->band);
}

/* What a curved sheet adds where it is bent further: it must stretch, as a shell does, Y (k_x l_y^2 + k_y l_x^2)^2 for a wave
   (l_x, l_y) of length one on curvatures k; here for the mean of all waves. Speeds up the steps and changes nothing else. */
static void stiffen_curved(const Film *f, const double *z, Work *w) {
    const double stretch = SHELL * f->numbers.shell, rows = f->rows;
    const long r = (long)rows;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < r - 1; j++) {
            const long k = i * r + j;
            const double bend_x = (z[k + r] + z[k - r] - 2 * z[k]) / square(f->dx);
            const double bend_y = (z[k + 1] + z[k - 1] - 2 * z[k]) / square(f->dy);
            w->fields.own[k] += stretch * f->dx * f->dy * (square(bend_x) + square(bend_y)) / 2;
        }
}

/* Inner nodes that do not touch, from a field or back to it; others are zero. */
static void gather(const Film *f, const uint8_t *touching, const double *field, double *inner) {
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j;
            inner[(i - 1) * f->inner_rows + j - 1] = touching[k] ? 0 : field[k];
        }
}

static void solve_heights(const Film *f, const Work *w, double *inner) {
    band_forward(f->inner, f->inner_rows + 1, w->band, inner), band_backward(f->inner, f->inner_rows + 1, w->band, inner);
}

/* Factor with the nodes that touch held, and what tension and gas add to it, which answer to the whole of a step: a rank of two.
   Sheets change little while the same nodes touch, so that it is kept until others do. */
static int prepare_heights(const Film *f, const SheetSums *sums, double gas_stiffness, Work *w) {
    const double over_tension = 1 / most(sums->tension, 1e-3);
    Whole *all = &w->whole;
    for (long i = 1; i < f->columns - 1; i++)
        for (long k = i * f->rows + 1; k < (i + 1) * f->rows - 1; k++) { /* area's slope: what pulls heights back, over the tension */
            all->area_by[k] = w->fields.elastic[2 * f->count + k] * over_tension;
            all->volume_by[k] = w->fields.gradient[2 * f->count + k];
        }
    all->tension = f->numbers.tension_slope / (f->numbers.length_x * f->numbers.length_y), all->gas = gas_stiffness;
    if (factor_heights(f, w)) return 1;
    gather(f, w->touching, all->area_by, all->b1), gather(f, w->touching, all->volume_by, all->b2);
    memcpy(all->y1, all->b1, f->inner * sizeof *all->b1), memcpy(all->y2, all->b2, f->inner * sizeof *all->b2);
    solve_heights(f, w, all->y1), solve_heights(f, w, all->y2);
    return 0;
}

/* The heights' step `moved` and what it leaves for the contact to carry, `pushed`. */
static void step_heights(const Film *f, const double *z, Work *w) {
    const Whole *all = &w->whole;
    const long n = f->inner, rows = f->rows;
    const double c1 = all->tension, c2 = all->gas;
    for (long k = 0; k < f->count; k++) w->moved[k] = w->touching[k] ? w->obstacle[k] - w->lower[k] - z[k] : 0;
    stiffness_times(f, &w->fields, w->moved, w->pushed);
    const double held_1 = c1 * dot(all->area_by, w->moved, f->count), held_2 = c2 * dot(all->volume_by, w->moved, f->count);
    for (long k = 0; k < f->count; k++)
        w->pushed[k] = -(w->residual[k] + w->pushed[k] + held_1 * all->area_by[k] + held_2 * all->volume_by[k]);
    gather(f, w->touching, w->pushed, w->y0);
    solve_heights(f, w, w->y0);
    const double m11 = 1 + c1 * dot(all->b1, all->y1, n), m12 = c1 * dot(all->b1, all->y2, n), m21 = c2 * dot(all->b2, all->y1, n);
    const double m22 = 1 + c2 * dot(all->b2, all->y2, n), r1 = c1 * dot(all->b1, w->y0, n), r2 = c2 * dot(all->b2, w->y0, n);
    const double det = m11 * m22 - m12 * m21, t1 = (r1 * m22 - r2 * m12) / det, t2 = (m11 * r2 - m21 * r1) / det;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < rows - 1; j++) {
            const long k = i * rows + j, m = (i - 1) * f->inner_rows + j - 1;
            if (!w->touching[k]) w->moved[k] = w->y0[m] - t1 * all->y1[m] - t2 * all->y2[m];
        }
    stiffness_times(f, &w->fields, w->moved, w->pushed);
    const double all_1 = c1 * dot(all->area_by, w->moved, f->count), all_2 = c2 * dot(all->volume_by, w->moved, f->count);
    for (long k = 0; k < f->count; k++)
        w->pushed[k] = w->touching[k] ? -(w->residual[k] + w->pushed[k] + all_1 * all->area_by[k] + all_2 * all->volume_by[k]) : 0;
}

/* Which nodes touch where heights are `moved` from `z` and contacts push with `force`; returns whether others did before. */
static int decide_contact(const Film *f, const Bodies *bodies, const double *x, const double *moved, const double *force, double loose,
                          int may_release, Work *w) {
    const double *z = x + 2 * f->count;
    const double released = -loose * RELEASED * f->dx * f->dy, attached = loose * ATTACHED;
    int changed = 0;
    for (long i = 1; i < f->columns - 1; i++)
        for (long k = i * f->rows + 1; k < (i + 1) * f->rows - 1; k++) {
            const double over = z[k] + moved[k] - w->obstacle[k] + w->lower[k];
            const int touches = w->touching[k] ? isfinite(over) && (!may_release || force[k] > released) : over > attached;
            if (touches == w->touching[k]) continue;
            w->touching[k] = (uint8_t)touches, changed = 1;
            if (touches) find_edges(f, bodies, x, k, EDGE_HALVES, w);
        }
    return changed;
}

/* -- in the plane ------------------------------------------------------------------------------------------------------ */

/* The step (2 inner) into `plane`; returns what it does to the volume. Frictionless: a contact pushes along the body's normal. */
static double step_plane(const Film *f, Work *w, const double *plane_factor, double pressure, const double *force, double *largest) {
    const double *elastic = w->fields.elastic, *volume_by = w->fields.gradient;
    double bulge = 0;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j, m = 2 * ((i - 1) * f->inner_rows + j - 1);
            for (int c = 0; c < 2; c++) {
                const long at = c * f->count + k;
                w->plane[m + c] = pressure * volume_by[at] - elastic[at] + (force[k] > 0 ? force[k] * w->slope[at] : 0);
            }
        }
    band_forward(2 * f->inner, FILM_PLANE_WIDTH(f), plane_factor, w->plane);
    band_backward(2 * f->inner, FILM_PLANE_WIDTH(f), plane_factor, w->plane);
    *largest = 0;
    for (long m = 0; m < 2 * f->inner; m++) *largest = most(*largest, fabs(w->plane[m]));
    if (*largest > LONGEST_SHIFT)
        for (long m = 0; m < 2 * f->inner; m++) w->plane[m] *= LONGEST_SHIFT / *largest;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j, m = 2 * ((i - 1) * f->inner_rows + j - 1);
            bulge += w->plane[m] * volume_by[k] + w->plane[m + 1] * volume_by[f->count + k];
        }
    return bulge;
}

static void move_plane(const Film *f, const double *plane, double by, double *x) {
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j, m = 2 * ((i - 1) * f->inner_rows + j - 1);
            x[k] += by * plane[m], x[f->count + k] += by * plane[m + 1];
        }
}

/* -- learning from steps ----------------------------------------------------------------------------------------------- */

/* Solves A y = b in place, symmetric and positive, of order n <= MEMORY. */
static void solve_small(long n, double A[MEMORY][MEMORY], double *b) {
    double trace = 0;
    for (long k = 0; k < n; k++) trace += A[k][k];
    for (long k = 0; k < n; k++) A[k][k] += NEAR_SINGULAR * trace;
    for (long k = 0; k < n; k++) {
        for (long i = k + 1; i < n; i++) {
            const double by = A[i][k] / A[k][k];
            for (long j = k; j < n; j++) A[i][j] -= by * A[k][j];
            b[i] -= by * b[k];
        }
    }
    for (long k = n - 1; k >= 0; k--) {
        for (long j = k + 1; j < n; j++) b[k] -= A[k][j] * b[j];
        b[k] /= A[k][k];
    }
}

/* Anderson's mixing: `now` (4, count), the step that displacements and forces are about to make, becomes the one that would have
   ended at rest had the last `known` steps changed in proportion (Walker & Ni, SIAM J. Numer. Anal. 49, 2011). */
static void learn(const Film *f, Work *w, long known) {
    const long all = 4 * f->count, places = 3 * f->count;
    double A[MEMORY][MEMORY], share[MEMORY];
    for (long a = 0; a < known; a++) {
        share[a] = dot(w->changes + a * all, w->now, places);
        for (long b = 0; b <= a; b++) A[a][b] = A[b][a] = dot(w->changes + a * all, w->changes + b * all, places);
    }
    solve_small(known, A, share);
    for (long a = 0; a < known; a++)
        if (!(fabs(share[a]) < MOST_LEARNT)) return;
    for (long a = 0; a < known; a++) {
        for (long k = 0; k < all; k++) w->now[k] -= share[a] * (w->steps[a * all + k] + w->changes[a * all + k]);
    }
}

/* -- all of it --------------------------------------------------------------------------------------------------------- */

/* Heights and contact, with the sheet's stiffness as it is now; found anew as long as others touch. */
static int settle_heights(const Film *f, const Bodies *bodies, const double *x, const double *force, const SheetSums *sums,
                          double pressure, double gas_stiffness, double loose, int first, int most_sets, Work *w,
                          int *changed) {
    const double *z = x + 2 * f->count;
    for (long k = 0; k < f->count; k++)
        w->residual[k] = w->fields.elastic[2 * f->count + k] - pressure * w->fields.gradient[2 * f->count + k];
    stiffen_curved(f, z, w);
    memset(w->moved, 0, f->count * sizeof *w->moved);
    int other = decide_contact(f, bodies, x, w->moved, force, loose, 1, w);
    for (int sets = 0; sets < most_sets; sets++) {
        const double pulling = find_springs(f, z, w);
        stiffen_edges(f, z, 1, w);
        if (first || other || pulling != w->pulled) {
            *changed = 1, first = 0, w->pulled = pulling;
            if (prepare_heights(f, sums, gas_stiffness, w)) return 1;
        }
        step_heights(f, z, w);
        double largest = 0; /* after a long step forces say little of who will let go */
        for (long k = 0; k < f->count; k++) largest = most(largest, fabs(w->moved[k]));
        if (sets == most_sets - 1 || !(other = decide_contact(f, bodies, x, w->moved, w->pushed, loose, largest < SHORT, w))) return 0;
        stiffen_edges(f, z, -1, w);
    }
    return 0;
}

/* Goes on as the film last went, `trend` (4, count) of displacements and forces, as far as the bodies that touch did. */
static void go_on(const Film *f, const double *trend, double *x, double *force, Work *w) {
    const long count = f->count;
    double along = 0, trends = 0, gaps = 0;
    for (long k = 0; k < count; k++) {
        if (!w->touching[k] || isinf(w->obstacle[k])) continue;
        const double gap = w->obstacle[k] - w->lower[k] - x[2 * count + k];
        const double went = trend[2 * count + k] - w->slope[k] * trend[k] - w->slope[count + k] * trend[count + k];
        along += gap * went, trends += square(went), gaps += square(gap);
    }
    const double share = along / trends; /* not finite where nothing went on */
    if (!(fabs(share) < MOST_TREND && along * share > LEAST_EXPLAINED * gaps)) return;
    for (long k = 0; k < 3 * count; k++) x[k] += share * trend[k];
    for (long k = 0; k < count; k++) force[k] = w->touching[k] ? most(force[k] + share * trend[3 * count + k], 0) : 0;
    follow_bodies(f, x, w);
}

/* Bodies are `lifted` m off where they are; `trend` may be none. Returns a status. */
static int come_to_rest(const Film *f, const double *plane_factor, const Settings *set, const Bodies *bodies, double lifted,
                        const double *trend, double *x, double *force, double *found, Work *w) {
    const long count = f->count, all = 4 * count;
    const SheetFields no_stiffness = {.elastic = w->fields.elastic, .gradient = w->fields.gradient};
    int far = 0;
    long known = 0, newest = 0;
    double *z = x + 2 * count, last_before = FIRST_STEP;
    memset(w->now, 0, all * sizeof *w->now), memset(w->whole.area_by, 0, 2 * count * sizeof *w->now);
    for (long k = 0; k < count; k++) w->touching[k] = force[k] > 0;
    for (long step = 0; step < (long)set->most_steps; step++) {
        if (step < LOOKS) {
            see_bodies(f, bodies, x, w);
            for (long k = 0; k < count; k++)
                if (w->touching[k]) find_edges(f, bodies, x, k, EDGE_HALVES, w);
        } else {
            follow_bodies(f, x, w);
        }
        const int misplaced = step ? CONVERGED : against_the_frame(f, w);
        if (misplaced) return misplaced;
        lower_round_bodies(f, w);
        if (!step && trend) go_on(f, trend, x, force, w);
        for (long k = 0; k < count; k++) w->obstacle[k] += lifted;

        double pressure, gas_stiffness, largest = 0, largest_shift;
        SheetSums sums = film_sheet(f, x, &w->fields);
        if (sums.least_turn < LEAST_TURN) return INSIDE_OUT;
        if (!isfinite(sums.area)) return BROKEN_DOWN;
        gas_of(f, set, sums.volume, &pressure, &gas_stiffness);
        int changed = 0;
        const double loose = step < PATIENCE ? 1 : least(step - PATIENCE + 1, MOST_LOOSE);
        if (settle_heights(f, bodies, x, force, &sums, pressure, gas_stiffness, loose, !step, step < QUICK ? MOST_SETS : 1, w, &changed)) return BROKEN_DOWN;
        double *now_z = w->now + 2 * count, *now_force = w->now + 3 * count;
        for (long k = 0; k < count; k++) {
            now_z[k] = w->moved[k], now_force[k] = w->pushed[k] - force[k];
            z[k] += w->moved[k], force[k] = w->pushed[k];
            largest = most(largest, fabs(w->moved[k]));
        }
        sums = film_sheet(f, x, &no_stiffness);
        gas_of(f, set, sums.volume, &pressure, &gas_stiffness);
        step_plane(f, w, plane_factor, pressure, force, &largest_shift);
        memset(w->now, 0, 2 * count * sizeof *w->now);
        move_plane(f, w->plane, 1, w->now), move_plane(f, w->plane, 1, x);

        const double last = most(largest, largest_shift);
        if (!isfinite(last)) return BROKEN_DOWN;
        found[STEPS] += 1, found[LAST_STEP] = last, found[PRESSURE] = pressure, found[VOLUME] = sums.volume;
        found[STRETCHED_AREA] = sums.area, found[TENSION] = sums.tension;
        /* steps shrink by a share that the last two tell; what all that would follow add up to is left */
        if (!step) far = largest > SHORT;
        const double shrinks = clip(last / last_before, far ? LEAST_SHARE_FAR : LEAST_SHARE, 0.9);
        if ((!changed || !step) && last * shrinks / (1 - shrinks) < set->tolerance) return CONVERGED;
        last_before = last;
        if (changed) {
            known = 0;
        } else {
            double *slot = w->changes + newest * all;
            for (long k = 0; k < all; k++) slot[k] = w->now[k] - w->last_step[k];
            known = known < MEMORY ? known + 1 : MEMORY;
        }
        memcpy(w->last_step, w->now, all * sizeof *w->now);
        if (known) {
            learn(f, w, known);
            for (long k = 0; k < 3 * count; k++) x[k] += w->now[k] - w->last_step[k];
            for (long k = 0; k < count; k++) force[k] = w->touching[k] ? force[k] + now_force[k] - w->last_step[3 * count + k] : 0;
        }
        newest = changed ? 0 : (newest + 1) % MEMORY;
        memcpy(w->steps + newest * all, w->now, all * sizeof *w->now);
    }
    return NOT_CONVERGED;
}

int64_t film_solve(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *plane_factor,
                   const double *rest, int64_t roomy, double *room, int64_t environments, int64_t begin, int64_t end,
                   const double *settings, int64_t bodies, const double *body, int64_t pooled, const double *pool, double *x,
                   double *force, double *trend, double *found) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < film_work_size(&f) || begin < 0 || end > environments) return REFUSED;
    (void)pooled;
    Work w = film_work(&f, room);
    for (long e = begin; e < end; e++) {
        double *own_x = x + e * 3 * f.count, *own_force = force + e * f.count, *own = found + e * FOUND;
        double *own_trend = trend + e * 4 * f.count;
        const Bodies own_bodies = {bodies, body + e * bodies * FILM_BODY, pool};
        const Settings *set = (const Settings *)settings + e;
        memset(own, 0, FOUND * sizeof *own);
        memcpy(w.start, own_x, 3 * f.count * sizeof *x), memcpy(w.start + 3 * f.count, own_force, f.count * sizeof *x);
        int status = come_to_rest(&f, plane_factor, set, &own_bodies, 0, own_trend, own_x, own_force, own, &w);
        if (set->most_steps > 1 && (status == NOT_CONVERGED || status == INSIDE_OUT || status == BROKEN_DOWN)) { /* too large a jump: from rest, in smaller ones */
            memcpy(own_x, rest, 3 * f.count * sizeof *rest), memset(own_force, 0, f.count * sizeof *own_force);
            see_bodies(&f, &own_bodies, own_x, &w);
            double deep = 0;
            for (long k = 0; k < f.count; k++) deep = most(deep, own_x[2 * f.count + k] - w.obstacle[k]);
            const long jumps = 16;
            for (long jump = jumps - 1; jump >= 0; jump--) {
                status = come_to_rest(&f, plane_factor, set, &own_bodies, deep * jump / jumps, 0, own_x, own_force, own, &w);
                if (status != CONVERGED && status != NOT_CONVERGED) break;
            }
        }
        own[STATUS] = status;
        for (long k = 0; k < 3 * f.count; k++) own_trend[k] = own_x[k] - w.start[k];
        for (long k = 0; k < f.count; k++) own_trend[3 * f.count + k] = own_force[k] - w.start[3 * f.count + k];
        if (status == CONVERGED) add_up(&f, own_x, own_force, own, &w);
    }
    return 0;
}

/* Factor of the plane's stiffness at a deformation `x` (3, count). */
int64_t film_plane(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *x, double *factor) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows) return REFUSED;
    film_plane_stiffness(&f, x, factor);
    return band_cholesky(2 * f.inner, FILM_PLANE_WIDTH(&f), factor) ? NOT_DEFINITE : 0;
}
