/* Response of a membrane in equilibrium to small changes of its obstacles, by the implicit function
   theorem: nodes in contact stay in contact, and the residuals stay zero. The tangent is that of
   membrane and gas, with the heights in contact eliminated by the obstacles' slopes. It is factored
   once. Residuals depend on the obstacles by differences near the contact, which need no solution.
   A second sweep adds the terms that the tangent omits: corrections and edges that move with the
   nodes. */
#include <math.h>
#include <string.h>

#include "qs_tangent.h"
#include "kernels.h"

#define AT_ONCE (LANES - 1) /* changes that are solved together; the last lane is that of the gas */
#define SWEEPS 2
#define SWEEPS_AT_EDGES 3
/* bisections of an edge: more accurate than a difference of 1e-6 m resolves */
#define FINE_HALVES 36
/* distance from an obstacle, m, at which a membrane is not in equilibrium on it */
#define ELSEWHERE 1e-4
/* factor on this distance behind a thin obstacle, which is moved under nodes */
#define MAX_BEHIND 10

int64_t qs_sensitivities_size(const double *numbers) {
    const Membrane f = qs_membrane(numbers, 0);
    return qs_tangent_size(&f);
}

/* -- obstacles --------------------------------------------------------------------------------- */

/* Compute the effect of the obstacles on nodes (4, count), on the lines near them: forces, and
   distance of nodes in contact from their obstacle. Returns the force on nodes without an
   obstacle. */
static double obstacle_effects(const Membrane *f, const Bodies *bodies, const double *x, const double *force, Tangent *t, double *out) {
    ContactNodes *w = &t->seen;
    const long count = f->count;
    double missed = 0;
    evaluate_obstacles(f, bodies, x, w);
    for (long k = w->box[0] * f->line; k < w->box[1] * f->line; k++) {
        if (!w->touching[k]) continue;
        find_edges(f, bodies, x, k, FINE_HALVES, w);
        if (isfinite(w->obstacle[k])) continue; /* otherwise the node is exactly on the edge */
        missed += force[k];
        w->obstacle[k] = t->obstacle[k], w->slope[k] = t->slope[k], w->slope[count + k] = t->slope[count + k];
    }
    correct_round_obstacles(f, w);
    find_springs(f, x + 2 * count, w);
    const long from = first_line(f, w) * f->line, to = behind_lines(f, w) * f->line;
    for (int c = 0; c < 4 && from < to; c++) memset(out + c * count + from, 0, (to - from) * sizeof *out);
    for (long k = from; k < to; k++) {
        if (!w->touching[k]) continue;
        out[k] -= force[k] * w->slope[k], out[count + k] -= force[k] * w->slope[count + k], out[2 * count + k] += force[k];
        out[3 * count + k] = x[2 * count + k] - w->obstacle[k] + w->lower[k];
        for (int side = 0; side < 4; side++) {
            if (w->spring[side * count + k] == 0) continue;
            const double pull = w->spring[side * count + k] * height_over_edge(f, w, x + 2 * count, k, side);
            out[2 * count + k] -= pull, out[2 * count + k + qs_next(f, side)] += pull;
        }
    }
    return missed;
}

/* Return 1 if the obstacles do not match the equilibrium: away from the nodes that carry its force,
   or behind it. */
static int is_inconsistent(const Membrane *f, const double *x, const double *force, double missed, const Tangent *t) {
    const double *z = x + 2 * f->count;
    double total = 0, off = ELSEWHERE * missed, deepest = 0;
    for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++) {
        total += force[k], off += force[k] * fabs(t->base[3 * f->count + k]) / 2;
        deepest = max_of(deepest, z[k] - t->seen.obstacle[k]);
    }
    return off > ELSEWHERE / 2 * total || deepest > (total > 0 ? MAX_BEHIND : 1) * ELSEWHERE;
}

/* Move the membrane near obstacles by `step` of the change found so far in lane `lane`. */
static void move(const Membrane *f, const double *x, const double *force, double step, int lane, Tangent *t) {
    const long count = f->count, from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int c = 0; c < 3; c++)
        for (long k = c * count + from; k < c * count + to; k++) t->x[k] = x[k] + step * (double)t->found[k][lane];
    for (long k = from; k < to; k++) t->force[k] = force[k] + step * (double)t->found[3 * count + k][lane];
}

typedef struct { Bodies bodies; double step; } Change;

static void find_residuals(const Membrane *f, const Change *change, int lane, const double *x, const double *force, Tangent *t) {
    move(f, x, force, change->step, lane, t), obstacle_effects(f, &change->bodies, t->x, t->force, t, t->pressed_on);
    const long from = first_line(f, &t->seen) * f->line, to = behind_lines(f, &t->seen) * f->line;
    for (int c = 0; c < 4; c++)
        for (long k = c * f->count + from; k < c * f->count + to; k++)
            t->residual[k][lane] = (float)((t->pressed_on[k] - t->base[k]) / change->step);
}

/* -- complete derivative ----------------------------------------------------------------------- */

/* Solve for the next displacements, `given`, from the residuals `rhs` of the free unknowns, and add
   them to `found`. Heights in contact follow the slopes. */
static void solve(const Membrane *f, Tangent *t) {
    const long count = f->count;
    const double *v = t->fields.gradient;
    Lanes swells = {0};
    memset(t->rhs + 3 * f->inner, 0, (rows_of(f) - 3 * f->inner) * sizeof *t->rhs);
    panels_solve_eight(panels_of(f), panels_height(QS_WIDTH(f)), t->band, t->rhs);
    for (long k = 0; k < count; k++) {
        const long m = qs_inner(f, k);
        if (m < 0) continue;
        Eight here[3], bulges = {0};
        for (int c = 0; c < 3; c++) here[c] = t->rhs[3 * m + c];
        if (t->seen.touching[k]) here[2] = (float)t->slope[k] * here[0] + (float)t->slope[count + k] * here[1];
        for (int c = 0; c < 3; c++) bulges += (float)v[c * count + k] * here[c], t->given[c * count + k] = here[c];
        swells += __builtin_convertvector(bulges, Lanes);
    }
    const Lanes by_gas = t->gas_stiffness * swells / (1 + t->gas_stiffness * swells[AT_ONCE]);
    t->swells += swells - by_gas * swells[AT_ONCE];
    const Eight gas_moves = __builtin_convertvector(by_gas, Eight);
    for (long k = 0; k < 3 * count; k++) {
        t->given[k] -= gas_moves * t->given[k][AT_ONCE];
        t->found[k] += t->given[k];
    }
}

/* Do one sweep: solve for the present residuals. */
static void sweep(const Membrane *f, Tangent *t, int last) {
    const long count = f->count, first = first_line(f, &t->seen), behind = behind_lines(f, &t->seen);
    const uint8_t *touching = t->seen.touching;
    const double *v = t->fields.gradient;
    memset(t->given, 0, 3 * count * sizeof *t->given);
    for (long k = first * f->line; k < behind * f->line; k++) {
        if (!touching[k]) continue;
        const Eight off = -t->residual[3 * count + k];
        t->given[2 * count + k] = off, t->found[2 * count + k] += off;
        t->swells += v[2 * count + k] * __builtin_convertvector(off, Lanes);
    }
    qs_stencil_times(f, &t->stiffness, first, behind, t->given, t->borne), qs_tangent_springs(f, t, t->given, t->residual);
    const Eight gas = __builtin_convertvector(t->gas_stiffness * t->swells, Eight);
    for (long k = 0; k < count; k++) {
        const long m = qs_inner(f, k);
        if (m < 0) continue;
        Eight row[3];
        for (int c = 0; c < 3; c++) {
            const long at = c * count + k;
            row[c] = -(t->residual[at] + t->borne[at] + gas * (float)v[at]);
            row[c][AT_ONCE] = (float)v[at];
        }
        if (touching[k]) row[0] += (float)t->slope[k] * row[2], row[1] += (float)t->slope[count + k] * row[2], row[2] -= row[2];
        for (int c = 0; c < 3; c++) t->rhs[3 * m + c] = row[c];
    }
    memset(t->given, 0, 3 * count * sizeof *t->given);
    solve(f, t);
    const long from = last ? (long)max_of(first - 1, 0) : 0, to = last ? (long)min_of(behind + 1, f->columns) : f->columns;
    qs_stencil_times(f, &t->stiffness, from, to, t->given, t->borne), qs_tangent_springs(f, t, t->given, t->residual);
    const Eight last_gas = __builtin_convertvector(t->gas_stiffness * t->swells, Eight);
    for (long k = first * f->line; k < behind * f->line; k++) {
        const long z = 2 * count + k;
        if (touching[k]) t->found[3 * count + k] -= t->residual[z] + t->borne[z] + last_gas * (float)v[z];
    }
}

/* Return the projected area of a node's cell, m^2, at the present displacements. */
static double cell_of(const Membrane *f, const double *x, long k) {
    double cell = 0;
    for (int corner = 0; corner < 4; corner++) {
        const int side_x = corner / 2 ? -1 : 1, side_y = corner % 2 ? -1 : 1;
        double g[2][2] = {{1, 0}, {0, 1}};
        for (int c = 0; c < 2; c++) {
            const double *here = x + c * f->count + k;
            g[0][c] += side_x * (here[side_x * f->line] - here[0]) / f->dx, g[1][c] += side_y * (here[side_y] - here[0]) / f->dy;
        }
        cell += f->dx * f->dy / 4 * (g[0][0] * g[1][1] - g[0][1] * g[1][0]);
    }
    return cell;
}

/* Compute the sums (FOUND) for a membrane at `x` on the last evaluated obstacles. */
static void find_sums(const Membrane *f, const double *x, const double *force, Tangent *t, double *found) {
    for (long k = t->seen.box[0] * f->line; k < t->seen.box[1] * f->line; k++)
        if (t->seen.touching[k]) t->seen.cell[k] = cell_of(f, x, k);
    sum_contact(f, x, force, found, &t->seen);
}

/* Compute the derivatives of these sums by lane `lane` of the result, given the change of the
   tension. */
static void sums_by(const Membrane *f, const Change *change, int lane, double tension, const double *x, const double *force, Tangent *t,
                    double *by) {
    double found[FOUND] = {0};
    const double bulge = t->swells[lane], pressure = -t->gas_stiffness * bulge;
    move(f, x, force, change->step, lane, t);
    obstacle_effects(f, &change->bodies, t->x, t->force, t, t->pressed_on);
    found[TENSION] = t->tension + change->step * tension, found[PRESSURE] = t->pressure + change->step * pressure;
    find_sums(f, t->x, t->force, t, found);
    for (int k = 0; k < FOUND; k++) by[k] = (found[k] - t->sums[k]) / change->step;
    by[VOLUME] = bulge, by[TENSION] = tension, by[PRESSURE] = pressure;
}

/* Write lanes of the result in Python's layout: displacements (many, 3, nodes) and forces
   (many, nodes). */
static void write_lanes(const Membrane *f, const Eight *found, long many, double *by_x, double *by_force) {
    const long nodes = f->columns * f->rows;
    for (int c = 0; c < 4; c++)
        for (long i = 0; i < f->columns; i++)
            for (long j = 0; j < f->rows; j++) {
                const Eight here = found[c * f->count + i * f->line + j];
                double *to = (c < 3 ? by_x + c * nodes : by_force) + i * f->rows + j;
                for (long a = 0; a < many; a++) to[a * (c < 3 ? 3 : 1) * nodes] = (double)here[a];
            }
}

/* Evaluate the equilibrium: contact, pressure, tension, and their dependence on displacements.
   Returns the number of sweeps, or 0 if the membrane is not in equilibrium on these obstacles. */
static int linearize_at(const Membrane *f, const Settings *set, const Bodies *bodies, const double *x, const double *force, Tangent *t) {
    const long count = f->count;
    mark_contact(f, force, &t->seen), limit_to_contact(f, bodies, &t->seen);
    memcpy(t->x, x, (3 * count + LANES) * sizeof *x), memcpy(t->force, force, count * sizeof *force);
    const MembraneSums sums = qs_elastic(f, x, QS_ALL, 0, f->columns - 1, &t->fields);
    t->tension = sums.tension;
    evaluate_gas(f, set, sums.volume, &t->pressure, &t->gas_stiffness);
    /* default for nodes in contact exactly at the edge of their obstacle */
    memcpy(t->obstacle, x + 2 * count, count * sizeof *t->obstacle);
    if (is_inconsistent(f, x, force, obstacle_effects(f, bodies, x, force, t, t->base), t)) return 0;
    t->sums[PRESSURE] = t->pressure, t->sums[TENSION] = t->tension;
    find_sums(f, x, force, t, t->sums);
    memcpy(t->slope, t->seen.slope, 2 * count * sizeof *t->slope), memcpy(t->spring, t->seen.spring, 4 * count * sizeof *t->spring);
    memcpy(t->obstacle, t->seen.obstacle, count * sizeof *t->obstacle);
    for (long k = 0; k < 4 * count; k++)
        if (t->spring[k] != 0) return SWEEPS_AT_EDGES;
    return SWEEPS;
}

int64_t qs_sensitivities(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t roomy, double *room,
                    const double *settings, int64_t bodies, int64_t changes, const double *body, int64_t pooled,
                    const double *pool, const double *steps, const double *at, const double *pressed, double *by_x,
                    double *by_force, double *by_detection) {
    const Membrane f = qs_membrane(numbers, law);
    if (columns != f.columns || rows != f.rows || roomy < qs_tangent_size(&f)) return REFUSED;
    (void)pooled;
    Tangent t = qs_tangent_in(&f, room);
    const Bodies base = {.count = bodies, .body = body, .pool = pool};
    const long count = f.count, nodes = columns * rows;
    qs_pad(&f, 3, at, t.at), qs_pad(&f, 1, pressed, t.pressed);
    const double *x = t.at, *force = t.pressed;
    const int sweeps = linearize_at(&f, (const Settings *)settings, &base, x, force, &t);
    if (!sweeps) return 1;
    if (qs_tangent_make(&f, &base, x, force, &t)) return NOT_DEFINITE;
    for (long first = 0; first < changes; first += AT_ONCE) {
        const long many = changes - first < AT_ONCE ? changes - first : AT_ONCE;
        Change change[AT_ONCE];
        for (long a = 0; a < many; a++)
            change[a] = (Change){{bodies, body + (1 + first + a) * bodies * QS_OBSTACLE, pool, 0}, steps[first + a]};
        memset(t.found, 0, 4 * count * sizeof *t.found), memset(t.borne, 0, 3 * count * sizeof *t.borne), t.swells -= t.swells;
        for (int k = 1; k <= sweeps; k++) {
            for (long a = 0; a < many; a++) find_residuals(&f, change + a, (int)a, x, force, &t);
            sweep(&f, &t, k == sweeps);
        }
        Lanes tension = {0};
        for (int c = 0; c < 3; c++)
            for (long k = 0; k < count; k++)
                tension += (double)t.stiffness.tension_by[c * t.stiffness.stride + k] * __builtin_convertvector(t.found[c * count + k], Lanes);
        for (long a = 0; a < many; a++) sums_by(&f, change + a, (int)a, tension[a], x, force, &t, by_detection + (first + a) * FOUND);
        write_lanes(&f, t.found, many, by_x + first * 3 * nodes, by_force + first * nodes);
    }
    return 0;
}
