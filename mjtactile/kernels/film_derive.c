/* How a film at rest answers small changes of its bodies, by the implicit function theorem: what touches goes on to touch, and
   the residuals stay zero. The tangent is that of the sheet and the gas, with the heights of what touches eliminated by the
   bodies' slopes, factored once. How residuals hang on the bodies is found by differences near what touches, which want no
   solution; so is what the tangent leaves out (how corrections and edges move with the nodes), by a second sweep. */
#include <math.h>
#include <string.h>

#include "film_stencil.h"
#include "film_work.h"
#include "kernels.h"
#include "panels.h"
#include "small.h"

#define AT_ONCE (LANES - 1)  /* changes that are solved together; the last lane is the gas's */
#define SWEEPS 2
#define SWEEPS_AT_EDGES 3
#define FINE_HALVES 36       /* edges are wanted to less than a difference of 1e-6 m shows */
#define SLIDE 1e-6           /* m, by which slopes are asked for their own */
#define ELSEWHERE 1e-4       /* m off a body, where a film does not rest on it */
#define BEHIND_MOST 10       /* times that may be behind what is thin, which is moved under nodes */

typedef struct {
    Seen seen;
    SheetFields fields;                 /* (3, count) twice: forces, and the volume's slopes */
    Stencil stiffness;
    float *band;                        /* of panels, 3 inner */
    double *slope, *spring, *obstacle;  /* where the film is: (2, count), (4, count), (count) */
    double *at, *pressed;               /* the film: (3, count), (count) */
    double *x, *force;                  /* moved: (3, count), (count) */
    double *base, *pressed_on;          /* what bodies do where the film is, and where it is moved: (4, count) */
    Eight *rhs;                         /* 3 inner, with room behind */
    Eight *residual;                    /* (4, count) by bodies: forces on nodes, and how far what touches is off its body */
    Eight *borne, *given;               /* (3, count): what the sheet bears of all that was found, and of what is found next */
    Eight *found;                       /* (4, count): displacements and forces */
    Lanes swells;                       /* m^3 of what was found */
    double gas_stiffness, pressure, tension;
    double sums[FOUND];                 /* what is added up where the film is */
} Tangent;

static long panels_of(const Film *f) { return (3 * f->inner + PANEL - 1) / PANEL; }

static long band_of(const Film *f) { return panels_of(f) * PANEL * panels_height(FILM_WIDTH(f)); }

static long rows_of(const Film *f) { return panels_of(f) * PANEL + panels_height(FILM_WIDTH(f)); }

static long room_of(const Film *f) {
    const long singles = film_stencil_size(f) + band_of(f) + PANEL * (rows_of(f) + 14 * f->count);
    return film_seen_size(f) + singles / 2 + (3 + 3 + 4 + 7 + 4 + 8) * f->count + 32;
}

int64_t film_derive_room(const double *numbers) {
    const Film f = film_of(numbers, 0);
    return room_of(&f);
}

static Tangent tangent_in(const Film *f, double *room) {
    const long n = f->count;
    Tangent t = {.seen = film_seen_in(f, &room)};
    t.fields.elastic = film_take(&room, 3 * n), t.fields.gradient = film_take(&room, 3 * n);
    t.fields.along_x = t.seen.along_x, t.fields.along_y = t.seen.along_y;
    float *floats = (float *)film_take(&room, film_stencil_size(f) / 2);
    t.stiffness = film_stencil_in(f, &floats);
    t.at = film_take(&room, 3 * n + 8), t.pressed = film_take(&room, n);
    t.band = (float *)film_take(&room, band_of(f) / 2), t.rhs = (Eight *)film_take(&room, PANEL / 2 * rows_of(f));
    t.slope = film_take(&room, 2 * n), t.spring = film_take(&room, 4 * n), t.obstacle = film_take(&room, n);
    t.x = film_take(&room, 3 * n + 8), t.force = film_take(&room, n), t.base = film_take(&room, 4 * n), t.pressed_on = film_take(&room, 4 * n);
    t.residual = (Eight *)film_take(&room, PANEL / 2 * 4 * n), t.borne = (Eight *)film_take(&room, PANEL / 2 * 3 * n);
    t.given = (Eight *)film_take(&room, PANEL / 2 * 3 * n), t.found = (Eight *)film_take(&room, PANEL / 2 * 4 * n);
    memset(t.base, 0, 8 * n * sizeof *t.base), memset(t.residual, 0, 4 * n * sizeof *t.residual);
    memset(t.at, 0, (3 * n + 8) * sizeof *t.at), memset(t.slope, 0, 2 * n * sizeof *t.slope);
    return t;
}

/* -- the tangent ------------------------------------------------------------------------------------------------------- */

/* Lines on and beside which bodies are seen. */
static long first_line(const Film *f, const Seen *s) { return s->box[0] < s->box[1] ? (long)most(s->box[0] - 1, 0) : f->columns; }

static long behind_lines(const Film *f, const Seen *s) { return (long)least(s->box[1] + 1, f->columns); }

static void add_entry(const Film *f, float *band, long m, int k, long n, int l, double value) {
    const long row = 3 * m + k, column = 3 * n + l;
    if (m >= 0 && n >= 0 && row >= column) band[column * panels_height(FILM_WIDTH(f)) + row - column / PANEL * PANEL] += (float)value;
}

/* Heights of what touches go with the slopes: their rows and columns are added to those in the plane. */
static void eliminate(const Film *f, const Tangent *t, int pair, long node, float K[3][3]) {
    const long other = node + film_pair(f, pair);
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++) K[k][l] = film_block(&t->stiffness, pair, k, l, node);
    if (t->seen.touching[node])
        for (int l = 0; l < 3; l++) {
            for (int k = 0; k < 2; k++) K[k][l] += (float)t->slope[k * f->count + node] * K[2][l];
            K[2][l] = 0;
        }
    if (t->seen.touching[other])
        for (int k = 0; k < 3; k++) {
            for (int l = 0; l < 2; l++) K[k][l] += (float)t->slope[l * f->count + other] * K[k][2];
            K[k][2] = 0;
        }
}

static void add_pairs(const Film *f, const Tangent *t) {
    const long height = panels_height(FILM_WIDTH(f));
    for (long i = 1; i < f->columns - 1; i++)
        for (long node = i * f->line + 1; node < i * f->line + f->rows - 1; node++)
            for (int pair = 0; pair < PAIRS; pair++) {
                const long first = 3 * film_inner(f, node), other = 3 * film_inner(f, node + film_pair(f, pair));
                float K[3][3];
                if (first < 0 || other < 0) continue;
                eliminate(f, t, pair, node, K);
                for (int k = 0; k < 3; k++) {
                    float *column = t->band + (first + k) * height - (first + k) / PANEL * PANEL + other;
                    const int below = pair != PAIR_OWN; /* written out: as a loop it becomes masked vectors, at three times the time */
                    if (below || k == 0) column[0] += K[k][0];
                    if (below || k <= 1) column[1] += K[k][1];
                    column[2] += K[k][2];
                }
            }
}

/* What bends the force of a contact as the node that bears it slides: force times the body's curvature, by differences. */
static void add_bends(const Film *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    double *bend = t->pressed_on; /* slopes' derivatives: by x (2, count), then by y */
    const long count = f->count, from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int axis = 0; axis < 2; axis++) {
        double *moved = t->x + axis * count;
        for (long k = from; k < to; k++) moved[k] = x[axis * count + k] + SLIDE;
        see_bodies(f, bodies, t->x, &t->seen);
        for (int c = 0; c < 2; c++)
            for (long k = c * count + from; k < c * count + to; k++) bend[2 * axis * count + k] = (t->seen.slope[k] - t->slope[k]) / SLIDE;
        for (long k = from; k < to; k++)
            if (isinf(t->seen.obstacle[k])) bend[2 * axis * count + k] = bend[(2 * axis + 1) * count + k] = 0; /* it slid off */
        memcpy(moved + from, x + axis * count + from, most(to - from, 0) * sizeof *x);
    }
    for (long k = from; k < to; k++) {
        if (!t->seen.touching[k]) continue;
        const double across = (bend[count + k] + bend[2 * count + k]) / 2, by[2][2] = {{bend[k], across}, {across, bend[3 * count + k]}};
        const long m = film_inner(f, k);
        for (int p = 0; p < 2; p++)
            for (int q = 0; q <= p; q++) add_entry(f, t->band, m, p, m, q, -force[k] * by[p][q]);
        add_entry(f, t->band, m, 2, m, 2, 1);
    }
    memset(bend, 0, 4 * count * sizeof *bend);
}

static void add_springs(const Film *f, const Tangent *t) {
    for (int side = 0; side < 4; side++)
        for (long k = 0; k < f->count; k++) {
            const double spring = t->spring[side * f->count + k];
            if (spring == 0) continue;
            const long m = film_inner(f, k), other = film_inner(f, k + film_next(f, side));
            for (int p = 0; p < 2; p++) {
                const double slope = t->slope[p * f->count + k];
                for (int q = 0; q <= p; q++) add_entry(f, t->band, m, p, m, q, spring * slope * t->slope[q * f->count + k]);
                add_entry(f, t->band, m, p, other, 2, -spring * slope), add_entry(f, t->band, other, 2, m, p, -spring * slope);
            }
            add_entry(f, t->band, other, 2, other, 2, spring);
        }
}

static int make_tangent(const Film *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const long height = panels_height(FILM_WIDTH(f));
    memset(t->band, 0, band_of(f) * sizeof *t->band);
    for (long k = 3 * f->inner; k < panels_of(f) * PANEL; k++) t->band[k * height + k % PANEL] = 1; /* behind the last */
    film_stencil(f, x, t->pressure, &t->stiffness);
    add_pairs(f, t), add_springs(f, t), add_bends(f, bodies, x, force, t);
    for (long k = 0; k < 3 * f->inner && f->inside; k++) /* what an outline holds has a row of its own */
        if (t->band[k * height + k % PANEL] == 0) t->band[k * height + k % PANEL] = 1;
    return panels_factor(panels_of(f), 0, height, t->band);
}

/* What edges' springs bear of `what`, as film_stencil_times of the sheet; of the heights alone. */
static void times_springs(const Film *f, const Tangent *t, const Eight *what, Eight *to) {
    for (int side = 0; side < 4; side++)
        for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++) {
            const float spring = (float)t->spring[side * f->count + k];
            if (spring == 0) continue;
            const long one = 2 * f->count + k, other = one + film_next(f, side);
            const Eight pull = spring * (what[other] - what[one]);
            to[one] -= pull, to[other] += pull;
        }
}

/* -- bodies ------------------------------------------------------------------------------------------------------------ */

/* What bodies do to nodes (4, count), on the lines where they are seen: forces, and how far what touches is off its body. Returns
   the force on nodes that are on none. */
static double press(const Film *f, const Bodies *bodies, const double *x, const double *force, Tangent *t, double *out) {
    Seen *w = &t->seen;
    const long count = f->count;
    double missed = 0;
    see_bodies(f, bodies, x, w);
    for (long k = w->box[0] * f->line; k < w->box[1] * f->line; k++) {
        if (!w->touching[k]) continue;
        find_edges(f, bodies, x, k, FINE_HALVES, w);
        if (isfinite(w->obstacle[k])) continue; /* else it is on the very edge */
        missed += force[k];
        w->obstacle[k] = t->obstacle[k], w->slope[k] = t->slope[k], w->slope[count + k] = t->slope[count + k];
    }
    lower_round_bodies(f, w);
    find_springs(f, x + 2 * count, w);
    const long from = first_line(f, w) * f->line, to = behind_lines(f, w) * f->line;
    for (int c = 0; c < 4 && from < to; c++) memset(out + c * count + from, 0, (to - from) * sizeof *out);
    for (long k = from; k < to; k++) {
        if (!w->touching[k]) continue;
        out[k] -= force[k] * w->slope[k], out[count + k] -= force[k] * w->slope[count + k], out[2 * count + k] += force[k];
        out[3 * count + k] = x[2 * count + k] - w->obstacle[k] + w->lower[k];
        for (int side = 0; side < 4; side++) {
            if (w->spring[side * count + k] == 0) continue;
            const double pull = w->spring[side * count + k] * rises_over_edge(f, w, x + 2 * count, k, side);
            out[2 * count + k] -= pull, out[2 * count + k + film_next(f, side)] += pull;
        }
    }
    return missed;
}

/* Whether bodies are where the film says: not off what bears its force, nor behind it. */
static int is_elsewhere(const Film *f, const double *x, const double *force, double missed, const Tangent *t) {
    const double *z = x + 2 * f->count;
    double total = 0, off = ELSEWHERE * missed, deepest = 0;
    for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++) {
        total += force[k], off += force[k] * fabs(t->base[3 * f->count + k]) / 2;
        deepest = most(deepest, z[k] - t->seen.obstacle[k]);
    }
    return off > ELSEWHERE / 2 * total || deepest > (total > 0 ? BEHIND_MOST : 1) * ELSEWHERE;
}

/* Where lane `lane` of what was found so far takes the film, near bodies, by `step` of its change. */
static void move(const Film *f, const double *x, const double *force, double step, int lane, Tangent *t) {
    const long count = f->count, from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int c = 0; c < 3; c++)
        for (long k = c * count + from; k < c * count + to; k++) t->x[k] = x[k] + step * (double)t->found[k][lane];
    for (long k = from; k < to; k++) t->force[k] = force[k] + step * (double)t->found[3 * count + k][lane];
}

typedef struct { Bodies bodies; double step; } Change;

static void find_residuals(const Film *f, const Change *change, int lane, const double *x, const double *force, Tangent *t) {
    move(f, x, force, change->step, lane, t), press(f, &change->bodies, t->x, t->force, t, t->pressed_on);
    const long from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int c = 0; c < 4; c++)
        for (long k = c * f->count + from; k < c * f->count + to; k++)
            t->residual[k][lane] = (float)((t->pressed_on[k] - t->base[k]) / change->step);
}

/* -- all of it --------------------------------------------------------------------------------------------------------- */

/* What is found next, of residuals `rhs` that what is free has: all displacements but the heights that go with slopes, in `given`. */
static void solve(const Film *f, Tangent *t) {
    const long count = f->count;
    const double *v = t->fields.gradient;
    Lanes swells = {0};
    memset(t->rhs + 3 * f->inner, 0, (rows_of(f) - 3 * f->inner) * sizeof *t->rhs);
    panels_solve_eight(panels_of(f), panels_height(FILM_WIDTH(f)), t->band, t->rhs);
    for (long k = 0; k < count; k++) {
        const long m = film_inner(f, k);
        if (m < 0) continue;
        Eight here[3], bulges = {0};
        for (int c = 0; c < 3; c++) here[c] = t->rhs[3 * m + c];
        if (t->seen.touching[k]) here[2] = (float)t->slope[k] * here[0] + (float)t->slope[count + k] * here[1];
        for (int c = 0; c < 3; c++) bulges += (float)v[c * count + k] * here[c], t->given[c * count + k] = here[c];
        swells += __builtin_convertvector(bulges, Lanes);
    }
    const Lanes by_gas = t->gas_stiffness * swells / (1 + t->gas_stiffness * swells[AT_ONCE]);
    t->swells += swells - by_gas * swells[AT_ONCE];
    const Eight gas_moves = __builtin_convertvector(by_gas, Eight);
    for (long k = 0; k < 3 * count; k++) {
        t->given[k] -= gas_moves * t->given[k][AT_ONCE];
        t->found[k] += t->given[k];
    }
}

/* One sweep: what the present residuals ask for. */
static void sweep(const Film *f, Tangent *t, int last) {
    const long count = f->count, first = first_line(f, &t->seen), behind = behind_lines(f, &t->seen);
    const uint8_t *touching = t->seen.touching;
    const double *v = t->fields.gradient;
    memset(t->given, 0, 3 * count * sizeof *t->given);
    for (long k = first * f->line; k < behind * f->line; k++) {
        if (!touching[k]) continue;
        const Eight off = -t->residual[3 * count + k];
        t->given[2 * count + k] = off, t->found[2 * count + k] += off;
        t->swells += v[2 * count + k] * __builtin_convertvector(off, Lanes);
    }
    film_stencil_times(f, &t->stiffness, first, behind, t->given, t->borne), times_springs(f, t, t->given, t->residual);
    const Eight gas = __builtin_convertvector(t->gas_stiffness * t->swells, Eight);
    for (long k = 0; k < count; k++) {
        const long m = film_inner(f, k);
        if (m < 0) continue;
        Eight row[3];
        for (int c = 0; c < 3; c++) {
            const long at = c * count + k;
            row[c] = -(t->residual[at] + t->borne[at] + gas * (float)v[at]);
            row[c][AT_ONCE] = (float)v[at];
        }
        if (touching[k]) row[0] += (float)t->slope[k] * row[2], row[1] += (float)t->slope[count + k] * row[2], row[2] -= row[2];
        for (int c = 0; c < 3; c++) t->rhs[3 * m + c] = row[c];
    }
    memset(t->given, 0, 3 * count * sizeof *t->given);
    solve(f, t);
    const long from = last ? (long)most(first - 1, 0) : 0, to = last ? (long)least(behind + 1, f->columns) : f->columns;
    film_stencil_times(f, &t->stiffness, from, to, t->given, t->borne), times_springs(f, t, t->given, t->residual);
    const Eight last_gas = __builtin_convertvector(t->gas_stiffness * t->swells, Eight);
    for (long k = first * f->line; k < behind * f->line; k++) {
        const long z = 2 * count + k;
        if (touching[k]) t->found[3 * count + k] -= t->residual[z] + t->borne[z] + last_gas * (float)v[z];
    }
}

/* The plane's share of a node, m^2, where the film is. */
static double cell_of(const Film *f, const double *x, long k) {
    double cell = 0;
    for (int corner = 0; corner < 4; corner++) {
        const int side_x = corner / 2 ? -1 : 1, side_y = corner % 2 ? -1 : 1;
        double g[2][2] = {{1, 0}, {0, 1}};
        for (int c = 0; c < 2; c++) {
            const double *here = x + c * f->count + k;
            g[0][c] += side_x * (here[side_x * f->line] - here[0]) / f->dx, g[1][c] += side_y * (here[side_y] - here[0]) / f->dy;
        }
        cell += f->dx * f->dy / 4 * (g[0][0] * g[1][1] - g[0][1] * g[1][0]);
    }
    return cell;
}

/* What is added up (FOUND) where bodies were last seen and pressed on, on a film at `x`. */
static void find_sums(const Film *f, const double *x, const double *force, Tangent *t, double *found) {
    for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++)
        if (t->seen.touching[k]) t->seen.cell[k] = cell_of(f, x, k);
    add_up(f, x, force, found, &t->seen);
}

/* How these change by lane `lane` of what was found, with the tension's change. */
static void sums_by(const Film *f, const Change *change, int lane, double tension, const double *x, const double *force, Tangent *t,
                    double *by) {
    double found[FOUND] = {0};
    const double bulge = t->swells[lane], pressure = -t->gas_stiffness * bulge;
    move(f, x, force, change->step, lane, t);
    press(f, &change->bodies, t->x, t->force, t, t->pressed_on);
    found[TENSION] = t->tension + change->step * tension, found[PRESSURE] = t->pressure + change->step * pressure;
    find_sums(f, t->x, t->force, t, found);
    for (int k = 0; k < FOUND; k++) by[k] = (found[k] - t->sums[k]) / change->step;
    by[VOLUME] = bulge, by[TENSION] = tension, by[PRESSURE] = pressure;
}

/* Lanes of what was found, as Python has them: displacements (many, 3, nodes) and forces (many, nodes). */
static void hand_over(const Film *f, const Eight *found, long many, double *by_x, double *by_force) {
    const long nodes = f->columns * f->rows;
    for (int c = 0; c < 4; c++)
        for (long i = 0; i < f->columns; i++)
            for (long j = 0; j < f->rows; j++) {
                const Eight here = found[c * f->count + i * f->line + j];
                double *to = (c < 3 ? by_x + c * nodes : by_force) + i * f->rows + j;
                for (long a = 0; a < many; a++) to[a * (c < 3 ? 3 : 1) * nodes] = (double)here[a];
            }
}

/* Where the film is: what touches and how, pressure, tension, and how these hang on displacements. Returns the number of sweeps; 0:
   it does not rest on these bodies. */
static int begin(const Film *f, const Settings *set, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const long count = f->count;
    see_touch(f, force, &t->seen), look_narrowly(f, bodies, &t->seen);
    memcpy(t->x, x, (3 * count + LANES) * sizeof *x), memcpy(t->force, force, count * sizeof *force);
    const SheetSums sums = film_sheet(f, x, FILM_ALL, 0, f->columns - 1, &t->fields);
    t->tension = sums.tension;
    gas_of(f, set, sums.volume, &t->pressure, &t->gas_stiffness);
    memcpy(t->obstacle, x + 2 * count, count * sizeof *t->obstacle); /* of what touches beside its body's very edge */
    if (is_elsewhere(f, x, force, press(f, bodies, x, force, t, t->base), t)) return 0;
    t->sums[PRESSURE] = t->pressure, t->sums[TENSION] = t->tension;
    find_sums(f, x, force, t, t->sums);
    memcpy(t->slope, t->seen.slope, 2 * count * sizeof *t->slope), memcpy(t->spring, t->seen.spring, 4 * count * sizeof *t->spring);
    memcpy(t->obstacle, t->seen.obstacle, count * sizeof *t->obstacle);
    for (long k = 0; k < 4 * count; k++)
        if (t->spring[k] != 0) return SWEEPS_AT_EDGES;
    return SWEEPS;
}

int64_t film_derive(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t roomy, double *room,
                    const double *settings, int64_t bodies, int64_t changes, const double *body, int64_t pooled,
                    const double *pool, const double *steps, const double *at, const double *pressed, double *by_x,
                    double *by_force, double *by_found) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < room_of(&f)) return REFUSED;
    (void)pooled;
    Tangent t = tangent_in(&f, room);
    const Bodies base = {bodies, body, pool};
    const long count = f.count, nodes = columns * rows;
    film_pad(&f, 3, at, t.at), film_pad(&f, 1, pressed, t.pressed);
    const double *x = t.at, *force = t.pressed;
    const int sweeps = begin(&f, (const Settings *)settings, &base, x, force, &t);
    if (!sweeps) return 1;
    if (make_tangent(&f, &base, x, force, &t)) return NOT_DEFINITE;
    for (long first = 0; first < changes; first += AT_ONCE) {
        const long many = changes - first < AT_ONCE ? changes - first : AT_ONCE;
        Change change[AT_ONCE];
        for (long a = 0; a < many; a++)
            change[a] = (Change){{bodies, body + (1 + first + a) * bodies * FILM_BODY, pool}, steps[first + a]};
        memset(t.found, 0, 4 * count * sizeof *t.found), memset(t.borne, 0, 3 * count * sizeof *t.borne), t.swells -= t.swells;
        for (int k = 1; k <= sweeps; k++) {
            for (long a = 0; a < many; a++) find_residuals(&f, change + a, (int)a, x, force, &t);
            sweep(&f, &t, k == sweeps);
        }
        Lanes tension = {0};
        for (int c = 0; c < 3; c++)
            for (long k = 0; k < count; k++)
                tension += (double)t.stiffness.tension_by[c * t.stiffness.apart + k] * __builtin_convertvector(t.found[c * count + k], Lanes);
        for (long a = 0; a < many; a++) sums_by(&f, change + a, (int)a, tension[a], x, force, &t, by_found + (first + a) * FOUND);
        hand_over(&f, t.found, many, by_x + first * 3 * nodes, by_force + first * nodes);
    }
    return 0;
}
