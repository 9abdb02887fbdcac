#include "qs_tangent.h"

#include <math.h>
#include <string.h>

#define SLIDE 1e-6 /* shift of the nodes for derivatives of the slopes, m */

long qs_tangent_size(const Membrane *f) {
    const long singles = qs_stencil_size(f) + band_of(f) + PANEL * (rows_of(f) + 14 * f->count);
    return qs_contact_size(f) + singles / 2 + (3 + 3 + 4 + 7 + 4 + 8) * f->count + 32;
}

Tangent qs_tangent_in(const Membrane *f, double *room) {
    const long n = f->count;
    Tangent t = {.seen = qs_contact_in(f, &room)};
    t.fields.elastic = qs_take(&room, 3 * n), t.fields.gradient = qs_take(&room, 3 * n);
    t.fields.along_x = t.seen.along_x, t.fields.along_y = t.seen.along_y;
    float *floats = (float *)qs_take(&room, qs_stencil_size(f) / 2);
    t.stiffness = qs_stencil_in(f, &floats);
    t.at = qs_take(&room, 3 * n + 8), t.pressed = qs_take(&room, n);
    t.band = (float *)qs_take(&room, band_of(f) / 2), t.rhs = (Eight *)qs_take(&room, PANEL / 2 * rows_of(f));
    t.slope = qs_take(&room, 2 * n), t.spring = qs_take(&room, 4 * n), t.obstacle = qs_take(&room, n);
    t.x = qs_take(&room, 3 * n + 8), t.force = qs_take(&room, n), t.base = qs_take(&room, 4 * n), t.pressed_on = qs_take(&room, 4 * n);
    t.residual = (Eight *)qs_take(&room, PANEL / 2 * 4 * n), t.borne = (Eight *)qs_take(&room, PANEL / 2 * 3 * n);
    t.given = (Eight *)qs_take(&room, PANEL / 2 * 3 * n), t.found = (Eight *)qs_take(&room, PANEL / 2 * 4 * n);
    memset(t.base, 0, 8 * n * sizeof *t.base), memset(t.residual, 0, 4 * n * sizeof *t.residual);
    /* rows of nodes fixed by an outline stay zero: 0 times NaN is NaN */
    memset(t.rhs, 0, rows_of(f) * sizeof *t.rhs);
    memset(t.at, 0, (3 * n + 8) * sizeof *t.at), memset(t.slope, 0, 2 * n * sizeof *t.slope);
    return t;
}

static void add_entry(const Membrane *f, float *band, long m, int k, long n, int l, double value) {
    const long row = 3 * m + k, column = 3 * n + l;
    if (m >= 0 && n >= 0 && row >= column) band[column * panels_height(QS_WIDTH(f)) + row - column / PANEL * PANEL] += (float)value;
}

/* Eliminate the heights in contact, which follow the slopes: their rows and columns are added to
   the in-plane ones. */
static void eliminate(const Membrane *f, const Tangent *t, int pair, long node, float K[3][3]) {
    const long other = node + qs_pair_offset(f, pair);
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++) K[k][l] = qs_block(&t->stiffness, pair, k, l, node);
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

static void add_pairs(const Membrane *f, const Tangent *t) {
    const long height = panels_height(QS_WIDTH(f));
    for (long i = 1; i < f->columns - 1; i++)
        for (long node = i * f->line + 1; node < i * f->line + f->rows - 1; node++)
            for (int pair = 0; pair < PAIRS; pair++) {
                const long first = 3 * qs_inner(f, node), other = 3 * qs_inner(f, node + qs_pair_offset(f, pair));
                float K[3][3];
                if (first < 0 || other < 0) continue;
                eliminate(f, t, pair, node, K);
                for (int k = 0; k < 3; k++) {
                    float *column = t->band + (first + k) * height - (first + k) / PANEL * PANEL + other;
                    /* unrolled: as a loop it becomes masked vectors, at three times the time */
                    const int below = pair != PAIR_OWN;
                    if (below || k == 0) column[0] += K[k][0];
                    if (below || k <= 1) column[1] += K[k][1];
                    column[2] += K[k][2];
                }
            }
}

/* Add the change of a contact force as its node slides: force times the obstacle's curvature, by
   differences. */
static void add_bends(const Membrane *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    double *bend = t->pressed_on; /* derivatives of the slopes: by x (2, count), then by y */
    const long count = f->count, from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int axis = 0; axis < 2; axis++) {
        double *moved = t->x + axis * count;
        for (long k = from; k < to; k++) moved[k] = x[axis * count + k] + SLIDE;
        evaluate_obstacles(f, bodies, t->x, &t->seen);
        for (int c = 0; c < 2; c++)
            for (long k = c * count + from; k < c * count + to; k++) bend[2 * axis * count + k] = (t->seen.slope[k] - t->slope[k]) / SLIDE;
        for (long k = from; k < to; k++)
            /* the node slid off the obstacle */
            if (isinf(t->seen.obstacle[k])) bend[2 * axis * count + k] = bend[(2 * axis + 1) * count + k] = 0;
        memcpy(moved + from, x + axis * count + from, max_of(to - from, 0) * sizeof *x);
    }
    for (long k = from; k < to; k++) {
        if (!t->seen.touching[k]) continue;
        const double across = (bend[count + k] + bend[2 * count + k]) / 2, by[2][2] = {{bend[k], across}, {across, bend[3 * count + k]}};
        const long m = qs_inner(f, k);
        for (int p = 0; p < 2; p++)
            for (int q = 0; q <= p; q++) add_entry(f, t->band, m, p, m, q, -force[k] * by[p][q]);
        add_entry(f, t->band, m, 2, m, 2, 1);
    }
    memset(bend, 0, 4 * count * sizeof *bend);
}

static void add_springs(const Membrane *f, const Tangent *t) {
    for (int side = 0; side < 4; side++)
        for (long k = 0; k < f->count; k++) {
            const double spring = t->spring[side * f->count + k];
            if (spring == 0) continue;
            const long m = qs_inner(f, k), other = qs_inner(f, k + qs_next(f, side));
            for (int p = 0; p < 2; p++) {
                const double slope = t->slope[p * f->count + k];
                for (int q = 0; q <= p; q++) add_entry(f, t->band, m, p, m, q, spring * slope * t->slope[q * f->count + k]);
                add_entry(f, t->band, m, p, other, 2, -spring * slope), add_entry(f, t->band, other, 2, m, p, -spring * slope);
            }
            add_entry(f, t->band, other, 2, other, 2, spring);
        }
}

int qs_tangent_make(const Membrane *f, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const long height = panels_height(QS_WIDTH(f));
    memset(t->band, 0, band_of(f) * sizeof *t->band);
    /* rows behind the last one */
    for (long k = 3 * f->inner; k < panels_of(f) * PANEL; k++) t->band[k * height + k % PANEL] = 1;
    qs_stencil(f, x, t->pressure, &t->stiffness);
    add_pairs(f, t), add_springs(f, t), add_bends(f, bodies, x, force, t);
    /* a node fixed by an outline has a row of its own */
    for (long k = 0; k < 3 * f->inner && f->inside; k++)
        if (t->band[k * height + k % PANEL] == 0) t->band[k * height + k % PANEL] = 1;
    return panels_factor(panels_of(f), 0, height, t->band);
}

void qs_tangent_springs(const Membrane *f, const Tangent *t, const Eight *what, Eight *to) {
    for (int side = 0; side < 4; side++)
        for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++) {
            const float spring = (float)t->spring[side * f->count + k];
            if (spring == 0) continue;
            const long one = 2 * f->count + k, other = one + qs_next(f, side);
            const Eight pull = spring * (what[other] - what[one]);
            to[one] -= pull, to[other] += pull;
        }
}
