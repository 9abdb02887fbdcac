/* The sheet of a film, at one place and as a whole. */
#ifndef MJTACTILE_FILM_SHEET_H
#define MJTACTILE_FILM_SHEET_H
#include "film.h"

/* What a deformation (3, count) does: `elastic` (3, count) forces, the volume's `gradient` (3, count), and, if wanted, the height's
   stiffness at one local tension: five numbers a node, with itself and its neighbours at (0, 1), (1, 0), (1, 1) and (1, -1). */
typedef struct { double *elastic, *gradient, *own, *up, *right, *right_up, *right_down; } SheetFields;

typedef struct { double volume, area, tension, least_turn; } SheetSums; /* the last: of the cells' shadows on the plane */

SheetSums film_sheet(const Film *film, const double *x, const SheetFields *to);

/* Band of the stiffness (2 inner) of displacements in the plane, x and y of a node together, at a deformation. */
#define FILM_PLANE_WIDTH(film) (2 * ((film)->inner_rows + 1) + 1)
void film_plane_stiffness(const Film *film, const double *x, double *band);

#endif
