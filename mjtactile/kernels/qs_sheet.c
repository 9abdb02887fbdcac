/* The membrane: elastic forces (qs_elastic_forces.h), in double and in single precision, and its
   link stiffness. */
#include "qs_sheet.h"

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
#define LEAST_DET 1e-2
/* minimum stress in the stiffness of the steps, fraction of the mean of both directions */
#define LEAST_TENSION 0.3

Film film_of(const double *numbers, const double *law) {
    Film film = {.law = law};
    memcpy(&film.numbers, numbers, sizeof film.numbers);
    film.columns = (long)film.numbers.nodes_x, film.rows = (long)film.numbers.nodes_y;
    film.inner_rows = film.rows - 2, film.inner = (film.columns - 2) * film.inner_rows;
    film.line = (film.rows + 7) / 8 * 8, film.count = film.columns * film.line;
    film.dx = film.numbers.length_x / (film.columns - 1), film.dy = film.numbers.length_y / (film.rows - 1);
    const double *cut = (const double *)(uintptr_t)film.numbers.cut;
    if (!cut) return film;
    const long nodes = film.columns * film.rows;
    film.lopsided = cut[0] != 0, film.groups = (long)cut[1];
    film.inside = cut + 2, film.whole = film.inside + nodes, film.cuts = film.whole + nodes;
    return film;
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
