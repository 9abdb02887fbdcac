/* Assignment of detected circles to markers: sensing/pose/marker_matching.py. Unknown positions are
   NaN. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "optics.h"
#include "small_linalg.h"

#define ROUNDS 3 /* rounds: match, estimate the motion of the neighborhood, match again */

/* Settings in the order of the dataclass IdentitySettings. */
typedef struct { double gate, displacement_tolerance, neighbours, height_weight, shift_resolution; } IdentitySettings;

_Static_assert(sizeof(IdentitySettings) == 5 * sizeof(double), "as in kernels.h");

typedef struct { int64_t n, m, k, neighbours; const double *found, *expected; const int64_t *order; double pitch; } Scene;

static int is_known(const double *xy) { return isfinite(xy[0]) && isfinite(xy[1]); }

static double squared_distance(const double *a, const double *b) { return square(a[0] - b[0]) + square(a[1] - b[1]); }

/* mean of the two central values if n is even; reorders the values */
static double median(double *values, int64_t n) {
    double high = upper_median(values, n), low = -INFINITY;
    if (n % 2) return high;
    for (int64_t i = 0; i < n / 2; i++) low = max_of(low, values[i]);
    return (low + high) / 2;
}

/* Compute the median displacement (m, 2) of each marker's nearest neighbors with a known one in
   `moved`. Without such neighbors it is the median of all, and zero if nothing is known. `work`
   (m + 2 k). */
static void smooth(const Scene *scene, const double *moved, double *out, double *work) {
    double common[2] = {0, 0};
    for (int axis = 0; axis < 2; axis++) {
        int64_t count = 0;
        for (int64_t i = 0; i < scene->m; i++)
            if (is_known(moved + 2 * i)) work[count++] = moved[2 * i + axis];
        if (count) common[axis] = median(work, count);
    }
    for (int64_t i = 0; i < scene->m; i++) {
        double *near[2] = {work + scene->m, work + scene->m + scene->k};
        int64_t count = 0;
        for (int64_t j = 0; j < scene->k && count < scene->neighbours; j++) {
            const double *one = moved + 2 * scene->order[i * scene->k + j];
            if (is_known(one)) near[0][count] = one[0], near[1][count++] = one[1];
        }
        for (int axis = 0; axis < 2; axis++) out[2 * i + axis] = count ? median(near[axis], count) : common[axis];
    }
}

/* Find the pairs that are each other's nearest and closer than `gate`: `ids` (n), -1 for none.
   `back` (m), `shift` (m, 2). */
static void mutual_nearest(const Scene *scene, const double *shift, double gate, int64_t *ids, int64_t *back, double *nearest) {
    for (int64_t j = 0; j < scene->m; j++) back[j] = -1, nearest[j] = INFINITY;
    for (int64_t i = 0; i < scene->n; i++) {
        double best = INFINITY;
        ids[i] = -1;
        if (!is_known(scene->found + 2 * i)) continue;
        for (int64_t j = 0; j < scene->m; j++) {
            double at[2] = {scene->expected[2 * j] + shift[2 * j], scene->expected[2 * j + 1] + shift[2 * j + 1]};
            double d2 = squared_distance(scene->found + 2 * i, at);
            if (d2 < best) best = d2, ids[i] = j;
            if (d2 < nearest[j]) nearest[j] = d2, back[j] = i;
        }
        if (!(best < gate * gate)) ids[i] = -1;
    }
    for (int64_t i = 0; i < scene->n; i++)
        if (ids[i] >= 0 && back[ids[i]] != i) ids[i] = -1;
}

/* Estimate the common offset of all circles from their expected positions, up to half a pitch. It
   is the densest point among the offsets of every circle to its nearest marker. `offsets` (n, 2),
   `work` (n). */
static void common_shift(const Scene *scene, double same, double *out, double *offsets, double *work) {
    int64_t count = 0, densest = -1, max_near = 0;
    out[0] = out[1] = 0;
    for (int64_t i = 0; i < scene->n; i++) {
        double best = INFINITY;
        const double *here = scene->found + 2 * i;
        if (!is_known(here)) continue;
        for (int64_t j = 0; j < scene->m; j++) {
            double d2 = squared_distance(here, scene->expected + 2 * j);
            if (d2 < best) best = d2, offsets[2 * count] = here[0] - scene->expected[2 * j],
                           offsets[2 * count + 1] = here[1] - scene->expected[2 * j + 1];
        }
        if (best < square(scene->pitch)) count++;
    }
    for (int64_t i = 0; i < count; i++) {
        int64_t near = 0;
        for (int64_t j = 0; j < count; j++) near += squared_distance(offsets + 2 * i, offsets + 2 * j) < square(scene->pitch / same);
        if (near > max_near) max_near = near, densest = i;
    }
    for (int axis = 0; axis < 2 && densest >= 0; axis++) {
        int64_t near = 0;
        for (int64_t j = 0; j < count; j++)
            if (squared_distance(offsets + 2 * densest, offsets + 2 * j) < square(scene->pitch / same)) work[near++] = offsets[2 * j + axis];
        out[axis] = median(work, near);
    }
}

/* Compute the displacements (m, 2) of the markers matched so far, and drop matches that do not move
   with their neighbors. Returns the number of dropped matches. */
static int64_t drop_inconsistent(const Scene *scene, const IdentitySettings *s, int64_t *ids, double *moved, double *common,
                                 double *work) {
    int64_t wrong = 0;
    for (int64_t j = 0; j < 2 * scene->m; j++) moved[j] = NAN;
    for (int64_t i = 0; i < scene->n; i++)
        for (int axis = 0; axis < 2 && ids[i] >= 0; axis++)
            moved[2 * ids[i] + axis] = scene->found[2 * i + axis] - scene->expected[2 * ids[i] + axis];
    smooth(scene, moved, common, work);
    for (int64_t i = 0; i < scene->n; i++) {
        int64_t j = ids[i];
        if (j >= 0 && squared_distance(moved + 2 * j, common + 2 * j) > square(s->displacement_tolerance * scene->pitch))
            ids[i] = -1, moved[2 * j] = moved[2 * j + 1] = NAN, wrong++;
    }
    return wrong;
}

static void match(const Scene *scene, const IdentitySettings *s, int64_t *ids, double *shift, double *moved, double *work,
                  int64_t *back, double *offsets) {
    int64_t m = scene->m, n = scene->n, fewest = n < m ? n : m, all = n > m ? n : m;
    memset(shift, 0, 2 * m * sizeof *shift);
    for (int round_ = 0; round_ <= ROUNDS; round_++) {
        if (round_ == 1) {
            double common[2];
            common_shift(scene, s->shift_resolution, common, offsets, work);
            for (int64_t j = 0; j < m; j++) shift[2 * j] = common[0], shift[2 * j + 1] = common[1];
        }
        mutual_nearest(scene, shift, s->gate * scene->pitch, ids, back, work);
        int64_t matched = 0, wrong = drop_inconsistent(scene, s, ids, moved, shift, work);
        for (int64_t i = 0; i < n; i++) matched += ids[i] >= 0;
        /* no common offset is needed if all are at their expected positions and none is left over:
           a whole grid cannot hide a shift */
        if (!wrong && matched == (round_ ? fewest : all)) break;
        if (wrong) smooth(scene, moved, shift, work);
    }
}

int64_t match_markers(int64_t n, int64_t m, int64_t k, const double *found, const double *expected, const double *layout,
                      const int64_t *order, double pitch, const double *settings, int64_t *ids) {
    IdentitySettings s;
    memcpy(&s, settings, sizeof s);
    for (int64_t i = 0; i < m * k; i++)
        if (order[i] < 0 || order[i] >= m) return REFUSED;
    double *own = calloc(8 * m + 2 * k + 3 * n + 1, sizeof *own), *shift = own + 2 * m, *moved = shift + 2 * m;
    double *work = moved + 2 * m, *offsets = work + 2 * m + 2 * k + n;
    int64_t *back = malloc((m + 1) * sizeof *back), places = 0;
    if (!own || !back) {
        free(own), free(back);
        return NO_MEMORY;
    }
    const int64_t neighbours = (int64_t)min_of(max_of(s.neighbours, 0), k);
    Scene scene = {n, m, k, neighbours, found, own, order, pitch};
    for (int64_t j = 0; j < m; j++)
        for (int axis = 0; axis < 2; axis++) moved[2 * j + axis] = expected[2 * j + axis] - layout[2 * j + axis];
    smooth(&scene, moved, shift, work);
    for (int64_t j = 0; j < m; j++)  /* a marker at an unknown position: from its neighbors */
        for (int axis = 0; axis < 2; axis++)
            own[2 * j + axis] = is_known(expected + 2 * j) ? expected[2 * j + axis] : layout[2 * j + axis] + shift[2 * j + axis];
    for (int64_t i = 0; i < n; i++) ids[i] = -1, places += is_known(found + 2 * i);
    if (places) match(&scene, &s, ids, shift, moved, work, back, offsets);
    free(own), free(back);
    return 0;
}

/* Return the coordinate along `axis`, frame S, of the circle at `p`, frame C, if it is `factor`
   times as large as assumed. Its distance from the intersection of its rays grows by that
   factor. */
static double scaled_coordinate(const double *p, int axis, double factor, double shift, const double *origin) {
    double apex = axis == 2 ? shift : 0;
    return (p[axis] - apex) * factor + apex + origin[axis];
}

int64_t name_circles(int64_t count, int64_t all, const int64_t *circles, const double *first, const double *first_n,
                     const double *second, const double *second_n, const double *cov, const double *factors,
                     const double *camera_, const double *origin, const double *slopes, double *p, double *normals,
                     double *cov_p) {
    for (int64_t i = 0; i < count; i++)
        if (circles[i] < 0 || circles[i] >= all) return REFUSED;
    Camera camera;
    int differ = 0;
    double *shifts = malloc((2 * count + 1) * sizeof *shifts), *heights = shifts + count;
    if (!shifts) return NO_MEMORY;
    memcpy(&camera, camera_, sizeof camera);
    for (int64_t i = 0; i < count; i++) differ |= factors[i] != 1;
    for (int64_t i = 0; i < count; i++) {
        const double *c = first + 3 * circles[i];
        double x, y;
        refract(&camera, c, &x, &y);
        shifts[i] = differ ? glass_displacement(&camera, x * x + y * y) : 0;
        heights[i] = scaled_coordinate(c, 2, factors[i], shifts[i], origin);
    }
    for (int64_t i = 0; i < count; i++, slopes += count) {
        const double *n = first_n + 3 * circles[i], *other = second_n + 3 * circles[i];
        double z_x = 0, z_y = 0;
        for (int64_t j = 0; j < count; j++) z_x += slopes[j] * heights[j], z_y += slopes[count * count + j] * heights[j];
        int swap = (other[0] - n[0]) * z_x + (other[1] - n[1]) * z_y - (other[2] - n[2]) > 0;
        const double *c = (swap ? second : first) + 3 * circles[i];
        for (int k = 0; k < 3; k++) {
            p[3 * i + k] = scaled_coordinate(c, k, factors[i], shifts[i], origin);
            normals[3 * i + k] = swap ? other[k] : n[k];
        }
        for (int k = 0; k < 9; k++) cov_p[9 * i + k] = cov[9 * circles[i] + k] * square(factors[i]);
    }
    free(shifts);
    return 0;
}
