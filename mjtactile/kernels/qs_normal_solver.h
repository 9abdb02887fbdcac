/* Height steps of a membrane, in single precision. Lines of nodes around the contact, the window,
   have the present stiffness. Lines to the left and right have that without contact, scaled by the
   tension ratio and factored once from the left. Without contact, the membrane is symmetric under
   half a turn, so that this factor also serves the right side. */
#ifndef MJTACTILE_FILM_HEIGHTS_H
#define MJTACTILE_FILM_HEIGHTS_H
#include "qs_workspace.h"

/* Membrane without contact: its tension, its factor by lines, and for each line the remainder of
   its stiffness after elimination of the lines before. */
typedef struct { float *tension, *factor, *left; } RestHeights;

long film_heights_size(const Film *film);
RestHeights film_heights_at(const Film *film, float *kept);
/* Factor the stiffness at `x`; `fields` is workspace for `film_sheet`. Returns 1 if it is not
   positive definite. */
int film_heights_rest(const Film *film, const double *x, const SheetFields *fields, RestHeights *rest);

/* Window: lines `first` to `last`, between which links in `along_x` and `along_y` of Seen apply.
   `scale`: tension over that without contact. `solved` (3, apart): right-hand sides over all nodes,
   then the solutions; `mirrored` has the same size. */
typedef struct {
    const RestHeights *rest;
    long first, last, apart;
    float scale, *window, *solved, *mirrored;
} Heights;

long film_heights_room(const Film *film);
Heights film_heights_in(const Film *film, const RestHeights *rest, float **room);
int film_heights_factor(const Film *film, const double *z, const Seen *seen, Heights *heights);
/* Solve for 1 or 3 right-hand sides, which are zero at fixed nodes. */
void film_heights_solve(const Film *film, int many, Heights *heights);
/* Multiply the stiffness by `what` on lines of the window, for nodes in contact (`touching` 1) or
   all others (0). */
void film_heights_times(const Film *film, const double *z, const Seen *seen, const Heights *heights, int touching, const float *what,
                        float *out);

#endif
