/* In-plane steps of a membrane, with its stiffness without contact, in single precision. This
   stiffness is constant and symmetric under a mirror along y. Even and odd parts are therefore
   solved separately, each on half of the nodes. */
#ifndef MJTACTILE_FILM_PLANE_H
#define MJTACTILE_FILM_PLANE_H
#include "qs_stiffness_stencil.h"

/* Return the number of floats of the factor, and of the unknowns' workspace. */
long film_plane_size(const Film *film);
long film_plane_room(const Film *film);
/* Factor the stiffness. Returns 1 if it is not positive definite. */
int film_plane_factor(const Film *film, const Stencil *stencil, float *factor);
/* Replace `residual` (2, count) by the step that it requires. */
void film_plane_solve(const Film *film, const float *factor, float *residual, float *room);

#endif
