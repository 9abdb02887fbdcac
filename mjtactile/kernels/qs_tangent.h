/* Tangent of a membrane in equilibrium: stiffness of the membrane minus that of the gas, with the
   heights in contact eliminated by the obstacles' slopes, factored once. Also the fields in which
   changes of obstacles are solved (qs_sensitivity.c). */
#ifndef MJTACTILE_QS_TANGENT_H
#define MJTACTILE_QS_TANGENT_H
#include "qs_stiffness_stencil.h"
#include "qs_workspace.h"
#include "band_cholesky_f32.h"
#include "small_linalg.h"

typedef struct {
    ContactNodes seen;
    MembraneFields fields;                 /* (3, count) twice: forces, and the volume's gradient */
    Stencil stiffness;
    float *band;                        /* band in panels, 3 inner */
    double *slope, *spring, *obstacle;  /* values at equilibrium: (2, count), (4, count), (count) */
    double *at, *pressed;               /* equilibrium: (3, count), (count) */
    double *x, *force;                  /* moved state: (3, count), (count) */
    /* effect of the obstacles in equilibrium, and in the moved state: (4, count) */
    double *base, *pressed_on;
    Eight *rhs;                         /* 3 inner, with room behind */
    /* (4, count) by obstacles: forces on nodes, and distance of nodes in contact from their
       obstacle */
    Eight *residual;
    /* (3, count): membrane forces of all displacements found, and the next displacements */
    Eight *borne, *given;
    Eight *found;                       /* (4, count): displacements and forces */
    Lanes swells;                       /* volume change by the result, m^3 */
    double gas_stiffness, pressure, tension;
    double sums[FOUND];                 /* sums at equilibrium */
} Tangent;

static inline long panels_of(const Membrane *f) { return (3 * f->inner + PANEL - 1) / PANEL; }
static inline long band_of(const Membrane *f) { return panels_of(f) * PANEL * panels_height(QS_WIDTH(f)); }
static inline long rows_of(const Membrane *f) { return panels_of(f) * PANEL + panels_height(QS_WIDTH(f)); }

/* Return the range of lines on and next to which obstacles are evaluated. */
static inline long first_line(const Membrane *f, const ContactNodes *s) {
    return s->box[0] < s->box[1] ? (long)max_of(s->box[0] - 1, 0) : f->columns;
}
static inline long behind_lines(const Membrane *f, const ContactNodes *s) { return (long)min_of(s->box[1] + 1, f->columns); }

long qs_tangent_size(const Membrane *membrane);
Tangent qs_tangent_in(const Membrane *membrane, double *room);
/* Assemble and factor the tangent at `x` under `force`, with known pressure, slopes and springs.
   Returns nonzero if it is not positive definite. */
int qs_tangent_make(const Membrane *membrane, const Bodies *bodies, const double *x, const double *force, Tangent *t);
/* Add the forces of edge springs due to `what`, as qs_stencil_times does for the membrane;
   heights only. */
void qs_tangent_springs(const Membrane *membrane, const Tangent *t, const Eight *what, Eight *to);

#endif
