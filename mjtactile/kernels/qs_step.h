/* Solution step of a membrane: workspace, heights, and in-plane displacements. */
#ifndef MJTACTILE_QS_STEP_H
#define MJTACTILE_QS_STEP_H
#include "qs_normal_solver.h"
#include "qs_anderson.h"
#include "qs_inplane_solver.h"
#include "qs_workspace.h"

/* Terms of tension and gas in the height stiffness: tension a a^T + gas v v^T. a and v are the
   gradients of area and volume by heights, (count) each; y1 and y2 are the solutions for them. */
typedef struct { double tension, gas; float *area_by, *volume_by, *y1, *y2; } GlobalTerms;

typedef struct {
    ContactNodes seen;
    double *x, *force;                   /* (3, count), (count); x has room behind it */
    MembraneFields fine;
    MembraneFieldsFloat fast;
    float *residual;                     /* (3, count): elastic forces minus those of the gas */
    float *pulls, *swells; /* (count): elastic forces, and the volume's gradient by heights */
    float *moved, *pushed, *plane, *plane_room;
    GlobalTerms global;
    Heights heights;
    Anderson learnt;
    const float *plane_factor;
    double pulled;                       /* identifies the edge springs in the factor */
    double pressure, gas_stiffness;
    MembraneSums sums;
} Work;

long qs_workspace_size_of(const Membrane *membrane); /* number of doubles of workspace */
Work qs_work_in(const Membrane *membrane, const RestHeights *rest, const float *plane_factor, double *room);
/* Compute the forces on the nodes, of heights or in the plane, and related quantities. */
void update_membrane(const Membrane *membrane, const Settings *set, int parts, Work *work);
/* Evaluate the obstacles at the nodes, shifted up by `lifted` m. */
void update_obstacles(const Membrane *membrane, const Bodies *bodies, double lifted, int step, Work *work);
/* Extend the window to the lines around nodes that are, or will soon be, in contact. Returns 0 if
   all of them are in the window already. */
int widen_window(const Membrane *membrane, double near, Work *work);
/* Add the edge springs to residual and links; `by` -1 removes them. */
void stiffen_edges(const Membrane *membrane, const double *z, double by, Work *work);
/* Prepare a height step, except for its residual. */
int prepare_heights(const Membrane *membrane, const double *z, Work *work);
/* Compute the height step `moved`, and the resulting contact forces `pushed`. `fresh`: the factor
   is new. */
void step_heights(const Membrane *membrane, const double *z, int fresh, Work *work);
/* Update heights and contact with the present stiffness of the membrane; repeat while the nodes in
   contact change. */
int settle_heights(const Membrane *membrane, const Settings *set, const Bodies *bodies, double loose, int first, int max_sets, Work *work,
                   int *changed);
/* Return the largest absolute value of `n` values, a multiple of eight; NaN if any is not
   finite. */
double largest_of(const float *values, long n);
/* Compute the in-plane step (2, count) in `plane`; return its largest value. Frictionless: contact
   forces are along the obstacle's normal. */
double step_plane(const Membrane *membrane, const Settings *set, Work *work);

#endif
