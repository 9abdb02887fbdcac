/* The tangent of a film at rest: the stiffness of the sheet less that of the gas, with the heights of what touches eliminated by the
   bodies' slopes, factored once; and the fields that changes of bodies are solved in with it (film_derive.c). */
#ifndef MJTACTILE_FILM_TANGENT_H
#define MJTACTILE_FILM_TANGENT_H
#include "qs_stiffness_stencil.h"
#include "qs_workspace.h"
#include "band_cholesky_f32.h"
#include "small_linalg.h"

typedef struct {
    Seen seen;
    SheetFields fields;                 /* (3, count) twice: forces, and the volume's slopes */
    Stencil stiffness;
    float *band;                        /* of panels, 3 inner */
    double *slope, *spring, *obstacle;  /* where the film is: (2, count), (4, count), (count) */
    double *at, *pressed;               /* the film: (3, count), (count) */
    double *x, *force;                  /* moved: (3, count), (count) */
    double *base, *pressed_on;          /* what bodies do where the film is, and where it is moved: (4, count) */
    Eight *rhs;                         /* 3 inner, with room behind */
    Eight *residual;                    /* (4, count) by bodies: forces on nodes, and how far what touches is off its body */
    Eight *borne, *given;               /* (3, count): what the sheet bears of all that was found, and of what is found next */
    Eight *found;                       /* (4, count): displacements and forces */
    Lanes swells;                       /* m^3 of what was found */
    double gas_stiffness, pressure, tension;
    double sums[FOUND];                 /* what is added up where the film is */
} Tangent;

static inline long panels_of(const Film *f) { return (3 * f->inner + PANEL - 1) / PANEL; }
static inline long band_of(const Film *f) { return panels_of(f) * PANEL * panels_height(FILM_WIDTH(f)); }
static inline long rows_of(const Film *f) { return panels_of(f) * PANEL + panels_height(FILM_WIDTH(f)); }

/* Lines on and beside which bodies are seen. */
static inline long first_line(const Film *f, const Seen *s) { return s->box[0] < s->box[1] ? (long)most(s->box[0] - 1, 0) : f->columns; }
static inline long behind_lines(const Film *f, const Seen *s) { return (long)least(s->box[1] + 1, f->columns); }

long film_tangent_room(const Film *film);
Tangent film_tangent_in(const Film *film, double *room);
/* At `x` under `force`, with pressure, slopes and springs known; not 0: not positive definite. */
int film_tangent_make(const Film *film, const Bodies *bodies, const double *x, const double *force, Tangent *t);
/* What edges' springs bear of `what`, as film_stencil_times of the sheet; of the heights alone. */
void film_tangent_springs(const Film *film, const Tangent *t, const Eight *what, Eight *to);

#endif
