/* The sheet of a film, at one place and as a whole. */
#ifndef MJTACTILE_FILM_SHEET_H
#define MJTACTILE_FILM_SHEET_H
#include "quasistatic.h"

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

#endif
