/* A step of a film's solution: what it works with, of the heights, and in the plane. */
#ifndef MJTACTILE_FILM_STEP_H
#define MJTACTILE_FILM_STEP_H
#include "qs_normal_solver.h"
#include "qs_anderson.h"
#include "qs_inplane_solver.h"
#include "qs_workspace.h"

/* What tension and gas add to the heights' stiffness: tension a a^T + gas v v^T, a the area's and v the volume's slopes by heights,
   (count) each; y1 and y2 are what they move. */
typedef struct { double tension, gas; float *area_by, *volume_by, *y1, *y2; } Whole;

typedef struct {
    Seen seen;
    double *x, *force;                   /* (3, count), (count); x has room behind it */
    SheetFields fine;
    SheetFieldsFloat fast;
    float *residual;                     /* (3, count): elastic forces less the gas's */
    float *pulls, *swells;               /* (count) elastic forces and the volume's slopes by heights */
    float *moved, *pushed, *plane, *plane_room;
    Whole whole;
    Heights heights;
    Learnt learnt;
    const float *plane_factor;
    double pulled;                       /* which edges' springs are in the factor */
    double pressure, gas_stiffness;
    SheetSums sums;
} Work;

long film_room_of(const Film *film); /* doubles that this wants */
Work film_work_in(const Film *film, const RestHeights *rest, const float *plane_factor, double *room);
/* Forces on the nodes, of heights or in the plane, and what goes with them. */
void see_sheet(const Film *film, const Settings *set, int parts, Work *work);
/* Bodies at the nodes, `lifted` m off where they are. */
void check_image(const Film *film, const Bodies *bodies, double lifted, int step, Work *work);
/* The lines that what touches, or is about to, has about it; 0 where all of them are in the window already. */
int widen_window(const Film *film, double near, Work *work);
/* Edges' springs into residual and links; `by` -1 takes them out again. */
void stiffen_edges(const Film *film, const double *z, double by, Work *work);
/* All that a step of the heights needs but its residual. */
int prepare_heights(const Film *film, const double *z, Work *work);
/* The heights' step `moved` and what it leaves for the contact to carry, `pushed`. `fresh`: the factor is new. */
void step_heights(const Film *film, const double *z, int fresh, Work *work);
/* Heights and contact, with the sheet's stiffness as it is now; found anew as long as others touch. */
int settle_heights(const Film *film, const Settings *set, const Bodies *bodies, double loose, int first, int most_sets, Work *work,
                   int *changed);
/* Largest size of a whole number of eights; NaN where one is no number. */
double largest_of(const float *values, long n);
/* The step (2, count) into `plane`; returns its largest. Frictionless: a contact pushes along the body's normal. */
double step_plane(const Film *film, Work *work);

#endif
