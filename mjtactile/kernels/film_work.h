/* What a film's kernels share: their room, the bodies as nodes see them, and the gas. */
#ifndef MJTACTILE_FILM_WORK_H
#define MJTACTILE_FILM_WORK_H
#include "film.h"
#include "film_sheet.h"

enum { CONVERGED, NOT_CONVERGED, AT_THE_RIM, ON_THE_GLASS, INSIDE_OUT, BROKEN_DOWN };

/* What is found, one row an environment. */
enum { FORCE_X, FORCE_Y, FORCE_Z, TORQUE_X, TORQUE_Y, TORQUE_Z, PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED_AREA, TENSION,
       LAST_STEP, FOUND };

typedef struct { double gas, sealed, tolerance, most_steps; } Settings; /* gas: p V^gamma if sealed, else the pressure held */

typedef struct { long count; const double *body, *pool; } Bodies;

#define MEMORY 4 /* steps that the next one learns from */

/* What tension and gas add to the heights' stiffness: tension a a^T + gas v v^T, a the area's and v the volume's slopes by heights,
   (count) each; of the inner nodes that do not touch, b1 and b2, and y1 and y2 after the band's factor. */
typedef struct { double tension, gas, *area_by, *volume_by, *b1, *b2, *y1, *y2; } Whole;

typedef struct {
    SheetFields fields;
    double *obstacle, *level, *slope, *lower;          /* heights (count), see `follow_bodies`, slopes (2, count), correction */
    double *away;                                      /* (2, count) m, from a node to what is thin and was moved under it */
    double *edge, *spring;                             /* see `find_edges` and `find_springs` (4, count) */
    double *residual, *moved, *pushed, *plane;         /* (count) each; plane (2 inner) */
    double *band, *y0;
    Whole whole;
    double pulled; /* which edges' springs are in the factor */
    double *steps, *changes, *last_step, *now; /* of the last MEMORY steps: (MEMORY, 4, count) each, and (4, count) */
    double *start;                       /* (4, count): where a solution began */
    uint8_t *touching;
} Work;

long film_work_size(const Film *film);
Work film_work(const Film *film, double *room);

/* Of bodies: heights and slopes over the nodes where they are; where they end beside a node, to 2^-halves; corrections. */
void see_bodies(const Film *film, const Bodies *bodies, const double *x, Work *work);
void find_edges(const Film *film, const Bodies *bodies, const double *x, long node, int halves, Work *work);
void follow_bodies(const Film *film, const double *x, Work *work);
void lower_round_bodies(const Film *film, Work *work);
int against_the_frame(const Film *film, const Work *work);
/* Springs of a sheet that bends over edges, (4, count) by the side of the node on the body; returns a number that tells which. */
double find_springs(const Film *film, const double *z, Work *work);
/* How much farther than the face, drawn on, the node at a side of `k` is. */
double rises_over_edge(const Film *film, const Work *work, const double *z, long k, int side);
static inline long film_next(const Film *film, int side) { /* +x, -x, +y, -y */
    return side < 2 ? (side ? -film->rows : film->rows) : side == 2 ? 1 : -1;
}

void gas_of(const Film *film, const Settings *set, double bulge, double *pressure, double *stiffness);
/* Wrench about S and the area that touches, into `found`, whose pressure and tension are known. */
void add_up(const Film *film, const double *x, const double *force, double *found, const Work *work);

#endif
