#include "qs_inplane_solver.h"

#include <string.h>

#include "band_cholesky_f32.h"

/* the even and odd part of a pair is its sum and difference over sqrt(2) */
#define HALF 0.70710678f
/* parity of x displacements; y displacements have the opposite parity. An asymmetric outline has
   all unknowns in the even part */
enum { EVEN, ODD };

/* nodes of half a line, unknowns, panels and their height */
typedef struct { long half, order, panels, height; } Halves;

static Halves halves_of(const Membrane *f) {
    Halves h = {.half = f->lopsided ? f->inner_rows : (f->inner_rows + 1) / 2};
    h.order = (f->columns - 2) * 2 * h.half;
    h.panels = (h.order + PANEL - 1) / PANEL, h.height = panels_height(2 * h.half + 3);
    return h;
}

long qs_inplane_size(const Membrane *f) {
    const Halves h = halves_of(f);
    return 2 * h.panels * PANEL * h.height;
}

static long stride_of(const Halves *h) { return h->panels * PANEL + h->height; }

long qs_inplane_workspace_size(const Membrane *f) {
    const Halves h = halves_of(f);
    return 2 * stride_of(&h);
}

/* Return the index of a node's displacement along `axis` among the unknowns of the even or odd
   part. `fraction` is its factor. */
static long unknown_of(const Membrane *f, const Halves *h, long node, int axis, int kind, double *fraction) {
    const long i = node / f->line, j = node % f->line, mirrored = f->lopsided ? f->rows : f->rows - 1 - j;
    const int odd = axis == 0 ? kind == ODD : kind == EVEN;
    *fraction = f->lopsided ? kind == EVEN : j == mirrored ? !odd : j > mirrored && odd ? -(double)HALF : (double)HALF;
    return ((i - 1) * h->half + (j < mirrored ? j : mirrored) - 1) * 2 + axis;
}

/* Add the even or odd part of the in-plane stiffness of a pair of nodes. */
static void add_pair(const Membrane *f, const Halves *h, const Stencil *s, int pair, long node, int kind, float *factor) {
    const long ends[2] = {node, node + qs_pair_offset(f, pair)};
    for (int end = 0; end < (pair == PAIR_OWN ? 1 : 2); end++)
        for (int k = 0; k < 2; k++)
            for (int l = 0; l < 2; l++) {
                double fraction[2];
                const long row = unknown_of(f, h, ends[end], end ? l : k, kind, fraction);
                const long column = unknown_of(f, h, ends[pair == PAIR_OWN ? 0 : !end], end ? k : l, kind, fraction + 1);
                const double value = fraction[0] * fraction[1] * (double)qs_block(s, pair, k, l, node);
                if (row >= column) factor[column * h->height + row - column / PANEL * PANEL] += (float)value;
            }
}

int qs_inplane_factor(const Membrane *f, const Stencil *s, float *factor) {
    const Halves h = halves_of(f);
    const long size = h.panels * PANEL * h.height;
    memset(factor, 0, 2 * size * sizeof *factor);
    for (long node = 0; node < f->count; node++)
        for (int pair = 0; pair < PAIRS && qs_inner(f, node) >= 0; pair++) {
            if (qs_inner(f, node + qs_pair_offset(f, pair)) < 0) continue;
            add_pair(f, &h, s, pair, node, EVEN, factor), add_pair(f, &h, s, pair, node, ODD, factor + size);
        }
    for (int kind = EVEN; kind <= ODD; kind++)
        /* odd unknowns vanish on the center line, and there is nothing behind the last one */
        for (long k = 0; k < h.panels * PANEL; k++) {
            float *diagonal = factor + kind * size + k * h.height + k % PANEL;
            if (*diagonal == 0) *diagonal = 1;
        }
    return panels_factor(h.panels, 0, h.height, factor) || panels_factor(h.panels, 0, h.height, factor + size);
}

static void solve_full(const Membrane *f, const Halves *h, const float *factor, float *residual, float *x) {
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++)
            for (int axis = 0; axis < 2; axis++) x[2 * ((i - 1) * h->half + j - 1) + axis] = residual[axis * f->count + i * f->line + j];
    panels_forward(h->panels, h->height, factor, 1, stride_of(h), x), panels_backward(h->panels, h->height, factor, 1, stride_of(h), x);
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++)
            for (int axis = 0; axis < 2; axis++) residual[axis * f->count + i * f->line + j] = x[2 * ((i - 1) * h->half + j - 1) + axis];
}

void qs_inplane_solve(const Membrane *f, const float *factor, float *residual, float *room) {
    const Halves h = halves_of(f);
    const long size = h.panels * PANEL * h.height, stride = stride_of(&h), count = f->count;
    const int middle = f->inner_rows % 2;
    float *even = room, *odd = room + stride;
    memset(room, 0, 2 * stride * sizeof *room);
    if (f->lopsided) {
        solve_full(f, &h, factor, residual, room);
        return;
    }
    for (long i = 1; i < f->columns - 1; i++) {
        float *low = residual + i * f->line, *high = low + f->rows - 1;
        float *at_even = even + 2 * h.half * (i - 1), *at_odd = odd + 2 * h.half * (i - 1);
        for (long j = 1; j <= h.half - middle; j++, at_even += 2, at_odd += 2) {
            at_even[0] = HALF * (low[j] + high[-j]), at_even[1] = HALF * (low[count + j] - high[count - j]);
            at_odd[0] = HALF * (low[j] - high[-j]), at_odd[1] = HALF * (low[count + j] + high[count - j]);
        }
        if (middle) at_even[0] = low[h.half], at_odd[1] = low[count + h.half];
    }
    for (int kind = EVEN; kind <= ODD; kind++) {
        panels_forward(h.panels, h.height, factor + kind * size, 1, stride, room + kind * stride);
        panels_backward(h.panels, h.height, factor + kind * size, 1, stride, room + kind * stride);
    }
    for (long i = 1; i < f->columns - 1; i++) {
        float *low = residual + i * f->line, *high = low + f->rows - 1;
        const float *at_even = even + 2 * h.half * (i - 1), *at_odd = odd + 2 * h.half * (i - 1);
        for (long j = 1; j <= h.half - middle; j++, at_even += 2, at_odd += 2) {
            low[j] = HALF * (at_even[0] + at_odd[0]), high[-j] = HALF * (at_even[0] - at_odd[0]);
            low[count + j] = HALF * (at_even[1] + at_odd[1]), high[count - j] = HALF * (at_odd[1] - at_even[1]);
        }
        if (middle) low[h.half] = at_even[0], low[count + h.half] = at_odd[1];
    }
}
