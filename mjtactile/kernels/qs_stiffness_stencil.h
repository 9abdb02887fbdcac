/* Stiffness of the membrane, minus that of a gas at a pressure, in single precision, by pairs of
   neighboring nodes. Blocks are (3, 3), with rows for a node's displacements and columns for those
   of the other node. That is the node itself, or the next one along y, along x, or along both. */
#ifndef MJTACTILE_QS_STIFFNESS_STENCIL_H
#define MJTACTILE_QS_STIFFNESS_STENCIL_H
#include "band_cholesky_f64.h"
#include "quasistatic.h"
#include "band_cholesky_f32.h"

enum { PAIR_OWN, PAIR_UP, PAIR_BESIDE, PAIR_RISING, PAIR_FALLING, PAIRS };
typedef struct {
    long stride;
    float *block[PAIRS]; /* (3, 3, apart) */
    float *tension_by;   /* (3, apart): derivatives of the mean tension by displacements */
} Stencil;

long qs_stencil_size(const Membrane *membrane); /* number of floats, a multiple of eight */
Stencil qs_stencil_in(const Membrane *membrane, float **room);
/* Compute the stiffness at displacements `x` (3, count), with room for a vector behind them. */
void qs_stencil(const Membrane *membrane, const double *x, double pressure, const Stencil *to);
/* Add the stiffness times `what` (3, count) of nodes on lines `first` to `last` - 1 to the forces
   of these nodes and their neighbors. */
void qs_stencil_times(const Membrane *membrane, const Stencil *stencil, long first, long last, const Eight *what, Eight *to);

/* Write the stiffness as a band (3 inner), with the three displacements of a node together. */
#define QS_WIDTH(membrane) (3 * ((membrane)->inner_rows + 1) + 2)
void qs_stencil_band(const Membrane *membrane, const Stencil *stencil, double *band);

static inline long qs_pair_offset(const Membrane *membrane, int pair) { /* offset of the other node */
    const long away[PAIRS] = {0, 1, membrane->line, membrane->line + 1, membrane->line - 1};
    return away[pair];
}

static inline float qs_block(const Stencil *s, int pair, int row, int column, long node) {
    return s->block[pair][(3 * row + column) * s->stride + node];
}

/* Return the index of a node among the inner nodes, or -1 if it is not free. */
static inline long qs_inner(const Membrane *membrane, long node) {
    const long i = node / membrane->line, j = node % membrane->line;
    return qs_free(membrane, i, j) ? (i - 1) * membrane->inner_rows + j - 1 : -1;
}

#endif
