/* Height steps of a membrane, in single precision. Lines of nodes around the contact, the window,
   have the present stiffness. Lines to the left and right have that without contact, scaled by the
   tension ratio and factored once from the left. Without contact, the membrane is symmetric under
   half a turn, so that this factor also serves the right side. */
#ifndef MJTACTILE_QS_NORMAL_SOLVER_H
#define MJTACTILE_QS_NORMAL_SOLVER_H
#include "qs_workspace.h"

/* Membrane without contact: its tension, its factor by lines, and for each line the remainder of
   its stiffness after elimination of the lines before. */
typedef struct { float *tension, *factor, *left; } RestHeights;

long qs_normal_size(const Membrane *membrane);
RestHeights qs_heights_at(const Membrane *membrane, float *kept);
/* Factor the stiffness at `x`; `fields` is workspace for `qs_elastic`. Returns 1 if it is not
   positive definite. */
int qs_normal_remainder(const Membrane *membrane, const double *x, const MembraneFields *fields, RestHeights *rest);

/* Window: lines `first` to `last`, between which links in `along_x` and `along_y` of ContactNodes apply.
   `scale`: tension over that without contact. `solved` (3, apart): right-hand sides over all nodes,
   then the solutions; `mirrored` has the same size. */
typedef struct {
    const RestHeights *rest;
    long first, last, stride;
    float scale, *window, *solved, *mirrored;
} Heights;

long qs_normal_workspace_size(const Membrane *membrane);
Heights qs_normal_in(const Membrane *membrane, const RestHeights *rest, float **room);
int qs_normal_factor(const Membrane *membrane, const double *z, const ContactNodes *seen, Heights *heights);
/* Solve for 1 or 3 right-hand sides, which are zero at fixed nodes. */
void qs_normal_solve(const Membrane *membrane, int many, Heights *heights);
/* Multiply the stiffness by `what` on lines of the window, for nodes in contact (`touching` 1) or
   all others (0). */
void qs_normal_times(const Membrane *membrane, const double *z, const ContactNodes *seen, const Heights *heights, int touching,
                     const float *what, float *out);

#endif
