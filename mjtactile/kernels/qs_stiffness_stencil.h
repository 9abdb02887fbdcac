/* Stiffness of the sheet, less that of a gas at a pressure, in single precision, by pairs of neighbouring nodes: blocks (3, 3), rows for a node's
   displacements, columns for those of the other, which is itself, or the next along y, along x, or along both. */
#ifndef MJTACTILE_FILM_STENCIL_H
#define MJTACTILE_FILM_STENCIL_H
#include "band_cholesky_f64.h"
#include "quasistatic.h"
#include "band_cholesky_f32.h"

enum { PAIR_OWN, PAIR_UP, PAIR_BESIDE, PAIR_RISING, PAIR_FALLING, PAIRS };
typedef struct {
    long apart;
    float *block[PAIRS]; /* (3, 3, apart) */
    float *tension_by;   /* (3, apart) of the mean tension, by displacements */
} Stencil;

long film_stencil_size(const Film *film); /* of singles, a whole number of eights */
Stencil film_stencil_in(const Film *film, float **room);
/* At displacements `x` (3, count), with room for a vector behind them. */
void film_stencil(const Film *film, const double *x, double pressure, const Stencil *to);
/* Adds the stiffness times `what` (3, count) of nodes on lines `first` to `last` - 1, to what these and their neighbours bear. */
void film_stencil_times(const Film *film, const Stencil *stencil, long first, long last, const Eight *what, Eight *to);

/* Band of it (3 inner), the three displacements of a node together. */
#define FILM_WIDTH(film) (3 * ((film)->inner_rows + 1) + 2)
void film_stencil_band(const Film *film, const Stencil *stencil, double *band);

static inline long film_pair(const Film *film, int pair) { /* how far behind a node the other is */
    const long away[PAIRS] = {0, 1, film->line, film->line + 1, film->line - 1};
    return away[pair];
}

static inline float film_block(const Stencil *s, int pair, int row, int column, long node) {
    return s->block[pair][(3 * row + column) * s->apart + node];
}

/* Number of a node among those that move, or -1. */
static inline long film_inner(const Film *film, long node) {
    const long i = node / film->line, j = node % film->line;
    return film_free(film, i, j) ? (i - 1) * film->inner_rows + j - 1 : -1;
}

#endif
