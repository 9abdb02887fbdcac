/* The sheet of a film, at one place and as a whole. */
#ifndef MJTACTILE_FILM_SHEET_H
#define MJTACTILE_FILM_SHEET_H
#include "film.h"

/* What a deformation (3, count) does: `elastic` (3, count) forces, the volume's `gradient` (3, count), and, between lines `first` and
   `last`, the stiffness by which links of nodes resist heights, to the next node along x and along y. */
typedef struct { double *elastic, *gradient, *along_x, *along_y; } SheetFields;
typedef struct { float *elastic, *gradient, *along_x, *along_y; } SheetFieldsFloat;

typedef struct { double volume, area, tension, least_turn, least_root; } SheetSums; /* the last two: of the cells' shadows on the
   plane, and of 1 / sqrt(det C) */

/* What is wanted of forces and gradients: of heights, of displacements in the plane. What is not is not written, but for the volume's
   slopes by heights. `x` has room for a node behind its last. */
enum { FILM_HEIGHTS = 1, FILM_PLANE = 2, FILM_LINKS = 4, FILM_ALL = 3 };
SheetSums film_sheet(const Film *film, const double *x, int parts, long first, long last, const SheetFields *to);
SheetSums film_sheetFloat(const Film *film, const double *x, int parts, long first, long last, const SheetFieldsFloat *to);

/* What a corner of a cell adds to the stiffness of elastic forces less those of a gas at `pressure`: of three nodes, the corner and
   the other ends of its edges along x and y, three displacements each. `corner` goes from 0 to FILM_CORNERS - 1. */
#define FILM_CORNERS(film) (4 * ((film)->columns - 1) * ((film)->rows - 1))
typedef struct { long node[3]; double K[9][9]; } CornerStiffness;
void film_corner_nodes(const Film *film, long corner, long node[3]);
void film_corner(const Film *film, const double *x, double pressure, long corner, CornerStiffness *out);

/* Number of a node among those that move, or -1. */
static inline long film_inner(const Film *film, long node) {
    const long i = node / film->line, j = node % film->line;
    return i < 1 || j < 1 || i > film->columns - 2 || j > film->rows - 2 ? -1 : (i - 1) * film->inner_rows + j - 1;
}

/* Band of the stiffness (2 inner) of displacements in the plane, x and y of a node together, at a deformation. */
#define FILM_PLANE_WIDTH(film) (2 * ((film)->inner_rows + 1) + 1)
void film_plane_stiffness(const Film *film, const double *x, double *band);

#endif
