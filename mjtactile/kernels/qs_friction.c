/* A quasi-static membrane in a moving scene: poses of the obstacles, equilibrium on them, sticking
   and sliding. Its forces on MuJoCo are in qs_joint_forces.c. Arrays:
   sim/sensor/quasistatic_sensor.py. Frame S unless a name contains W. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "quasistatic.h"
#include "qs_friction.h"
#include "qs_workspace.h"
#include "kernels.h"
#include "small_linalg.h"

#define AWAY 10.0       /* position of geoms that are not near, m */
#define LEAST 1e-4      /* force below which nothing sticks, N */
/* obstacle motion up to which the last solution is kept, m; in between, the membrane is a linear
   spring */
#define CLOSE 8e-6
#define LEVER 0.01      /* lever arm that converts a rotation into a distance, m */
/* fraction of contact nodes that may change before the sticking stiffness is computed again */
#define CHANGED 0.1
/* numbers of a geom: squared distance within which it is near, m^2; center and half-extents, m, of
   its bounding box, in its own frame */
#define BOUNDS 7

/* Return the grid without padding: Python's fields have nodes only. */
static Membrane plain(Membrane f) {
    f.rows = (long)f.numbers.nodes_y, f.columns = (long)f.numbers.nodes_x, f.count = f.columns * f.rows;
    f.inner_rows = f.rows - 2, f.inner = (f.columns - 2) * f.inner_rows;
    return f;
}

/* Compute the displacement of the obstacle's point at `middle`, and the obstacle's rotation, from
   one pose to another. */
static void motion(const double *R0, const double *p0, const double *R1, const double *p1, const double *middle, double moved[6]) {
    double turn[9], R0t[9], off[3], was[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) R0t[3 * i + j] = R0[3 * j + i];
    times(R1, R0t, 0, turn);
    for (int i = 0; i < 3; i++) off[i] = middle[i] - p1[i];
    into(turn, off, was);
    for (int i = 0; i < 3; i++) moved[i] = middle[i] - was[i] - p0[i];
    moved[3] = (turn[7] - turn[5]) / 2, moved[4] = (turn[2] - turn[6]) / 2, moved[5] = (turn[3] - turn[1]) / 2;
}

/* Replace a number; return 1 if it changes. */
static int put(double value, double *where) {
    const int changes = *where != value;
    *where = value;
    return changes;
}

/* Write the poses of the geoms into the membrane's obstacles. Returns the MuJoCo body of the
   nearest geom, or -1. `near`: number of near MuJoCo bodies; `moved`: 1 if any geom has moved. */
static long look(long geoms, const int64_t *geom, const int64_t *body_of, const double *bounds, const double *geom_xpos,
                 const double *geom_xmat, const double *R, const double *p, double *rows, double *near, int *moved) {
    long nearest = -1, other = -1;
    double lowest = INFINITY;
    *near = 0, *moved = 0;
    for (long k = 0; k < geoms; k++) {
        double off[3], at[3], turned[9], *row = rows + QS_OBSTACLE * k;
        for (int i = 0; i < 3; i++) off[i] = geom_xpos[3 * geom[k] + i] - p[i];
        into(R, off, at);
        if (at[0] * at[0] + at[1] * at[1] + at[2] * at[2] >= bounds[BOUNDS * k]) {
            for (int i = 0; i < 3; i++) *moved |= put(AWAY, row + 13 + i);
            continue;
        }
        times(R, geom_xmat + 9 * geom[k], 1, turned);
        for (int i = 0; i < 9; i++) *moved |= put(turned[i], row + 4 + i);
        for (int i = 0; i < 3; i++) *moved |= put(at[i], row + 13 + i);
        if (nearest < 0 || body_of[k] == nearest) *near = most(*near, 1);
        else if (body_of[k] != other) *near += 1, other = body_of[k];
        if (at[2] < lowest || nearest < 0) lowest = at[2], nearest = nearest < 0 || *near < 2 ? body_of[k] : nearest;
    }
    return nearest;
}

/* Compute the stiffness of the contact nodes, which move as one rigid set, against x, y and
   rotation about `middle`. Returns 1 if memory runs out. */
static int find_grip(const Membrane *f, const double *x, const double *force, const double *compliance, const double *middle, uint8_t *held,
                     Memory *m) {
    long count = 0, *node = malloc(f->inner * sizeof *node);
    if (!node) return 1;
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j;
            held[k] = force[k] > 0;
            if (held[k]) node[count++] = k;
        }
    const long n = 2 * count, all = 2 * f->inner;
    double *A = malloc((n * n + 3 * n) * sizeof *A), *b = A + n * n;
    if (!A) return free(node), 1;
    for (long a = 0; a < n; a++) {
        const long ka = node[a / 2], ma = 2 * ((ka / f->rows - 1) * f->inner_rows + ka % f->rows - 1) + a % 2;
        for (long c = 0; c <= a; c++) {
            const long kc = node[c / 2], mc = 2 * ((kc / f->rows - 1) * f->inner_rows + kc % f->rows - 1) + c % 2;
            A[a * n + c] = compliance[ma * all + mc];
        }
        const double off_x = ka / f->rows * f->dx - f->numbers.length_x / 2 + x[ka] - middle[0];
        const double off_y = ka % f->rows * f->dy - f->numbers.length_y / 2 + x[f->count + ka] - middle[1];
        b[3 * a] = a % 2 == 0, b[3 * a + 1] = a % 2, b[3 * a + 2] = a % 2 ? off_x : -off_y;
    }
    for (long a = 0; a < n; a++) { /* Cholesky and forward substitution: K = (L^-1 B)^T (L^-1 B) */
        for (long c = 0; c <= a; c++) {
            double sum = A[a * n + c];
            for (long k = 0; k < c; k++) sum -= A[a * n + k] * A[c * n + k];
            A[a * n + c] = c < a ? sum / A[c * n + c] : sqrt(most(sum, 1e-30));
        }
        for (int c = 0; c < 3; c++) {
            double sum = b[3 * a + c];
            for (long k = 0; k < a; k++) sum -= A[a * n + k] * b[3 * k + c];
            b[3 * a + c] = sum / A[a * n + a];
        }
    }
    memset(m->grip, 0, sizeof m->grip);
    for (long a = 0; a < n; a++)
        for (int c = 0; c < 3; c++)
            for (int d = 0; d < 3; d++) m->grip[3 * c + d] += b[3 * a + c] * b[3 * a + d];
    m->gripped = (double)count;
    free(A), free(node);
    return 0;
}

/* Compute center and radius of the contact, and the in-plane displacement `shift` (2) of its nodes
   since the last solution. */
static void find_middle(const Membrane *f, const double *x, const double *force, const double *x_before, const uint8_t *before,
                        Memory *m, double shift[2]) {
    double sum[3] = {0}, total = 0, kept = 0;
    shift[0] = shift[1] = 0;
    for (long k = 0; k < f->count; k++) {
        if (!(force[k] > 0)) continue;
        total += force[k];
        sum[0] += force[k] * (k / f->rows * f->dx - f->numbers.length_x / 2 + x[k]);
        sum[1] += force[k] * (k % f->rows * f->dy - f->numbers.length_y / 2 + x[f->count + k]);
        sum[2] += force[k] * x[2 * f->count + k];
        if (!before[k]) continue;
        kept += force[k];
        for (int c = 0; c < 2; c++) shift[c] += force[k] * (x[c * f->count + k] - x_before[c * f->count + k]);
    }
    for (int c = 0; c < 3; c++) m->middle[c] = sum[c] / total;
    for (int c = 0; c < 2; c++) shift[c] = kept > 0 ? shift[c] / kept : 0;
    double radius = 0;
    for (long k = 0; k < f->count; k++)
        if (force[k] > 0)
            radius += force[k] * hypot(k / f->rows * f->dx - f->numbers.length_x / 2 + x[k] - m->middle[0],
                                       k % f->rows * f->dy - f->numbers.length_y / 2 + x[f->count + k] - m->middle[1]);
    m->radius = radius / total;
}

/* Update the contact after a solution: its center, `shift` as in `find_middle`, and the sticking
   stiffness. The latter is updated if enough nodes differ from those of `touched` (2, count): nodes
   of the last sticking stiffness, and of the last solution. Returns 1 if memory runs out. */
static int hold_anew(const Membrane *f, const Given *g, const double *x, const double *force, const double *compliance, double *x_before,
                     uint8_t *touched, Memory *m, double shift[2]) {
    uint8_t *was = touched + f->count;
    long differ = 0, count = 0;
    find_middle(f, x, force, x_before, was, m, shift);
    for (long k = 0; k < f->count; k++) was[k] = force[k] > 0, count += was[k], differ += was[k] != touched[k];
    memcpy(x_before, x, 2 * f->count * sizeof *x);
    const int others = !m->gripped || differ > CHANGED * (double)count;
    return others && g->friction > 0 && find_grip(f, x, force, compliance, m->middle, touched, m);
}

/* Return the stiffness against indentation, N/m: tension of the membrane about a disc, plus gas and
   bulge in series for the displaced volume. */
static double normal_stiffness(const Given *g, const double *found) {
    const double radius = sqrt(most(found[AREA], square(g->spacing)) / PI), wide = log(most(g->half / radius, 1.2));
    const double lifted = PI * (square(g->half) - square(radius)) / (2 * wide);
    const double gas = g->gas > 0 ? 1 / (1 / g->gas + 1 / g->bulge) : 0;
    return 2 * PI * found[TENSION] / wide + gas * square(lifted);
}

static void stick(const Given *g, double normal_force, const double moved[3], Memory *m) {
    double load[3];
    for (int i = 0; i < 3; i++) m->strain[i] += moved[i];
    outof(m->grip, m->strain, load);
    const double carried = hypot(hypot(load[0], load[1]), load[2] / most(m->radius, g->spacing / 4)), limit = g->friction * normal_force;
    m->slides = carried > limit;
    const double left = m->slides ? limit / carried : 1;
    m->slid += (1 - left) * hypot(m->strain[0], m->strain[1]);
    for (int i = 0; i < 3; i++) m->strain[i] *= left, m->shear[i] = load[i] * left;
}

static void release(Memory *m) {
    m->body = 0, m->slides = 0, m->gripped = 0, m->radius = 0, m->slid = 0;
    memset(m->wrench, 0, sizeof m->wrench), memset(m->strain, 0, sizeof m->strain), memset(m->shear, 0, sizeof m->shear);
}

/* Return 1 if all obstacles are above the membrane: their bounding boxes, which rotate with them,
   are above its highest node. */
static int is_clear(const Membrane *f, const double *x, long geoms, const double *body, const double *bounds) {
    double top = 0;
    for (long k = 0; k < f->count; k++) top = most(top, x[2 * f->count + k]);
    for (long k = 0; k < geoms; k++) {
        const double *row = body + QS_OBSTACLE * k, *up = row + 10, *box = bounds + BOUNDS * k + 1;
        if (row[13] >= AWAY) continue;
        double bottom = row[15];
        for (int i = 0; i < 3; i++) bottom += up[i] * box[i] - fabs(up[i]) * box[3 + i];
        if (bottom < top + f->numbers.half_thickness) return 0;
    }
    return 1;
}

int64_t qs_follow(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                    const double *rest, int64_t roomy, double *room, const double *settings, int64_t geoms, double *body,
                    int64_t pooled, const double *pool, double *x, double *force, double *trend, double *found, const double *given,
                    const double *compliance, int64_t carrier, int64_t nbody, const double *xpos, const double *xmat, int64_t ngeom,
                    const double *geom_xpos, const double *geom_xmat, const int64_t *geom, const int64_t *body_of,
                    const double *bounds, double *memory, uint8_t *touched, double *before) {
    const Membrane f = plain(qs_membrane(numbers, law));
    const Given *g = (const Given *)given;
    Memory *m = (Memory *)memory;
    const double *R = xmat + 9 * carrier, *p = xpos + 3 * carrier;
    (void)nbody, (void)ngeom;
    int has_moved;
    const long near = look(geoms, geom, body_of, bounds, geom_xpos, geom_xmat, R, p, body, &m->near, &has_moved);
    const int again = m->time == g->time; /* same time instant */
    /* a repeated update changes nothing */
    if (again && !has_moved && m->gas_observed == settings[0] && m->sealed_seen == settings[1]) return 0;
    m->gas_observed = settings[0], m->sealed_seen = settings[1];
    const int same_gas = m->gas == settings[0] && m->sealed == settings[1];
    m->solved = 0;
    if (!m->body && same_gas && (near < 0 || is_clear(&f, x, geoms, body, bounds))) return 0;
    double R_SB[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p_SB[3] = {0}, off[3], moved[6] = {0};
    if (near >= 0) {
        times(R, xmat + 9 * near, 1, R_SB);
        for (int i = 0; i < 3; i++) off[i] = xpos[3 * near + i] - p[i];
        into(R, off, p_SB);
    }
    const int same = near >= 0 && m->body == near + 1;
    double since[6] = {0};
    m->time = g->time;
    if (!again) memset(m->moved, 0, sizeof m->moved);
    if (same) {
        motion(m->R, m->p, R_SB, p_SB, m->middle, moved);
        for (int i = 0; i < 3 && !again; i++) m->moved[i] = p_SB[i] - m->p[i], m->moved[3 + i] = moved[3 + i];
        motion(m->R_rest, m->p_rest, R_SB, p_SB, m->middle, since);
    }
    const double way = fabs(since[0]) + fabs(since[1]) + fabs(since[2]) + LEVER * (fabs(since[3]) + fabs(since[4]) + fabs(since[5]));
    double shift[2] = {0}, further = since[2];
    if (!(same && same_gas && way < CLOSE)) {
        double *x_before = before, *kept_x = before + 2 * f.count, *kept_force = kept_x + 3 * f.count;
        uint8_t *was = touched + f.count;
        memcpy(kept_x, x, 3 * f.count * sizeof *x), memcpy(kept_force, force, f.count * sizeof *x);
        double kept_found[FOUND];
        memcpy(kept_found, found, sizeof kept_found);
        const int64_t code = qs_solve(numbers, law, columns, rows, keeping, kept, rest, roomy, room, 1, 0, 1, settings, geoms, body, pooled,
                                        pool, x, force, trend, found);
        if (code < 0) return code;
        m->status = found[STATUS], m->solved = 1;
        if (found[STATUS] != CONVERGED) {
            memcpy(x, kept_x, 3 * f.count * sizeof *x), memcpy(force, kept_force, f.count * sizeof *x);
            memcpy(found, kept_found, sizeof kept_found), memset(trend, 0, 4 * f.count * sizeof *x);
            m->lost += 1;
        } else {
            m->lost = 0, m->gas = settings[0], m->sealed = settings[1];
            memcpy(m->R_rest, R_SB, sizeof R_SB), memcpy(m->p_rest, p_SB, sizeof p_SB);
            further = 0;
        }
        if (!(-found[FORCE_Z] > LEAST) || near < 0) {
            release(m);
            memset(was, 0, f.count);
            memcpy(x_before, x, 2 * f.count * sizeof *x);
            return 0;
        }
        if (!same) release(m), memset(was, 0, f.count);
        if (hold_anew(&f, g, x, force, compliance, x_before, touched, m, shift)) return NO_MEMORY;
        m->normal = normal_stiffness(g, found);
    }
    const double pressed = most(-found[FORCE_Z] - m->normal * further, 0);
    const double along[3] = {moved[0] - shift[0], moved[1] - shift[1], moved[5]};
    if (g->friction > 0) stick(g, pressed, along, m);
    m->body = (double)(near + 1);
    memcpy(m->R, R_SB, sizeof R_SB), memcpy(m->p, p_SB, sizeof p_SB);
    memcpy(m->wrench, found, 6 * sizeof *found);
    const double added[3] = {m->shear[0], m->shear[1], -pressed - found[FORCE_Z]};
    double torque[3];
    across(m->middle, added, torque);
    torque[2] += m->shear[2];
    for (int i = 0; i < 3; i++) m->wrench[i] += added[i], m->wrench[3 + i] += torque[i];
    return 0;
}
