#include "splines.h"

#include <math.h>
#include <string.h>

#include "small_linalg.h"

static double knot(long i, long spans) { return i < 0 ? 0 : i > spans ? spans : i; }

/* Evaluate the splines by De Boor's recursion (Piegl & Tiller, The NURBS Book, A2.2) in units of an
   interval, and their slopes from degree two. */
Local splines_at(double length, long spans, double x) {
    const double step = length / spans, u = clip((x + length / 2) / step, 0, spans);
    const long k = u < spans ? (long)u : spans - 1;
    double n[4] = {1}, two[3];
    Local at = {.first = k - 1};
    for (int degree = 1; degree < 4; degree++) {
        double saved = 0;
        if (degree == 3) memcpy(two, n, sizeof two);
        for (int r = 0; r < degree; r++) {
            double right = knot(k + r + 1, spans) - u, left = u - knot(k + 1 + r - degree, spans), fraction = n[r] / (right + left);
            n[r] = saved + right * fraction;
            saved = left * fraction;
        }
        n[degree] = saved;
    }
    for (int r = 0; r < 4; r++) {
        double rise = r > 0 ? two[r - 1] / (knot(k + r, spans) - knot(k + r - 3, spans)) : 0;
        double fall = r < 3 ? two[r] / (knot(k + r + 1, spans) - knot(k + r - 2, spans)) : 0;
        at.value[r] = n[r], at.slope[r] = 3 * (rise - fall) / step;
    }
    /* the first and the last of all splines are omitted */
    if (k == 0) {
        memmove(at.value, at.value + 1, 3 * sizeof *at.value), memmove(at.slope, at.slope + 1, 3 * sizeof *at.slope);
        at.first++, at.value[3] = at.slope[3] = 0;
    }
    if (k == spans - 1) {
        memmove(at.value + 1, at.value, 3 * sizeof *at.value), memmove(at.slope + 1, at.slope, 3 * sizeof *at.slope);
        at.first--, at.value[0] = at.slope[0] = 0;
    }
    return at;
}
