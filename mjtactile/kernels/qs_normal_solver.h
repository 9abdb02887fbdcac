/* Steps of a film's heights, in single precision. Lines of nodes around what touches, the window, have the sheet's stiffness as it
   is; lines to the left and to the right have that of the sheet at rest, in proportion to its tension, factored once from the left.
   A sheet at rest is the same turned by half a turn, so that this serves the right as well. */
#ifndef MJTACTILE_FILM_HEIGHTS_H
#define MJTACTILE_FILM_HEIGHTS_H
#include "qs_workspace.h"

/* The sheet at rest: its tension, its factor by lines, and, of each line, what the lines before leave of its stiffness. */
typedef struct { float *tension, *factor, *left; } RestHeights;

long film_heights_size(const Film *film);
RestHeights film_heights_at(const Film *film, float *kept);
/* At `x`, with room for `film_sheet` in `fields` and `seen`; 1: not positive definite. */
int film_heights_rest(const Film *film, const double *x, const SheetFields *fields, RestHeights *rest);

/* Links in `along_x` and `along_y` of Seen count between lines `first` and `last`, all of which is the window; `scale`: tension over
   that at rest. `solved` (3, apart) are right-hand sides over all nodes, and then what they ask for; `mirrored` as many. */
typedef struct {
    const RestHeights *rest;
    long first, last, apart;
    float scale, *window, *solved, *mirrored;
} Heights;

long film_heights_room(const Film *film);
Heights film_heights_in(const Film *film, const RestHeights *rest, float **room);
int film_heights_factor(const Film *film, const double *z, const Seen *seen, Heights *heights);
/* Of 1 or 3 right-hand sides, which vanish where nodes are held. */
void film_heights_solve(const Film *film, int many, Heights *heights);
/* Stiffness times `what`, on window lines, of the nodes that touch, or of those that do not. */
void film_heights_times(const Film *film, const double *z, const Seen *seen, const Heights *heights, int touching, const float *what,
                        float *out);

#endif
