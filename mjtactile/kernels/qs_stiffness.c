/* Stiffness of a membrane: without contact, as used by all of its solutions, and at a given
   state. */
#include <stdlib.h>
#include <string.h>

#include "band_cholesky_f64.h"
#include "qs_step.h"
#include "kernels.h"

/* Compute the membrane's stiffness at `x`, minus that of a gas, in new memory, to be freed by
   `block[0]`. Returns 1 if memory runs out. */
static int stiffness_at(const Membrane *f, const double *x, double pressure, Stencil *stencil) {
    float *room = malloc(qs_stencil_size(f) * sizeof *room);
    if (!room) return 1;
    *stencil = qs_stencil_in(f, &room);
    qs_stencil(f, x, pressure, stencil);
    return 0;
}

int64_t qs_factorize(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *x, int64_t roomy, double *room,
                  int64_t keeping, float *kept) {
    const Membrane f = qs_membrane(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > QS_MAX_LINE || keeping < qs_factors_size(numbers)) return REFUSED;
    if (roomy < qs_workspace_size_of(&f)) return REFUSED;
    RestHeights rest = qs_heights_at(&f, kept);
    Work w = qs_work_in(&f, &rest, kept, room);
    Stencil stencil;
    qs_pad(&f, 3, x, w.x);
    if (qs_normal_remainder(&f, w.x, &w.fine, &rest)) return NOT_DEFINITE;
    if (stiffness_at(&f, w.x, 0, &stencil)) return NO_MEMORY;
    const int code = qs_inplane_factor(&f, &stencil, kept + qs_normal_size(&f));
    free(stencil.block[0]);
    return code ? NOT_DEFINITE : 0;
}

int64_t qs_stiffness(const double *numbers, const double *law, int64_t columns, int64_t rows, const double *x, double pressure,
                       int64_t roomy, double *room, double *factor) {
    const Membrane f = qs_membrane(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < 3 * f.count + LANES) return REFUSED;
    Stencil stencil;
    qs_pad(&f, 3, x, room), memset(room + 3 * f.count, 0, LANES * sizeof *room);
    if (stiffness_at(&f, room, pressure, &stencil)) return NO_MEMORY;
    qs_stencil_band(&f, &stencil, factor);
    free(stencil.block[0]);
    return band_cholesky(3 * f.inner, QS_WIDTH(&f), factor) ? NOT_DEFINITE : 0;
}
