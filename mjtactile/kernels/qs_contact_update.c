/* Obstacles at a membrane's nodes, and contact loads of a membrane in equilibrium on them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "qs_lowest_obstacle.h"
#include "qs_workspace.h"
#include "small_linalg.h"

/* factor on curvature times spacing^2: excess height of a smooth obstacle on the grid */
#define CORRECTION (1 / 24.)
#define THIN 5 /* points sampled on each side of a node for obstacles thinner than the spacing */
#define LEAN_OVER 0.3      /* distance for the inclination of a thin obstacle, spacings */
#define HALF_A_CELL 0.55    /* limit of half a cell, spacings: nodes have moved apart */
#define NEAREST_EDGE 0.95   /* maximum distance of an edge from its node, spacings */
#define BEHIND 0.35         /* height of another obstacle above a face, spacings, from which on the face ends */
#define SAME 1e-9           /* tolerance for equal heights, m */
#define STRAIGHT 1e-12      /* tolerance for three points on a line, m */
/* height difference above which the lowest point is certainly at the end, m */
#define SLOPING (30 * SAME)
#define NEARBY 5e-4 /* distance above the membrane, m: more than its motion until equilibrium */
/* margin around the contact, nodes: for the height correction and for edges next to it */
#define ROUND_ABOUT 1

long qs_contact_size(const Membrane *f) {
    return (1 + 1 + 2 + 1 + 1 + 2 + 4 + 4 + 1 + 1 + 1) * f->count + 2 * (f->count / 8) + QS_FLOORS * QS_PLANES;
}

ContactNodes qs_last_contact(const Membrane *f, double **room) {
    const long n = f->count;
    ContactNodes s = {.floors = -1};
    s.obstacle = qs_take(room, n), s.level = qs_take(room, n), s.slope = qs_take(room, 2 * n), s.lower = qs_take(room, n);
    s.owner = qs_take(room, n);
    s.away = qs_take(room, 2 * n), s.edge = qs_take(room, 4 * n), s.spring = qs_take(room, 4 * n);
    s.along_x = qs_take(room, n), s.along_y = qs_take(room, n), s.cell = qs_take(room, n);
    s.planes = qs_take(room, QS_FLOORS * QS_PLANES);
    /* lines are multiples of eight */
    s.touching = (uint8_t *)qs_take(room, n / 8), s.requested = (uint8_t *)qs_take(room, n / 8);
    return s;
}

ContactNodes qs_contact_in(const Membrane *f, double **room) {
    const long n = f->count;
    ContactNodes s = qs_last_contact(f, room);
    memset(s.slope, 0, 2 * n * sizeof *s.slope), memset(s.along_x, 0, 2 * n * sizeof *s.along_x), memset(s.touching, 0, n);
    return s;
}

void qs_pad(const Membrane *f, long fields, const double *from, double *to) {
    memset(to, 0, fields * f->count * sizeof *to);
    for (long i = 0; i < fields * f->columns; i++) memcpy(to + i * f->line, from + i * f->rows, f->rows * sizeof *to);
}

void qs_unpad(const Membrane *f, long fields, const double *from, double *to) {
    for (long i = 0; i < fields * f->columns; i++) memcpy(to + i * f->rows, from + i * f->line, f->rows * sizeof *to);
}

/* -- obstacles --------------------------------------------------------------------------------- */

static int has_thin_obstacle(const Membrane *f, const Bodies *bodies) {
    for (long b = 0; b < bodies->count; b++)
        if (qs_obstacle_at(bodies, b)->min_width < max_of(f->dx, f->dy)) return 1;
    return 0;
}

/* Measure the extent of an obstacle along an axis from a point on it, below and above, up to one
   spacing. `parts` counts fractions of the spacing. */
static void reaches_along(const Membrane *f, const Bodies *bodies, double x, double y, int axis, int parts[2]) {
    const double step[2] = {axis ? 0 : f->dx / (2. * THIN + 1), axis ? f->dy / (2. * THIN + 1) : 0};
    double height, slope[2];
    for (int end = 0; end < 2; end++) {
        const int side = end ? 1 : -1;
        for (parts[end] = 0; parts[end] <= 2 * THIN; parts[end]++) {
            const int next = side * (parts[end] + 1);
            if (lowest(f, bodies, x + next * step[0], y + next * step[1], &height, slope)) break;
        }
    }
}

/* Move an obstacle that is thinner than the spacing and passes between nodes under the nearest
   node. Its height is that of the lowest point on the cross of the node's cell, along the axis
   across which it is thin. The end of an obstacle that continues to the next node is an edge.
   Returns the axis along which it was found, 1 or 2, or 0. `taken`: axes along which the previous
   node already has it. `away`: offset of its center, spacings. */
static int evaluate_between_nodes(const Membrane *f, const Bodies *bodies, double x, double y, int taken, double *height, double slope[2],
                                  double *away) {
    int found = 0;
    for (int axis = 0; axis < 2; axis++) {
        if (taken & (1 << axis)) continue;
        double low = *height, by[2] = {0, 0}, at, low_by[2] = {0, 0}, where = 0;
        for (int part = -THIN - 1; part <= THIN + 1; part++) {
            const double off = part / (2. * THIN + 1);
            if (lowest(f, bodies, x + (axis ? 0 : off * f->dx), y + (axis ? off * f->dy : 0), &at, by)) continue;
            if (at < low) low = at, low_by[0] = by[0], low_by[1] = by[1], where = off;
        }
        if (!(low < *height)) continue;
        const double at_low[2] = {x + (axis ? 0 : where * f->dx), y + (axis ? where * f->dy : 0)};
        int across[2], along[2];
        reaches_along(f, bodies, at_low[0], at_low[1], axis, across);
        const double middle = where + (across[1] - across[0]) / 2. / (2 * THIN + 1);
        if (fabs(middle) > HALF_A_CELL) continue;
        reaches_along(f, bodies, x + (axis ? 0 : middle * f->dx), y + (axis ? middle * f->dy : 0), !axis, along);
        if (across[0] + across[1] > along[0] + along[1]) continue;
        *height = low, slope[0] = low_by[0], slope[1] = low_by[1], found = 1 << axis, *away = middle;
    }
    return found;
}

/* Return 1 if there is only one obstacle and its lower side bends in one direction only. */
static int is_single_convex(const Bodies *bodies) {
    if (bodies->count != 1) return 0;
    const int kind = (int)qs_obstacle_at(bodies, 0)->kind;
    return kind != BODY_TRIANGLES && kind != BODY_HEIGHTS;
}

/* Return 1 if a convex obstacle is a plane that slopes along an axis, across all points that
   evaluate_ridge samples. This holds if three of them are on a line. */
static int slopes_evenly(const Membrane *f, const Bodies *bodies, double x, double y, int axis) {
    double at[3], by[2];
    const double wide = (THIN + 2) / (2. * THIN + 1) * (axis ? f->dy : f->dx);
    for (int k = 0; k < 3; k++)
        if (lowest(f, bodies, x + (axis ? 0 : (k - 1) * wide), y + (axis ? (k - 1) * wide : 0), at + k, by)) return 0;
    return fabs(at[0] + at[2] - 2 * at[1]) < STRAIGHT && fabs(at[2] - at[0]) > SLOPING;
}

/* Find a ridge or a tip that passes through a node's cell next to the node. The membrane meets it
   there, with zero slope across it. Returns the axes. */
static int evaluate_ridge(const Membrane *f, const Bodies *bodies, double x, double y, int taken, double *height, double slope[2]) {
    const int convex = is_single_convex(bodies);
    int found = 0;
    for (int axis = 0; axis < 2; axis++) {
        double low = INFINITY, by[2] = {0, 0}, at;
        int where = 0;
        if (taken & (1 << axis) || (convex && slopes_evenly(f, bodies, x, y, axis))) continue;
        /* cells overlap: nodes have moved apart */
        for (int part = -THIN - 2; part <= THIN + 2; part++) {
            const double off = part / (2. * THIN + 1);
            if (lowest(f, bodies, x + (axis ? 0 : off * f->dx), y + (axis ? off * f->dy : 0), &at, by)) continue;
            if (at < low - SAME || (at < low + SAME && abs(part) < abs(where))) low = at, where = part;
        }
        if (isinf(low) || abs(where) > THIN + 1) continue;
        *height = min_of(*height, low), slope[axis] = 0, found |= 1 << axis;
    }
    return found;
}

void mark_contact(const Membrane *f, const double *force, ContactNodes *seen) {
    long *box = seen->box;
    box[0] = f->columns, box[1] = 0, box[2] = f->rows, box[3] = 0;
    for (long i = 0; i < f->columns; i++)
        for (long j = 0; j < f->rows; j++) {
            const int touches = force[i * f->line + j] != 0;
            seen->touching[i * f->line + j] = (uint8_t)touches;
            if (!touches) continue;
            box[0] = i < box[0] ? i : box[0], box[1] = i + 1 > box[1] ? i + 1 : box[1];
            box[2] = j < box[2] ? j : box[2], box[3] = j + 1 > box[3] ? j + 1 : box[3];
        }
}

/* Extend the box to all nodes that may be under an obstacle, for any position between their
   neighbors. */
static void grow_box(const Membrane *f, const Obstacle *b, long box[4]) {
    const double reach = b->reach + f->numbers.half_thickness, sides[2] = {f->numbers.length_x, f->numbers.length_y}, by[2] = {f->dx, f->dy};
    const long counts[2] = {f->columns, f->rows};
    for (int c = 0; c < 2; c++) {
        const double middle = (b->p[c] + sides[c] / 2) / by[c], wide = reach / by[c];
        const long from = (long)clip(floor(middle - wide) - 1, 0, counts[c]), to = (long)clip(ceil(middle + wide) + 2, 0, counts[c]);
        box[2 * c] = from < box[2 * c] ? from : box[2 * c], box[2 * c + 1] = to > box[2 * c + 1] ? to : box[2 * c + 1];
    }
}

/* Remove an obstacle that was moved under a node if the next node in its direction has it: this is
   its end. */
static void remove_ends(const Membrane *f, ContactNodes *seen) {
    for (long i = seen->box[0]; i < seen->box[1]; i++)
        for (long j = seen->box[2]; j < seen->box[3]; j++) {
            const long k = i * f->line + j;
            const int axis = seen->away[k] != 0 ? 0 : 1;
            const double away = seen->away[axis * f->count + k];
            if (away == 0) continue;
            const long next = k + qs_next(f, 2 * axis + (away < 0));
            if (next < 0 || next >= f->count || isinf(seen->obstacle[next]) || seen->away[axis * f->count + next] != 0) continue;
            seen->obstacle[k] = seen->level[k] = INFINITY, seen->edge[k] = 0, seen->away[axis * f->count + k] = 0;
        }
}

static void clear_obstacles(const Membrane *f, ContactNodes *seen) {
    memset(seen->edge, 0, f->count * sizeof *seen->edge);
    for (long k = 0; k < f->count; k++) seen->obstacle[k] = seen->level[k] = INFINITY;
}

void limit_to_contact(const Membrane *f, const Bodies *bodies, ContactNodes *seen) {
    const long ends[4] = {0, f->columns, 0, f->rows};
    /* a sharp obstacle is also thin */
    if (has_thin_obstacle(f, bodies) || seen->box[0] >= seen->box[1]) return;
    for (int k = 0; k < 4; k += 2) {
        seen->box[k] = (long)max_of(seen->box[k] - ROUND_ABOUT, ends[k]);
        seen->box[k + 1] = (long)min_of(seen->box[k + 1] + ROUND_ABOUT, ends[k + 1]);
    }
    clear_obstacles(f, seen);
    seen->narrow = 1;
}

/* Compute the in-plane positions of the nodes of line `i` in the box. */
static void place_nodes(const Membrane *f, const double *x, const ContactNodes *seen, long i, double *at_x, double *at_y) {
    for (long j = seen->box[2]; j < seen->box[3]; j++) {
        at_x[j] = (double)i * f->dx - f->numbers.length_x / 2 + x[i * f->line + j];
        at_y[j] = (double)j * f->dy - f->numbers.length_y / 2 + x[f->count + i * f->line + j];
    }
}

/* Mark the nodes at which obstacles are evaluated: nodes in contact, nodes that may soon be, and
   their neighbors, for curvature and edges. */
static void request_nodes(const Membrane *f, const double *x, ContactNodes *seen) {
    double at_x[QS_MAX_LINE], at_y[QS_MAX_LINE], floor[QS_MAX_LINE];
    const double *z = x + 2 * f->count;
    memset(seen->requested, 0, f->count);
    for (long i = seen->box[0]; i < seen->box[1]; i++) {
        place_nodes(f, x, seen, i, at_x, at_y);
        lower_bound_at(seen, seen->box[3] - seen->box[2], at_x + seen->box[2], at_y + seen->box[2], floor + seen->box[2]);
        for (long j = seen->box[2]; j < seen->box[3]; j++) {
            if (!seen->touching[i * f->line + j] && floor[j] > z[i * f->line + j] + NEARBY) continue;
            const long from = j > 0 ? j - 1 : 0, to = j < f->rows - 1 ? j + 1 : j;
            for (long near = i > 0 ? i - 1 : 0; near <= i + 1 && near < f->columns; near++)
                memset(seen->requested + near * f->line + from, 1, to - from + 1);
        }
    }
}

/* Compute the heights of all obstacles at the present positions of the nodes. */
void evaluate_obstacles(const Membrane *f, const Bodies *bodies, const double *x, ContactNodes *seen) {
    const int thin = has_thin_obstacle(f, bodies);
    int sharp = 0;
    for (long b = 0; b < bodies->count; b++) sharp |= qs_obstacle_at(bodies, b)->min_width == 0;
    for (long b = 0; b < bodies->count && !seen->narrow; b++) grow_box(f, qs_obstacle_at(bodies, b), seen->box);
    if (!seen->narrow) clear_obstacles(f, seen);
    const int all = thin || seen->floors < 0; /* thin obstacles may be between nodes */
    if (!all) request_nodes(f, x, seen);
    for (long i = seen->box[0]; i < seen->box[1]; i++)
        for (long j = seen->box[2]; j < seen->box[3]; j++) {
            const long k = i * f->line + j;
            if (!all && !seen->requested[k]) continue;
            const double at_x = i * f->dx - f->numbers.length_x / 2 + x[k];
            const double at_y = j * f->dy - f->numbers.length_y / 2 + x[f->count + k];
            double slope[2] = {0, 0};
            int axis = 0; /* stored in `edge`, which is computed later */
            double away = 0;
            const long owner = lowest_of(f, bodies, at_x, at_y, seen->obstacle + k, slope);
            const int off_all = owner < 0;
            seen->owner[k] = (double)owner;
            const int taken = (i && ((int)seen->edge[k - f->line] & 1)) | (j && ((int)seen->edge[k - 1] & 2)) << 1;
            if (off_all && thin) axis = evaluate_between_nodes(f, bodies, at_x, at_y, taken, seen->obstacle + k, slope, &away);
            seen->away[k] = axis == 1 ? away * f->dx : 0, seen->away[f->count + k] = axis == 2 ? away * f->dy : 0;
            if (!off_all && sharp) axis = evaluate_ridge(f, bodies, at_x, at_y, taken, seen->obstacle + k, slope);
            seen->edge[k] = axis;
            seen->slope[k] = slope[0], seen->slope[f->count + k] = slope[1];
            if (isinf(seen->obstacle[k])) {
                seen->level[k] = INFINITY;
                continue;
            }
            seen->level[k] = seen->obstacle[k] - seen->slope[k] * x[k] - seen->slope[f->count + k] * x[f->count + k];
        }
    if (thin) remove_ends(f, seen);
}

static int is_over_obstacle(const Membrane *f, const Bodies *bodies, double x, double y) {
    double height, slope[2];
    return !lowest(f, bodies, x, y, &height, slope);
}

/* Return the inclination of a thin obstacle: its drift across an axis per distance along it,
   spacings per spacing. */
static double inclination_of(const Membrane *f, const Bodies *bodies, const double at[2], int axis) {
    const double spacing[2] = {f->dx, f->dy};
    double lean = 0, ends = 0;
    int across[2];
    reaches_along(f, bodies, at[0], at[1], !axis, across);
    if (across[0] + across[1] > 2 * THIN) return 0; /* the obstacle is wide here */
    for (int side = -1; side <= 1; side += 2) {
        double sum = 0, hits = 0, place[2];
        place[axis] = at[axis] + side * LEAN_OVER * spacing[axis];
        for (int part = -THIN; part <= THIN; part++) {
            place[!axis] = at[!axis] + part * spacing[!axis] / (2 * THIN + 1);
            if (is_over_obstacle(f, bodies, place[0], place[1])) sum += part / (2. * THIN + 1), hits += 1;
        }
        if (hits > 0) lean += side * sum / hits / LEAN_OVER, ends += 1;
    }
    return ends > 0 ? lean / ends : 0;
}

/* Return 1 if an obstacle `owner` of a `height` is next to node `k` at a distance `along` x or y of
   its obstacle. A wall behind an edge is not: another obstacle far above the extended face. */
static int is_next(const Membrane *f, const ContactNodes *seen, long k, long owner, double height, const double along[2]) {
    if (seen->owner[k] < 0 || owner == (long)seen->owner[k]) return 1;
    const double face = seen->obstacle[k] + seen->slope[k] * along[0] + seen->slope[f->count + k] * along[1];
    return height - face <= BEHIND * max_of(f->dx, f->dy);
}

/* Return 1 if the obstacle at a node continues to its neighbor at a side. */
static int continues(const Membrane *f, const ContactNodes *seen, long k, int side) {
    const long other = k + qs_next(f, side);
    const double along[2] = {side < 2 ? (side ? -f->dx : f->dx) : 0, side < 2 ? 0 : (side == 3 ? -f->dy : f->dy)};
    const long owner = (long)seen->owner[other];
    return isfinite(seen->obstacle[other]) && (owner < 0 || is_next(f, seen, k, owner, seen->obstacle[other], along));
}

/* Return 1 if the obstacle at node `k` continues to a fraction of the `way` from `at`. */
static int continues_to(const Membrane *f, const Bodies *bodies, const ContactNodes *seen, long k, const double at[2], double fraction,
                        const double way[2]) {
    const double along[2] = {fraction * way[0], fraction * way[1]};
    double height, slope[2];
    const long owner = lowest_of(f, bodies, at[0] + along[0], at[1] + along[1], &height, slope);
    return owner >= 0 && is_next(f, seen, k, owner, height, along);
}

/* Find the edges of obstacles between a node on an obstacle and its neighbors at +x, -x, +y and -y
   that are not: the fraction of the distance. It is negative if both are on an obstacle. */
void find_edges(const Membrane *f, const Bodies *bodies, const double *x, long k, int halves, ContactNodes *seen) {
    const long count = f->count, i = k / f->line, j = k % f->line;
    const double at[2] = {i * f->dx - f->numbers.length_x / 2 + x[k] + seen->away[k],
                          j * f->dy - f->numbers.length_y / 2 + x[count + k] + seen->away[count + k]};
    const int thin = has_thin_obstacle(f, bodies);
    for (int side = 0; side < 4; side++) {
        const long other = k + qs_next(f, side);
        seen->edge[side * count + k] = -1;
        if (continues(f, seen, k, side) || !is_over_obstacle(f, bodies, at[0], at[1])) continue;
        double way[2] = {side < 2 ? (side ? -1 : 1) * f->dx + x[other] - x[k] : 0,
                               side < 2 ? 0 : (side == 3 ? -1 : 1) * f->dy + x[count + other] - x[count + k]};
        if (thin) way[side < 2] += inclination_of(f, bodies, at, side >= 2) * (side % 2 ? -1 : 1) * (side < 2 ? f->dy : f->dx);
        /* the obstacle continues under the next line of nodes */
        if (thin && continues_to(f, bodies, seen, k, at, 1, way)) continue;
        double low = 0, high = 1;
        for (int half = 0; half < halves; half++) {
            const double middle = (low + high) / 2;
            if (continues_to(f, bodies, seen, k, at, middle, way)) low = middle;
            else high = middle;
        }
        seen->edge[side * count + k] = low;
    }
    /* an obstacle between nodes on both sides is centered about its own node */
    for (int axis = 0; axis < 2; axis++) {
        double *one = seen->edge + 2 * axis * count + k, *other = one + count;
        if (*one >= 0 && *other >= 0) *one = *other = (*one + *other) / 2;
    }
}

double height_over_edge(const Membrane *f, const ContactNodes *seen, const double *z, long k, int side) {
    const double along = side < 2 ? seen->slope[k] * f->dx : seen->slope[f->count + k] * f->dy;
    return z[k + qs_next(f, side)] - z[k] - (side % 2 ? -along : along);
}

/* Compute the edge springs. The membrane bends over an edge a fraction s of the spacing beyond the
   last node on the obstacle. It rises to the next node over the remaining 1 - s and pulls more by
   that ratio. The spring acts in addition to the membrane. */
double find_springs(const Membrane *f, const double *z, ContactNodes *seen) {
    double which = 0;
    memset(seen->spring, 0, 4 * f->count * sizeof *seen->spring);
    for (long k = seen->box[0] * f->line; k < seen->box[1] * f->line; k++) {
        if (!seen->touching[k]) continue;
        const double links[4] = {seen->along_x[k], seen->along_x[k - f->line], seen->along_y[k], seen->along_y[k - 1]};
        for (int side = 0; side < 4; side++) {
            const double fraction = min_of(seen->edge[side * f->count + k], NEAREST_EDGE);
            /* the membrane leaves the face before the edge */
            if (fraction <= 0 || height_over_edge(f, seen, z, k, side) <= 0) continue;
            seen->spring[side * f->count + k] = max_of(links[side], 0) * fraction / (1 - fraction);
            which += 4. * k + side;
        }
    }
    return which;
}

/* Compute the obstacle heights from the last slopes. `level` is a height minus the contribution of
   its slopes. */
void extrapolate_obstacles(const Membrane *f, const double *x, ContactNodes *seen) {
    for (long k = seen->box[0] * f->line; k < seen->box[1] * f->line; k++)
        seen->obstacle[k] = seen->level[k] + seen->slope[k] * x[k] + seen->slope[f->count + k] * x[f->count + k];
}

/* Compute the height correction for round obstacles. A membrane that bends only at its nodes is
   held off a round obstacle, and the excess is subtracted. Next to an obstacle's end, its curvature
   is unknown. */
void correct_round_obstacles(const Membrane *f, ContactNodes *seen) {
    const double *h = seen->obstacle;
    const long rows = f->line;
    memset(seen->lower, 0, f->count * sizeof *seen->lower);
    for (long i = max_of(seen->box[0], 1); i < min_of(seen->box[1], f->columns - 1); i++)
        for (long j = max_of(seen->box[2], 1); j < min_of(seen->box[3], f->rows - 1); j++) {
            const long k = i * rows + j;
            if (!isfinite(h[k])) continue;
            double bend = 0;
            if (continues(f, seen, k, 0) && continues(f, seen, k, 1)) bend += h[k - rows] + h[k + rows] - 2 * h[k];
            if (continues(f, seen, k, 2) && continues(f, seen, k, 3)) bend += h[k - 1] + h[k + 1] - 2 * h[k];
            const double steep = 1 + square(seen->slope[k]) + square(seen->slope[f->count + k]);
            /* surface curvature: independent of the slope */
            seen->lower[k] = CORRECTION * max_of(bend, 0) / (steep * sqrt(steep));
        }
}

static int is_rim(const Membrane *f, long i, long j) {
    return f->inside ? f->inside[i * f->rows + j] == 0 : i == 0 || j == 0 || i == f->columns - 1 || j == f->rows - 1;
}

int check_rim_contact(const Membrane *f, const Settings *set, const ContactNodes *seen) {
    const double *h = seen->obstacle;
    for (long i = seen->box[0]; i < seen->box[1]; i++)
        for (long j = seen->box[2]; j < seen->box[3]; j++) {
            const long k = i * f->line + j;
            if (is_rim(f, i, j) && h[k] < -set->below_rim) return RIM_CONTACT;
            if (h[k] - f->numbers.half_thickness <= -f->numbers.depth) return GLASS_CONTACT;
        }
    return CONVERGED;
}

void evaluate_gas(const Membrane *f, const Settings *set, double bulge, double *pressure, double *stiffness) {
    *pressure = set->gas, *stiffness = 0;
    if (!set->sealed) return;
    const double volume = f->numbers.chamber_flat + bulge, absolute = set->gas / pow(volume, f->numbers.polytropic_exponent);
    *pressure = absolute - f->numbers.ambient, *stiffness = f->numbers.polytropic_exponent * absolute / volume;
}

/* Compute the wrench about the origin of S and the contact area. Each node contributes its cell
   times the ratio of its force to the force of full contact. */
void sum_contact(const Membrane *f, const double *x, const double *force, double *found, const ContactNodes *seen) {
    const double *h = seen->obstacle;
    const long rows = f->line;
    for (int k = FORCE_X; k <= TORQUE_Z; k++) found[k] = 0;
    found[AREA] = 0;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * rows + j;
            if (!(force[k] > 0)) continue;
            const double r[3] = {i * f->dx - f->numbers.length_x / 2 + x[k], j * f->dy - f->numbers.length_y / 2 + x[f->count + k],
                                 x[2 * f->count + k]};
            const double slope[2] = {seen->slope[k], seen->slope[f->count + k]};
            const double F[3] = {force[k] * slope[0], force[k] * slope[1], -force[k]};
            for (int c = 0; c < 3; c++) {
                found[FORCE_X + c] += F[c];
                found[TORQUE_X + c] += r[(c + 1) % 3] * F[(c + 2) % 3] - r[(c + 2) % 3] * F[(c + 1) % 3];
            }
            const double cell = seen->cell[k];
            double fraction;
            if (continues(f, seen, k, 0) && continues(f, seen, k, 1) && continues(f, seen, k, 2) && continues(f, seen, k, 3)) {
                const double bend = (h[k - rows] + h[k + rows] - 2 * h[k]) / square(f->dx) + (h[k - 1] + h[k + 1] - 2 * h[k]) / square(f->dy);
                const double steep = 1 + slope[0] * slope[0] + slope[1] * slope[1];
                const double face_force = cell * (found[PRESSURE] + found[TENSION] * bend / (steep * sqrt(steep)));
                fraction = face_force > 0 ? min_of(force[k] / face_force, 1) : 1;
            } else {
                double wide[4];
                for (int side = 0; side < 4; side++) wide[side] = seen->edge[side * f->count + k] >= 0 ? seen->edge[side * f->count + k] : 0.5;
                /* up to the edges, because there are no nodes beyond */
                fraction = (wide[0] + wide[1]) * (wide[2] + wide[3]);
            }
            found[AREA] += fraction * cell * sqrt(1 + slope[0] * slope[0] + slope[1] * slope[1]);
        }
}

