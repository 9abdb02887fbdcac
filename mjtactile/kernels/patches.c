/* One contact patch on the grid of nodes and on the fine grid: sensing/touch/patches.py, Eq.
   F13. */
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "small_linalg.h"

/* Settings in the order of the dataclass PatchSettings, one number per field. */
typedef struct {
    double smoothing, separate_fraction, area_disc, area_power, area_pressure, area_blend, core_fraction, min_fraction;
} PatchSettings;

_Static_assert(sizeof(PatchSettings) == 8 * sizeof(double), "as in kernels.h");

/* Nodes (nx, ny), of which the inner ones carry forces, and `refine` cells of the fine grid
   (na, nb) per node spacing. */
typedef struct {
    int64_t nx, ny, refine, na, nb;
    const double *position; /* (3, na, nb), m */
    const int32_t *owner;   /* (na, nb): patch of each point; NULL: all belong to this one */
    int32_t number;
} Grid;

static int64_t fine_of(const Grid *g, int64_t i, int64_t j) { return (i * g->nb + j) * g->refine; }

static int is_owned(const Grid *g, int64_t fine) { return !g->owner || g->owner[fine] == g->number; }

/* Return the curved area of a point of the fine grid, m^2; zero on the frame. */
static double cell(const Grid *g, int64_t at) {
    int64_t a = at / g->nb, b = at % g->nb, all = g->na * g->nb;
    if (a == 0 || b == 0 || a == g->na - 1 || b == g->nb - 1) return 0;
    double along[3], across[3];
    for (int64_t k = 0; k < 3; k++) {
        const double *p = g->position + k * all + at;
        along[k] = p[g->nb] - p[-g->nb], across[k] = p[1] - p[-1];
    }
    double aa = 0, ab = 0, bb = 0;
    for (int k = 0; k < 3; k++) aa += square(along[k]), ab += along[k] * across[k], bb += square(across[k]);
    return sqrt(max_of(aa * bb - ab * ab, 0)) / 4;
}

/* Estimate the area of a patch that carries `force`, N, over a chamber at `gauge`, Pa. It combines
   an estimate from the force with one from the second moment of nodal pressures. That moment is at
   least the extent of one node. */
static double area_of(const Grid *g, const double *pressing, const double *node_area, double core, double force, double gauge,
                      double node_variance, const PatchSettings *s) {
    int64_t inner = g->ny - 2, all = g->na * g->nb;
    double total = 0, mean[2] = {0, 0}, variance = 0;
    for (int round = 0; round < 2; round++)
        for (int64_t i = 1; i < g->nx - 1; i++)
            for (int64_t j = 1; j < g->ny - 1; j++) {
                int64_t node = (i - 1) * inner + j - 1, at = fine_of(g, i, j);
                double fraction = max_of(pressing[node] - core, 0) * node_area[node];
                if (fraction <= 0 || !is_owned(g, at)) continue;
                double x = g->position[at], y = g->position[all + at];
                if (round == 0) total += fraction, mean[0] += fraction * x, mean[1] += fraction * y;
                else variance += fraction * (square(x - mean[0] / total) + square(y - mean[1] / total)) / total;
            }
    double disc = 4 * PI * max_of(variance / 2, node_variance), seen = s->area_disc * pow(disc / s->area_disc, s->area_power);
    double carrying = force / (max_of(gauge, 0) + s->area_pressure);
    return pow(pow(seen, -s->area_blend) + pow(carrying, -s->area_blend), -1 / s->area_blend);
}

static void sift_down(const double *field, int64_t *heap, int64_t count, int64_t at) {
    for (int64_t child; (child = 2 * at + 1) < count; at = child) {
        if (child + 1 < count && field[heap[child + 1]] > field[heap[child]]) child++;
        if (field[heap[at]] >= field[heap[child]]) return;
        int64_t swap = heap[at];
        heap[at] = heap[child], heap[child] = swap;
    }
}

/* Mark the cells of the strongest field in `inside`, as many as fill `area`, at least one; return
   their number. The n-th of them is `heap[*positive - 1 - n]`. */
static int64_t mark_strongest(const Grid *g, const double *field, double area, int64_t *heap, int64_t *positive, uint8_t *inside) {
    int64_t all = g->na * g->nb, count = 0, taken = 0;
    for (int64_t at = 0; at < all; at++)
        if (field[at] > 0 && is_owned(g, at)) heap[count++] = at;
    *positive = count;
    for (int64_t at = count / 2; at-- > 0;) sift_down(field, heap, count, at);
    double filled = 0;
    while (count) {
        int64_t top = heap[0];
        filled += cell(g, top);
        if (taken && filled >= area) break;
        heap[0] = heap[--count], heap[count] = top;
        sift_down(field, heap, count, 0);
        inside[top] = 1, taken++;
    }
    return taken;
}

/* Compute the area of the strongest cells, and the semi-axes and first angle from their
   area-weighted second moments about their mean. */
static void axes_of_cells(const Grid *g, const int64_t *places, int64_t count, double *found) {
    double total = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
    int64_t all = g->na * g->nb;
    for (int64_t k = 0; k < count; k++) {
        double fraction = cell(g, places[k]);
        total += fraction, x += fraction * g->position[places[k]], y += fraction * g->position[all + places[k]];
    }
    for (int64_t k = 0; k < count && count > 2; k++) {
        double fraction = cell(g, places[k]) / total, dx = g->position[places[k]] - x / total;
        double dy = g->position[all + places[k]] - y / total;
        xx += fraction * dx * dx, xy += fraction * dx * dy, yy += fraction * dy * dy;
    }
    double mean = (xx + yy) / 2, half = hypot((xx - yy) / 2, xy);
    found[0] = total, found[1] = 2 * sqrt(mean + half), found[2] = 2 * sqrt(max_of(mean - half, 0));
    found[3] = 0.5 * atan2(2 * xy, xx - yy);
}

int64_t measure_patch(int64_t nx, int64_t ny, int64_t refine, int64_t na, int64_t nb, const double *fine, const double *position,
                      const int32_t *owner, int64_t number, const double *traction, const double *node_area, const double *sunk, double gauge,
                      double node_variance, const double *settings, uint8_t *inside, uint8_t *mask, double *found) {
    if (nx < 3 || ny < 3 || refine < 1 || na != refine * (nx - 1) + 1 || nb != refine * (ny - 1) + 1) return REFUSED;
    Grid g = {nx, ny, refine, na, nb, position, owner, (int32_t)number};
    PatchSettings s;
    memcpy(&s, settings, sizeof s);
    int64_t inner = ny - 2, nodes = (nx - 2) * inner, all = g.na * g.nb, positive;
    double force[3] = {0, 0, 0}, total = 0, peak = 0, strongest_node = 0;
    int64_t *heap = malloc(all * sizeof *heap);
    double *pressing = malloc(nodes * sizeof *pressing);
    if (!heap || !pressing) {
        free(heap), free(pressing);
        return NO_MEMORY;
    }
    for (int64_t node = 0; node < nodes; node++) {
        int64_t at = fine_of(&g, node / inner + 1, node % inner + 1);
        pressing[node] = max_of(-traction[2 * nodes + node], 0);
        strongest_node = max_of(strongest_node, pressing[node]), total -= traction[2 * nodes + node] * node_area[node];
        if (is_owned(&g, at))
            for (int k = 0; k < 3; k++) force[k] += traction[k * nodes + node] * node_area[node];
    }
    int counts = -force[2] >= s.min_fraction * max_of(total, 1e-9);
    if (counts) {
        double area = area_of(&g, pressing, node_area, s.core_fraction * strongest_node, -force[2], gauge, node_variance, &s);
        int64_t count = mark_strongest(&g, fine, area, heap, &positive, inside);
        double weights = 0, x = 0, y = 0, deep = 0, deepest = 0;
        for (int64_t at = 0; at < all; at++) peak = max_of(peak, fine[at]);
        for (int64_t at = 0; at < all; at++) {
            double weight = fine[at] - s.core_fraction * peak;
            if (weight <= 0 || !is_owned(&g, at)) continue;
            weights += weight, x += weight * position[at], y += weight * position[all + at];
        }
        int any = 0;
        for (int64_t i = 0; i < nx; i++)
            for (int64_t j = 0; j < ny; j++) {
                int64_t at = fine_of(&g, i, j);
                int border = i == 0 || j == 0 || i == nx - 1 || j == ny - 1, here = is_owned(&g, at) && inside[at];
                double sink = border ? 0 : sunk[(i - 1) * inner + j - 1];
                mask[j * nx + i] = (uint8_t)here, any |= here;
                if (here) deep = max_of(deep, sink);
                if (is_owned(&g, at)) deepest = max_of(deepest, sink);
            }
        memcpy(found, force, sizeof force);
        found[3] = x / weights, found[4] = y / weights, found[5] = any ? deep : deepest;
        axes_of_cells(&g, heap + positive - count, count, found + 6);
    }
    free(heap), free(pressing);
    return counts;
}
