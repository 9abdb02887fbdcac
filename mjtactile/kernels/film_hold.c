/* A film in a scene that moves: where its bodies are, where it rests on them, what sticks and slides, and what that pushes.
   sim/sensor/film_sensor.py says what each array is; frame S unless a name says W. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "film.h"
#include "film_work.h"
#include "kernels.h"
#include "small.h"

#define AWAY 10.0       /* m, where what is not near is put */
#define LEAST 1e-4      /* N, below which nothing sticks */
#define CLOSE 8e-6      /* m that a body may go before the film is solved for again; meanwhile it is a spring */
#define LEVER 0.01      /* m, by which a turn counts as a way */
#define CHANGED 0.1     /* share of the nodes that may come and go before the grip is found anew */
#define TILT 0.25       /* of stiffness times radius^2: a disc on an even bed */
#define BOUNDS 7        /* numbers: m^2 within which a geom is near; middle and half sizes of a box about it, m, its own frame */
#define SHARE 0.75      /* of stiffness times step that damps a free body; every step is stable from 0.5 on, where a heavy one swings on */
enum { JOINT_FREE, JOINT_BALL, JOINT_SLIDE, JOINT_HINGE };

/* What is remembered, all of it doubles; film_memory.py knows the places. */
typedef struct {
    double body;                    /* that touches, plus one; 0: nothing does */
    double wrench[6];               /* of it on the film about the origin of S */
    double middle[3], radius, slides;
    double strain[3], shear[3];     /* m, m, rad; N, N, N m of the body on the film */
    double near, status, lost, solved;
    double grip[9], gripped, normal;
    double R[9], p[3];              /* of the body at the last look */
    double R_rest[9], p_rest[3];    /* and at the last solution */
    double gas, sealed;             /* of that */
    double moved[6];                /* m of the body's origin and rad, since the look before */
    double time;                    /* s, of the last look */
    double slid;                    /* m over the film since it touched */
    double gas_seen, sealed_seen;   /* at the last look */
} Memory;

/* Given: friction, Pa/m^3 of bulge and gas, time step s, half width of the frame m, spacing of
   nodes m, time s, how far the film reaches from the middle of its frame m. */
typedef struct { double friction, bulge, gas, step, half, spacing, time, reach; } Given;

/* Python's fields are of nodes alone, the film's own are padded. */
static Film plain(Film f) {
    f.rows = (long)f.numbers.nodes_y, f.columns = (long)f.numbers.nodes_x, f.count = f.columns * f.rows;
    f.inner_rows = f.rows - 2, f.inner = (f.columns - 2) * f.inner_rows;
    return f;
}

static void times(const double *A, const double *B, int transpose, double *out) { /* 3 x 3; A^T B */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 3; k++) sum += (transpose ? A[3 * k + i] : A[3 * i + k]) * B[3 * k + j];
            out[3 * i + j] = sum;
        }
}
static void into(const double *R, const double *v, double *out) { /* R^T v */
    for (int i = 0; i < 3; i++) out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}
static void outof(const double *R, const double *v, double *out) { /* R v */
    for (int i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}
static void across(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* How far the body's point at `middle` has gone, and its turn, from a pose to another. */
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

/* A number where another was; whether that changes it. */
static int put(double value, double *where) {
    const int changes = *where != value;
    *where = value;
    return changes;
}

/* Poses of the geoms into the film's bodies; returns the body of the nearest, or -1, how many are near, and whether any has moved. */
static long look(long geoms, const int64_t *geom, const int64_t *body_of, const double *bounds, const double *geom_xpos,
                 const double *geom_xmat, const double *R, const double *p, double *rows, double *near, int *moved) {
    long nearest = -1, other = -1;
    double lowest = INFINITY;
    *near = 0, *moved = 0;
    for (long k = 0; k < geoms; k++) {
        double off[3], at[3], turned[9], *row = rows + FILM_BODY * k;
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

/* Stiffness of the nodes that touch, as one body, against x, y and a turn about `middle`. 1: none. */
static int find_grip(const Film *f, const double *x, const double *force, const double *compliance, const double *middle, uint8_t *held,
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
    for (long a = 0; a < n; a++) { /* Cholesky, and forward: K = (L^-1 B)^T (L^-1 B) */
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

/* Middle and radius of the contact, and by how much (2) its nodes have gone in the plane since the last solution. */
static void find_middle(const Film *f, const double *x, const double *force, const double *x_before, const uint8_t *before,
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

/* Against a press: of the sheet's tension about a disc, and of gas and bulge in series that it displaces. */
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

/* Whether all bodies are above the film: the boxes about them, which turn with them, above its highest node. */
static int is_clear(const Film *f, const double *x, long geoms, const double *body, const double *bounds) {
    double top = 0;
    for (long k = 0; k < f->count; k++) top = most(top, x[2 * f->count + k]);
    for (long k = 0; k < geoms; k++) {
        const double *row = body + FILM_BODY * k, *up = row + 10, *box = bounds + BOUNDS * k + 1;
        if (row[13] >= AWAY) continue;
        double bottom = row[15];
        for (int i = 0; i < 3; i++) bottom += up[i] * box[i] - fabs(up[i]) * box[3 + i];
        if (bottom < top + f->numbers.half_thickness) return 0;
    }
    return 1;
}

int64_t film_follow(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                    const double *rest, int64_t roomy, double *room, const double *settings, int64_t geoms, double *body,
                    int64_t pooled, const double *pool, double *x, double *force, double *trend, double *found, const double *given,
                    const double *compliance, int64_t carrier, int64_t nbody, const double *xpos, const double *xmat, int64_t ngeom,
                    const double *geom_xpos, const double *geom_xmat, const int64_t *geom, const int64_t *body_of,
                    const double *bounds, double *memory, uint8_t *touched, double *before) {
    const Film f = plain(film_of(numbers, law));
    const Given *g = (const Given *)given;
    Memory *m = (Memory *)memory;
    const double *R = xmat + 9 * carrier, *p = xpos + 3 * carrier;
    (void)nbody, (void)ngeom;
    int has_moved;
    const long near = look(geoms, geom, body_of, bounds, geom_xpos, geom_xmat, R, p, body, &m->near, &has_moved);
    const int again = m->time == g->time; /* of the same moment */
    if (again && !has_moved && m->gas_seen == settings[0] && m->sealed_seen == settings[1]) return 0; /* who looks twice changes nothing */
    m->gas_seen = settings[0], m->sealed_seen = settings[1];
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
        const int64_t code = film_solve(numbers, law, columns, rows, keeping, kept, rest, roomy, room, 1, 0, 1, settings, geoms, body, pooled,
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
        find_middle(&f, x, force, x_before, was, m, shift);
        long differ = 0, count = 0;
        for (long k = 0; k < f.count; k++) was[k] = force[k] > 0, count += was[k], differ += was[k] != touched[k];
        memcpy(x_before, x, 2 * f.count * sizeof *x);
        if ((!m->gripped || differ > CHANGED * (double)count) && g->friction > 0 && find_grip(&f, x, force, compliance, m->middle, touched, m))
            return NO_MEMORY;
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

/* -- pushes ------------------------------------------------------------------------------------------------------------- */

/* The generalized force of a force and a torque, W, at `at` on a body, added to `out`. */
static void apply(long body, double sign, const double *F, const double *T, const double *at, const int32_t *parent, const int32_t *joints,
                  const int32_t *first, const int32_t *type, const int32_t *dof, const double *anchor, const double *axis,
                  const double *xpos, const double *xmat, double *out) {
    for (; body > 0; body = parent[body])
        for (long j = first[body]; j < first[body] + joints[body]; j++) {
            double arm[3], turn[3], local[3];
            const double *from = type[j] == JOINT_FREE ? xpos + 3 * body : anchor + 3 * j;
            for (int i = 0; i < 3; i++) arm[i] = at[i] - from[i];
            across(arm, F, turn);
            for (int i = 0; i < 3; i++) turn[i] += T[i];
            double *here = out + dof[j];
            if (type[j] == JOINT_FREE)
                for (int i = 0; i < 3; i++) *here++ += sign * F[i];
            if (type[j] <= JOINT_BALL) {
                into(xmat + 9 * body, turn, local);
                for (int i = 0; i < 3; i++) here[i] += sign * local[i];
            } else {
                const double *v = type[j] == JOINT_SLIDE ? F : turn, *a = axis + 3 * j;
                *here += sign * (a[0] * v[0] + a[1] * v[1] + a[2] * v[2]);
            }
        }
}

/* How stiffly what touches is held, by the degrees of freedom of the free joint that carries it: G^T K G, and their velocity
   against the film. `R_SB`, `p_SB`: of that joint's body, with which what touches is taken to go. */
static void hold_of(const Given *g, const Memory *m, long dof, const double *R_SB, const double *p_SB, double *hold, const double *R) {
    double G[36] = {0}, K[6] = {0, 0, m->normal, 0, 0, 0}, r[3], off[3], swing[3], moved[3];
    const double tilt = TILT * m->normal * square(most(m->radius, g->spacing / 4));
    K[3] = K[4] = tilt, K[5] = tilt;
    if (!m->slides && m->gripped > 0) K[0] = m->grip[0], K[1] = m->grip[4], K[5] = m->grip[8];
    for (int i = 0; i < 3; i++) r[i] = m->middle[i] - p_SB[i], off[i] = p_SB[i] - m->p[i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) G[6 * i + j] = R[3 * j + i], G[6 * (3 + i) + 3 + j] = R_SB[3 * i + j];
    for (int j = 0; j < 3; j++) { /* v = v_o + w x r, w = R_SB w_B */
        const double w[3] = {R_SB[j], R_SB[3 + j], R_SB[6 + j]};
        double v[3];
        across(w, r, v);
        for (int i = 0; i < 3; i++) G[6 * i + 3 + j] = v[i];
    }
    hold[0] = (double)(dof + 1);
    for (int a = 0; a < 6; a++)
        for (int b = 0; b < 6; b++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += G[6 * k + a] * K[k] * G[6 * k + b];
            hold[1 + 6 * a + b] = sum;
        }
    across(m->moved + 3, off, swing);
    for (int i = 0; i < 3; i++) moved[i] = m->moved[i] + swing[i];
    outof(R, moved, hold + 37), into(R_SB, m->moved + 3, hold + 40);
    for (int i = 0; i < 6; i++) hold[37 + i] /= g->step;
}

int64_t film_push(const double *given, const double *memory, int64_t carrier, int64_t nbody,
                  const int32_t *parent, const int32_t *joints, const int32_t *first, int64_t njnt, const int32_t *type,
                  const int32_t *dof, const double *anchor, const double *axis, const double *xpos, const double *xmat, int64_t nv,
                  double *push, double *hold) {
    const Given *g = (const Given *)given;
    const Memory *m = (const Memory *)memory;
    (void)nbody, (void)njnt;
    memset(push, 0, nv * sizeof *push), hold[0] = 0;
    if (!m->body) return 0;
    const long body = (long)m->body - 1;
    const double *R = xmat + 9 * carrier;
    double F[3], T[3], at[3], turn[3], local[3];
    across(m->middle, m->wrench, turn);
    for (int i = 0; i < 3; i++) local[i] = m->wrench[3 + i] - turn[i];
    outof(R, m->wrench, F), outof(R, local, T), outof(R, m->middle, at);
    for (int i = 0; i < 3; i++) at[i] += xpos[3 * carrier + i];
    apply(carrier, 1, F, T, at, parent, joints, first, type, dof, anchor, axis, xpos, xmat, push);
    apply(body, -1, F, T, at, parent, joints, first, type, dof, anchor, axis, xpos, xmat, push);
    long carried = body; /* by a free joint: its own, or that of a body which it is jointed to */
    while (carried > 0 && !(joints[carried] == 1 && type[first[carried]] == JOINT_FREE)) carried = parent[carried];
    if (carried <= 0) return 1;
    double R_SB[9], p_SB[3], apart[3];
    times(R, xmat + 9 * carried, 1, R_SB);
    for (int i = 0; i < 3; i++) apart[i] = xpos[3 * carried + i] - xpos[3 * carrier + i];
    into(R, apart, p_SB);
    hold_of(g, m, dof[first[carried]], R_SB, p_SB, hold, R);
    return 1;
}

/* All films' pushes (films, nv) and holds (films, 43) into `applied` and `damping` (nv). */
int64_t film_add(int64_t nv, int64_t films, const double *pushes, const double *holds, double step, const double *inertia,
                 const double *velocity, double *base, double *left, double *applied, const double *undamped, double *damping) {
    if (memcmp(applied, left, nv * sizeof *left)) memcpy(base, applied, nv * sizeof *base); /* somebody else wrote */
    memcpy(applied, base, nv * sizeof *base);
    memcpy(damping, undamped, nv * sizeof *damping);
    for (long k = 0; k < films; k++)
        for (long i = 0; i < nv; i++) applied[i] += pushes[k * nv + i];
    for (long k = 0; k < films; k++) {
        const long dof = (long)holds[43 * k] - 1;
        long first = 1, count = 0;
        double K[36] = {0}, against[6] = {0};
        for (long l = 0; l < films; l++) {
            if ((long)holds[43 * l] - 1 != dof) continue;
            if (l < k) first = 0;
            count++;
            for (int i = 0; i < 36; i++) K[i] += holds[43 * l + 1 + i];
            for (int i = 0; i < 6; i++) against[i] += holds[43 * l + 37 + i];
        }
        if (dof < 0 || !first) continue;
        for (int a = 0; a < 6; a++) { /* at least the stiffness, by Gershgorin in coordinates with an inertia of one */
            double sum = 0;
            for (int b = 0; b < 6; b++) sum += fabs(K[6 * a + b]) / sqrt(inertia[dof + b]);
            sum *= SHARE * step * sqrt(inertia[dof + a]);
            damping[dof + a] += sum;
            applied[dof + a] += sum * (velocity[dof + a] - against[a] / (double)count);
        }
    }
    memcpy(left, applied, nv * sizeof *left);
    return 0;
}
