/* Stiffness of the membrane, minus that of a gas at a pressure, in single precision, by pairs of
   neighboring nodes. Blocks are (3, 3), with rows for a node's displacements and columns for those
   of the other node. That is the node itself, or the next one along y, along x, or along both. */
#ifndef MJTACTILE_FILM_STENCIL_H
#define MJTACTILE_FILM_STENCIL_H
#include "band_cholesky_f64.h"
#include "quasistatic.h"
#include "band_cholesky_f32.h"

enum { PAIR_OWN, PAIR_UP, PAIR_BESIDE, PAIR_RISING, PAIR_FALLING, PAIRS };
typedef struct {
    long apart;
    float *block[PAIRS]; /* (3, 3, apart) */
    float *tension_by;   /* (3, apart): derivatives of the mean tension by displacements */
} Stencil;

long film_stencil_size(const Film *film); /* number of floats, a multiple of eight */
Stencil film_stencil_in(const Film *film, float **room);
/* Compute the stiffness at displacements `x` (3, count), with room for a vector behind them. */
void film_stencil(const Film *film, const double *x, double pressure, const Stencil *to);
/* Add the stiffness times `what` (3, count) of nodes on lines `first` to `last` - 1 to the forces
   of these nodes and their neighbors. */
void film_stencil_times(const Film *film, const Stencil *stencil, long first, long last, const Eight *what, Eight *to);

/* Write the stiffness as a band (3 inner), with the three displacements of a node together. */
#define FILM_WIDTH(film) (3 * ((film)->inner_rows + 1) + 2)
void film_stencil_band(const Film *film, const Stencil *stencil, double *band);

static inline long film_pair(const Film *film, int pair) { /* offset of the other node */
    const long away[PAIRS] = {0, 1, film->line, film->line + 1, film->line - 1};
    return away[pair];
}

static inline float film_block(const Stencil *s, int pair, int row, int column, long node) {
    return s->block[pair][(3 * row + column) * s->apart + node];
}

/* Return the index of a node among the inner nodes, or -1 if it is not free. */
static inline long film_inner(const Film *film, long node) {
    const long i = node / film->line, j = node % film->line;
    return film_free(film, i, j) ? (i - 1) * film->inner_rows + j - 1 : -1;
}

#endif
