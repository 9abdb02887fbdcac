/* Cells of a membrane's grid that a non-rectangular outline cuts. Nodes outside of it are fixed.
   Cells inside are whole. Cut cells are triangles with corners at nodes and where grid lines cross
   the outline. mjtactile/quasistatic/cut_cells.py creates all values, in this order: 1 if the
   outline is asymmetric; the number of groups; for each node 1 if it is free, 0 if it is fixed next
   to a free node, -1 if it is farther out; for each node 1 if the cell that begins at it is whole;
   groups of eight triangles. */
#ifndef MJTACTILE_QS_CUT_CELLS_H
#define MJTACTILE_QS_CUT_CELLS_H
#include "band_cholesky_f64.h"
#include "quasistatic.h"

/* Eight triangles. Area, m^2, or half of it if two divisions of a cell share it. Slopes of the
   corners by x and y, 1/m. Nodes in padded lines, 0 for a fixed corner. Link for each side, from a
   corner to the next, in the stiffness of the height steps: twice its first node, plus one along y;
   0 for none. */
typedef struct { double area[LANES], by_x[3][LANES], by_y[3][LANES], node[3][LANES], link[3][LANES]; } CutGroup;

static inline const CutGroup *qs_cut_group(const Membrane *membrane, long group) { return (const CutGroup *)membrane->cuts + group; }

#endif
