/* The membrane: elastic forces (qs_elastic_forces.h), in double and in single precision, and its
   link stiffness. */
#include "qs_elasticity.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "qs_cut_cells.h"
#include "small_linalg.h"

/* otherwise loops over them are not vectorized */
#define INLINE static inline __attribute__((always_inline))
#ifdef __clang__
/* lines do not overlap */
#define VECTORS _Pragma("clang loop vectorize(assume_safety) interleave(disable)")
#else
#define VECTORS _Pragma("GCC ivdep")
#endif
#define MIN_DET 1e-2
/* minimum stress in the stiffness of the steps, fraction of the mean of both directions */
#define MIN_TENSION 0.3

Membrane qs_membrane(const double *numbers, const double *law) {
    Membrane membrane = {.law = law};
    memcpy(&membrane.numbers, numbers, sizeof membrane.numbers);
    membrane.columns = (long)membrane.numbers.nodes_x, membrane.rows = (long)membrane.numbers.nodes_y;
    membrane.inner_rows = membrane.rows - 2, membrane.inner = (membrane.columns - 2) * membrane.inner_rows;
    membrane.line = (membrane.rows + 7) / 8 * 8, membrane.count = membrane.columns * membrane.line;
    membrane.dx = membrane.numbers.length_x / (membrane.columns - 1), membrane.dy = membrane.numbers.length_y / (membrane.rows - 1);
    const double *cut = (const double *)(uintptr_t)membrane.numbers.cut;
    if (!cut) return membrane;
    const long nodes = membrane.columns * membrane.rows;
    membrane.lopsided = cut[0] != 0, membrane.groups = (long)cut[1];
    membrane.inside = cut + 2, membrane.uncut = membrane.inside + nodes, membrane.cuts = membrane.uncut + nodes;
    return membrane;
}

#define REAL double
#define SQRT sqrt
#define TYPE(name) name
#include "qs_elastic_forces.h"
#undef REAL
#undef SQRT
#undef TYPE

#define REAL float
#define SQRT sqrtf
#define TYPE(name) name##Float
#include "qs_elastic_forces.h"
#undef REAL
#undef SQRT
#undef TYPE
