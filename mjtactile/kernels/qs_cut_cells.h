/* What an outline that is no rectangle leaves of a film's grid. Nodes outside of it are held. Cells inside are whole; those that it
   cuts are triangles with corners at nodes and where the grid's lines cross the outline. mjtactile/quasistatic/cut_cells.py makes all of it,
   in this order: whether the outline is lopsided; the number of groups; of each node whether it moves (1), is held beside one that
   moves (0), or is farther out (-1); of each node whether the cell from it on is whole; and groups of eight triangles. */
#ifndef MJTACTILE_FILM_CUT_H
#define MJTACTILE_FILM_CUT_H
#include "band_cholesky_f64.h"
#include "quasistatic.h"

/* Of each triangle its area, m^2 (half of it where two ways to divide a cell share it); its corners' slopes by x and y, 1/m; its
   nodes, in padded lines, 0 of a corner that is held; and the link that stands for each side, from a corner to the next, in the
   stiffness that steps of heights are made with: twice the node that it begins at, one more along y; 0: none. */
typedef struct { double area[LANES], by_x[3][LANES], by_y[3][LANES], node[3][LANES], link[3][LANES]; } CutGroup;

static inline const CutGroup *film_cut(const Film *film, long group) { return (const CutGroup *)film->cuts + group; }

#endif
