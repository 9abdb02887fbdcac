/* Elastic response of the membrane, at one point and as a whole. */
#ifndef MJTACTILE_QS_ELASTICITY_H
#define MJTACTILE_QS_ELASTICITY_H
#include "quasistatic.h"

/* Response to a deformation (3, count): `elastic` (3, count) forces, the volume's `gradient`
   (3, count), and, between lines `first` and `last`, the stiffness of node links against heights,
   to the next node along x and along y. */
typedef struct { double *elastic, *gradient, *along_x, *along_y; } MembraneFields;
typedef struct { float *elastic, *gradient, *along_x, *along_y; } MembraneFieldsFloat;

/* Sums over the membrane. The last two are minima over the cells: of the ratio of projected areas,
   and of 1 / sqrt(det C). */
typedef struct { double volume, area, tension, min_turn, min_root; } MembraneSums;

/* Requested parts of forces and gradients: of heights, of in-plane displacements. Other parts are
   not written, except for the volume's gradient by heights. `x` has room for one node behind its
   last. */
enum { QS_HEIGHTS = 1, QS_PLANE = 2, QS_LINKS = 4, QS_ALL = 3 };
MembraneSums qs_elastic(const Membrane *membrane, const double *x, int parts, long first, long last, const MembraneFields *to);
MembraneSums qs_elasticFloat(const Membrane *membrane, const double *x, int parts, long first, long last, const MembraneFieldsFloat *to);

#endif
