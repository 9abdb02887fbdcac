/* Steps of a film in the plane, with the stiffness of the sheet at rest: constant, and the same mirrored along y, so that what
   is even and what is odd are solved apart, each on half of the nodes. Single precision. */
#ifndef MJTACTILE_FILM_PLANE_H
#define MJTACTILE_FILM_PLANE_H
#include "qs_stiffness_stencil.h"

/* Numbers of the factor, and of what stands to be solved. */
long film_plane_size(const Film *film);
long film_plane_room(const Film *film);
/* 1: not positive definite. */
int film_plane_factor(const Film *film, const Stencil *stencil, float *factor);
/* `residual` (2, count) becomes the step that it asks for. */
void film_plane_solve(const Film *film, const float *factor, float *residual, float *room);

#endif
