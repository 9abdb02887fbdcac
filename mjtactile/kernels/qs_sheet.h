/* Elastic response of the membrane, at one point and as a whole. */
#ifndef MJTACTILE_FILM_SHEET_H
#define MJTACTILE_FILM_SHEET_H
#include "quasistatic.h"

/* Response to a deformation (3, count): `elastic` (3, count) forces, the volume's `gradient`
   (3, count), and, between lines `first` and `last`, the stiffness of node links against heights,
   to the next node along x and along y. */
typedef struct { double *elastic, *gradient, *along_x, *along_y; } SheetFields;
typedef struct { float *elastic, *gradient, *along_x, *along_y; } SheetFieldsFloat;

/* Sums over the membrane. The last two are minima over the cells: of the ratio of projected areas,
   and of 1 / sqrt(det C). */
typedef struct { double volume, area, tension, least_turn, least_root; } SheetSums;

/* Requested parts of forces and gradients: of heights, of in-plane displacements. Other parts are
   not written, except for the volume's gradient by heights. `x` has room for one node behind its
   last. */
enum { FILM_HEIGHTS = 1, FILM_PLANE = 2, FILM_LINKS = 4, FILM_ALL = 3 };
SheetSums film_sheet(const Film *film, const double *x, int parts, long first, long last, const SheetFields *to);
SheetSums film_sheetFloat(const Film *film, const double *x, int parts, long first, long last, const SheetFieldsFloat *to);

#endif
