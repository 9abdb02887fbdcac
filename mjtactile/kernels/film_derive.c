/* How a film at rest answers small changes of its bodies, by the implicit function theorem: what touches goes on to touch, and
   the residuals stay zero. The tangent is that of the sheet and the gas, with the heights of what touches eliminated by the
   bodies' slopes. How residuals hang on the bodies is found by differences, which want no solution; so is what the tangent
   leaves out (how corrections and edges move with the nodes), by a second sweep. */
#include <math.h>
#include <string.h>

#include "band.h"
#include "film_work.h"
#include "kernels.h"
#include "panels.h"
#include "small.h"

#define AT_ONCE (LANES - 1)  /* changes that are solved together; the last lane is the gas's */
#define SWEEPS 2
#define SWEEPS_AT_EDGES 3
#define FINE_HALVES 36       /* edges are wanted to less than a difference of 1e-6 m shows */
#define WIDTH(film) (3 * ((film)->inner_rows + 1) + 2)

typedef struct {
    Seen seen;
    SheetFields fields;                 /* (3, count) twice; links are in `seen` */
    float *band;                        /* of panels, 3 inner */
    double *v;                          /* (3, count) of the volume, by the displacements */
    double *slope, *spring, *obstacle;  /* where the film is: (2, count), (4, count), (count) */
    double *at, *pressed;               /* the film: (3, count), (count) */
    double *x, *force, *low, *high;     /* moved: (3, count), (count); residuals: (4, count) */
    Eight *rhs;                         /* 3 inner, with room behind */
    Lanes *residual, *given, *product;  /* (4, count), (3, count) twice */
    Lanes *solved;                      /* 3 inner */
    Lanes *found;                       /* (4, count): displacements and forces */
    double gas_stiffness, pressure;
} Tangent;

static long panels_of(const Film *f) { return (3 * f->inner + PANEL - 1) / PANEL; }

static long band_of(const Film *f) { return panels_of(f) * PANEL * panels_height(WIDTH(f)); }

static long rows_of(const Film *f) { return panels_of(f) * PANEL + panels_height(WIDTH(f)); }

static long room_of(const Film *f) {
    const long lanes = 3 * f->inner + 14 * f->count, singles = band_of(f) / 2 + PANEL / 2 * rows_of(f);
    return film_seen_size(f) + singles + (3 + 2 + 4 + 1 + 3 + 1 + 8 + 6 + 4) * f->count + 16 + LANES * lanes;
}

int64_t film_derive_room(const double *numbers) {
    const Film f = film_of(numbers, 0);
    return room_of(&f);
}

static Tangent tangent_in(const Film *f, double *room) {
    const long n = f->count;
    Tangent t;
    t.seen = film_seen_in(f, &room);
    t.fields.elastic = film_take(&room, 3 * n), t.fields.gradient = film_take(&room, 3 * n);
    t.fields.along_x = t.seen.along_x, t.fields.along_y = t.seen.along_y;
    t.at = film_take(&room, 3 * n + 8), t.pressed = film_take(&room, n);
    t.band = (float *)film_take(&room, band_of(f) / 2), t.rhs = (Eight *)film_take(&room, PANEL / 2 * rows_of(f));
    t.v = film_take(&room, 3 * n), t.slope = film_take(&room, 2 * n), t.spring = film_take(&room, 4 * n), t.obstacle = film_take(&room, n);
    t.x = film_take(&room, 3 * n + 8), t.force = film_take(&room, n), t.low = film_take(&room, 4 * n), t.high = film_take(&room, 4 * n);
    t.residual = (Lanes *)film_take(&room, LANES * 4 * n), t.given = (Lanes *)film_take(&room, LANES * 3 * n);
    t.product = (Lanes *)film_take(&room, LANES * 3 * n), t.found = (Lanes *)film_take(&room, LANES * 4 * n), t.solved = (Lanes *)film_take(&room, LANES * 3 * f->inner);
    return t;
}

/* -- the tangent ------------------------------------------------------------------------------------------------------- */

/* Heights of the nodes that touch go with the slopes. */
static void eliminate(const Film *f, const Tangent *t, CornerStiffness *c) {
    for (int n = 0; n < 3; n++) {
        const long node = c->node[n], z = 3 * n + 2;
        if (!t->seen.touching[node]) continue;
        for (int k = 0; k < 2; k++)
            for (int q = 0; q < 9; q++) c->K[3 * n + k][q] += t->slope[k * f->count + node] * c->K[z][q];
        for (int k = 0; k < 2; k++)
            for (int p = 0; p < 9; p++) c->K[p][3 * n + k] += t->slope[k * f->count + node] * c->K[p][z];
        for (int p = 0; p < 9; p++) c->K[z][p] = c->K[p][z] = 0;
    }
}

static void add_entry(const Film *f, float *band, long m, int k, long n, int l, double value) {
    const long row = 3 * m + k, column = 3 * n + l;
    if (m >= 0 && n >= 0 && row >= column) band[column * panels_height(WIDTH(f)) + row - column / PANEL * PANEL] += (float)value;
}

static void add_corner(const Film *f, float *band, const CornerStiffness *c) {
    const long inner[3] = {film_inner(f, c->node[0]), film_inner(f, c->node[1]), film_inner(f, c->node[2])};
    for (int n = 0; n < 3; n++)
        for (int m = 0; m < 3; m++) {
            if (inner[n] < inner[m] || inner[m] < 0) continue;
            for (int k = 0; k < 3; k++)
                for (int l = 0; l < 3; l++) add_entry(f, band, inner[n], k, inner[m], l, c->K[3 * n + k][3 * m + l]);
        }
}

/* What bends the force of a contact as the node that bears it slides: force times the body's curvature, by differences. */
static void add_bends(const Film *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const double step = 1e-6;
    double *bend = t->low; /* slopes' derivatives: by x (2, count), then by y */
    memset(bend, 0, 4 * f->count * sizeof *bend);
    for (int side = 0; side < 4; side++) {
        memcpy(t->x, x, 3 * f->count * sizeof *x);
        for (long k = 0; k < f->count; k++) t->x[side / 2 * f->count + k] += side % 2 ? step : -step;
        see_bodies(f, bodies, t->x, &t->seen);
        for (long k = 0; k < 2 * f->count; k++)
            bend[side / 2 * 2 * f->count + k] += (side % 2 ? 1 : -1) * t->seen.slope[k] / (2 * step);
    }
    for (long k = 0; k < f->count; k++) {
        if (!t->seen.touching[k]) continue;
        const double xy = (bend[f->count + k] + bend[2 * f->count + k]) / 2;
        const double by[2][2] = {{bend[k], xy}, {xy, bend[3 * f->count + k]}};
        const long m = film_inner(f, k);
        for (int p = 0; p < 2; p++)
            for (int q = 0; q <= p; q++) add_entry(f, t->band, m, p, m, q, -force[k] * by[p][q]);
        add_entry(f, t->band, m, 2, m, 2, 1);
    }
}

static int make_tangent(const Film *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const long height = panels_height(WIDTH(f));
    memset(t->band, 0, band_of(f) * sizeof *t->band);
    for (long k = 3 * f->inner; k < panels_of(f) * PANEL; k++) t->band[k * height + k % PANEL] = 1; /* behind the last */
    CornerStiffness c;
    for (long corner = 0; corner < FILM_CORNERS(f); corner++) {
        film_corner(f, x, t->pressure, corner, &c);
        eliminate(f, t, &c);
        add_corner(f, t->band, &c);
    }
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
    add_bends(f, bodies, x, force, t);
    return panels_factor(panels_of(f), 0, height, t->band);
}

/* Into `product` the stiffness times `what` (3, count), without the gas's, of corners at nodes that touch. */
static void times_stiffness(const Film *f, const double *x, const Tangent *t, const Lanes *what) {
    const long count = f->count;
    memset(t->product, 0, 3 * count * sizeof *t->product);
    CornerStiffness c;
    for (long corner = 0; corner < FILM_CORNERS(f); corner++) {
        film_corner_nodes(f, corner, c.node);
        if (!t->seen.touching[c.node[0]] && !t->seen.touching[c.node[1]] && !t->seen.touching[c.node[2]]) continue;
        film_corner(f, x, t->pressure, corner, &c);
        for (int p = 0; p < 9; p++)
            for (int q = 0; q < 9; q++) t->product[p % 3 * count + c.node[p / 3]] += c.K[p][q] * what[q % 3 * count + c.node[q / 3]];
    }
    for (int side = 0; side < 4; side++)
        for (long k = 0; k < count; k++) {
            const double spring = t->spring[side * count + k];
            if (spring == 0) continue;
            const long one = 2 * count + k, other = one + film_next(f, side);
            const Lanes pull = spring * (what[other] - what[one]);
            t->product[one] -= pull, t->product[other] += pull;
        }
}

/* -- residuals --------------------------------------------------------------------------------------------------------- */

/* All of a film's residuals (4, count): forces on the nodes, and how far what touches is off its body. */
static void residuals(const Film *f, const Settings *set, const Bodies *bodies, const double *x, const double *force,
                      int moved, Tangent *t, double *out) {
    Seen *w = &t->seen;
    const long count = f->count;
    see_bodies(f, bodies, x, w);
    for (long k = 0; k < count; k++) {
        if (!w->touching[k]) continue;
        find_edges(f, bodies, x, k, FINE_HALVES, w);
        if (isfinite(w->obstacle[k])) continue; /* else it is on the very edge */
        w->obstacle[k] = t->obstacle[k], w->slope[k] = t->slope[k], w->slope[count + k] = t->slope[count + k];
    }
    lower_round_bodies(f, w);
    double pressure = t->pressure, unused;
    if (moved) gas_of(f, set, film_sheet(f, x, FILM_ALL, 0, f->columns - 1, &t->fields).volume, &pressure, &unused);
    for (long k = 0; k < 3 * count; k++) out[k] = t->fields.elastic[k] - pressure * t->fields.gradient[k];
    find_springs(f, x + 2 * count, w);
    for (long k = 0; k < count; k++) {
        out[3 * count + k] = 0;
        if (!w->touching[k]) continue;
        out[k] -= force[k] * w->slope[k], out[count + k] -= force[k] * w->slope[count + k], out[2 * count + k] += force[k];
        out[3 * count + k] = x[2 * count + k] - w->obstacle[k] + w->lower[k];
        for (int side = 0; side < 4; side++) {
            if (w->spring[side * count + k] == 0) continue;
            const double pull = w->spring[side * count + k] * rises_over_edge(f, w, x + 2 * count, k, side);
            out[2 * count + k] -= pull, out[2 * count + k + film_next(f, side)] += pull;
        }
    }
}

/* Where lane `lane` of what was found so far takes the film by `step` of its change. */
static void move(const Film *f, const double *x, const double *force, double step, int lane, Tangent *t) {
    for (long k = 0; k < 3 * f->count; k++) t->x[k] = x[k] + step * t->found[k][lane];
    for (long k = 0; k < f->count; k++) t->force[k] = force[k] + step * t->found[3 * f->count + k][lane];
}

/* -- all of it --------------------------------------------------------------------------------------------------------- */

static void solve(const Film *f, const double *x, Tangent *t) {
    const long count = f->count;
    const uint8_t *touching = t->seen.touching;
    Lanes bulge = {0}, by_gas = {0};
    memset(t->given, 0, 3 * count * sizeof *t->given);
    for (long k = 0; k < count; k++)
        if (touching[k]) t->given[2 * count + k] = -t->residual[3 * count + k], bulge += t->v[2 * count + k] * t->given[2 * count + k];
    times_stiffness(f, x, t, t->given);
    for (long k = 0; k < count; k++) {
        const long m = film_inner(f, k);
        if (m < 0) continue;
        Lanes row[3];
        for (int c = 0; c < 3; c++) {
            const long at = c * count + k;
            row[c] = -(t->residual[at] + t->product[at] + t->gas_stiffness * bulge * t->v[at]);
            row[c][AT_ONCE] = t->v[at];
        }
        if (touching[k]) row[0] += t->slope[k] * row[2], row[1] += t->slope[count + k] * row[2], row[2] -= row[2];
        for (int c = 0; c < 3; c++)
            for (int l = 0; l < LANES; l++) t->rhs[3 * m + c][l] = (float)row[c][l];
    }
    Lanes swells = {0}; /* volume by the gas's own lane comes last */
    memset(t->rhs + 3 * f->inner, 0, (rows_of(f) - 3 * f->inner) * sizeof *t->rhs);
    panels_solve_eight(panels_of(f), panels_height(WIDTH(f)), t->band, t->rhs);
    for (long k = 0; k < count; k++) {
        const long m = film_inner(f, k);
        if (m < 0) continue;
        Lanes *here = t->solved + 3 * m;
        for (int c = 0; c < 3; c++)
            for (int l = 0; l < LANES; l++) here[c][l] = (double)t->rhs[3 * m + c][l];
        if (touching[k]) here[2] = t->slope[k] * here[0] + t->slope[count + k] * here[1];
        for (int c = 0; c < 3; c++) swells += t->v[c * count + k] * here[c];
    }
    by_gas = t->gas_stiffness * swells / (1 + t->gas_stiffness * swells[AT_ONCE]);
    for (long k = 0; k < count; k++) {
        const long m = film_inner(f, k);
        if (m < 0) continue;
        for (int c = 0; c < 3; c++) t->given[c * count + k] += t->solved[3 * m + c] - by_gas * t->solved[3 * m + c][AT_ONCE];
    }
    bulge -= bulge;
    for (long k = 0; k < 3 * count; k++) bulge += t->v[k] * t->given[k], t->found[k] += t->given[k];
    times_stiffness(f, x, t, t->given);
    for (long k = 0; k < count; k++) {
        const long z = 2 * count + k;
        if (touching[k]) t->found[3 * count + k] -= t->residual[z] + t->product[z] + t->gas_stiffness * bulge * t->v[z];
    }
}

typedef struct { const Bodies *low, *high; double step; } Change;

static void find_residuals(const Film *f, const Settings *set, const Change *change, int lane, int moved, const double *x,
                           const double *force, Tangent *t) {
    move(f, x, force, -change->step, lane, t), residuals(f, set, change->low, t->x, t->force, moved, t, t->low);
    move(f, x, force, change->step, lane, t), residuals(f, set, change->high, t->x, t->force, moved, t, t->high);
    for (long k = 0; k < 4 * f->count; k++) t->residual[k][lane] = (t->high[k] - t->low[k]) / (2 * change->step);
}

/* What is added up (FOUND), where a change takes the film. */
static void found_after(const Film *f, const Settings *set, const Bodies *bodies, double step, int lane, const double *x,
                        const double *force, Tangent *t, double *found) {
    move(f, x, force, step, lane, t);
    residuals(f, set, bodies, t->x, t->force, 0, t, t->low);
    const SheetSums sums = film_sheet(f, t->x, FILM_ALL, 0, f->columns - 1, &t->fields);
    double unused;
    memcpy(t->seen.cell, t->fields.gradient + 2 * f->count, f->count * sizeof *t->seen.cell);
    found[VOLUME] = sums.volume, found[TENSION] = sums.tension, found[STRETCHED_AREA] = sums.area;
    gas_of(f, set, sums.volume, found + PRESSURE, &unused);
    add_up(f, t->x, t->force, found, &t->seen);
}

int64_t film_derive(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t roomy, double *room,
                    const double *settings, int64_t bodies, int64_t changes, const double *body, int64_t pooled,
                    const double *pool, const double *steps, const double *at, const double *pressed, double *by_x,
                    double *by_force, double *by_found) {
    const Film f = film_of(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < room_of(&f)) return REFUSED;
    (void)pooled;
    Tangent t = tangent_in(&f, room);
    const Settings *set = (const Settings *)settings;
    const Bodies base = {bodies, body, pool};
    const long count = f.count, nodes = columns * rows;
    memset(t.at, 0, (3 * count + 8) * sizeof *t.at), memset(t.x, 0, (3 * count + 8) * sizeof *t.x);
    film_pad(&f, 3, at, t.at), film_pad(&f, 1, pressed, t.pressed);
    const double *x = t.at, *force = t.pressed;
    memset(t.obstacle, 0, count * sizeof *t.obstacle), memset(t.slope, 0, 2 * count * sizeof *t.slope);
    see_touch(&f, force, &t.seen);
    gas_of(&f, set, film_sheet(&f, x, FILM_ALL, 0, f.columns - 1, &t.fields).volume, &t.pressure, &t.gas_stiffness);
    residuals(&f, set, &base, x, force, 0, &t, t.low);
    memcpy(t.v, t.fields.gradient, 3 * count * sizeof *t.v), memcpy(t.slope, t.seen.slope, 2 * count * sizeof *t.slope);
    memcpy(t.spring, t.seen.spring, 4 * count * sizeof *t.spring), memcpy(t.obstacle, t.seen.obstacle, count * sizeof *t.obstacle);
    int at_edges = 0;
    for (long k = 0; k < 4 * count; k++) at_edges |= t.spring[k] != 0;
    if (make_tangent(&f, &base, x, force, &t)) return NOT_DEFINITE;
    for (long first = 0; first < changes; first += AT_ONCE) {
        const long many = changes - first < AT_ONCE ? changes - first : AT_ONCE;
        memset(t.found, 0, 4 * count * sizeof *t.found), memset(t.residual, 0, 4 * count * sizeof *t.residual);
        for (int sweep = 0; sweep < (at_edges ? SWEEPS_AT_EDGES : SWEEPS); sweep++) {
            if (!sweep) film_sheet(&f, x, FILM_ALL, 0, f.columns - 1, &t.fields);
            for (long a = 0; a < many; a++) {
                const Bodies low = {bodies, body + (1 + 2 * (first + a)) * bodies * FILM_BODY, pool};
                const Bodies high = {bodies, low.body + bodies * FILM_BODY, pool};
                find_residuals(&f, set, &(Change){&low, &high, steps[first + a]}, (int)a, sweep > 0, x, force, &t);
            }
            solve(&f, x, &t);
        }
        for (long a = 0; a < many; a++) {
            const Bodies low = {bodies, body + (1 + 2 * (first + a)) * bodies * FILM_BODY, pool};
            const Bodies high = {bodies, low.body + bodies * FILM_BODY, pool};
            double before[FOUND] = {0}, after[FOUND] = {0};
            found_after(&f, set, &low, -steps[first + a], (int)a, x, force, &t, before);
            found_after(&f, set, &high, steps[first + a], (int)a, x, force, &t, after);
            for (int k = 0; k < FOUND; k++) by_found[(first + a) * FOUND + k] = (after[k] - before[k]) / (2 * steps[first + a]);
            for (long k = 0; k < 4 * count; k++) t.low[k] = t.found[k][a];
            film_unpad(&f, 3, t.low, by_x + (first + a) * 3 * nodes), film_unpad(&f, 1, t.low + 3 * count, by_force + (first + a) * nodes);
        }
    }
    return 0;
}
