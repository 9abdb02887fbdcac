/* In-plane steps of a membrane, with its stiffness without contact, in single precision. This
   stiffness is constant and symmetric under a mirror along y. Even and odd parts are therefore
   solved separately, each on half of the nodes. */
#ifndef MJTACTILE_QS_INPLANE_SOLVER_H
#define MJTACTILE_QS_INPLANE_SOLVER_H
#include "qs_stiffness_stencil.h"

/* Return the number of floats of the factor, and of the unknowns' workspace. */
long qs_inplane_size(const Membrane *membrane);
long qs_inplane_workspace_size(const Membrane *membrane);
/* Factor the stiffness. Returns 1 if it is not positive definite. */
int qs_inplane_factor(const Membrane *membrane, const Stencil *stencil, float *factor);
/* Replace `residual` (2, count) by the step that it requires. */
void qs_inplane_solve(const Membrane *membrane, const float *factor, float *residual, float *room);

#endif
