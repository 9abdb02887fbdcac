/* A quasi-static membrane in a moving scene: poses of the obstacles, equilibrium on them, sticking
   and sliding. Its forces on MuJoCo are in qs_joint_forces.c. Arrays:
   sim/sensor/quasistatic_sensor.py. Frame S unless a name contains W. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "quasistatic.h"
#include "qs_friction.h"
#include "qs_lowest_obstacle.h"
#include "qs_workspace.h"
#include "kernels.h"
#include "small_linalg.h"

#define AWAY 10.0       /* position of geoms that are not near, m */
#define LEAST 1e-4      /* force below which nothing sticks, N */
/* obstacle motion up to which the last solution is kept, m; in between, the membrane is a linear
   spring */
#define CLOSE 8e-6
#define LEVER 0.01      /* lever arm that converts a rotation into a distance, m */
/* steps without a solution after which the obstacles are raised until there is one, m; a body that
   arrives is not awaited */
#define LATE 2
#define FIRST_LIFT 2e-5 /* m */
#define DOUBLINGS 10
/* steps between attempts without a lift, and with half of it */
#define EASE 8
#define LOWER 4
#define PAUSE 32        /* steps until the next attempt if no lift has a solution */
/* fraction of contact nodes that may change before the sticking stiffness is computed again */
#define CHANGED 0.1
/* sweeps over the loads of nodes at the friction limit, and work after which none starts, in pairs of
   nodes */
#define SWEEPS 8
#define MAX_WORK 8000
#define CLOSE_LOAD 1e-3 /* change of a load that is ignored, over the mean limit */
#define AT_LIMIT 1e-6   /* relative distance from the limit that is rounding error */
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

/* Arguments of a solution. */
typedef struct {
    const double *numbers, *law;
    int64_t columns, rows, keeping;
    const float *kept;
    const double *rest;
    int64_t roomy;
    double *room;
    int64_t geoms;
    double *body;
    int64_t pooled;
    const double *pool;
    double *x, *force, *trend, *found;
} Solution;

/* MuJoCo's geoms and bodies near a membrane, in front of the glass at -`depth` m. `slot`: patch of each geom; `of`: body of each
   patch. */
typedef struct {
    long geoms, slots;
    const int64_t *geom, *slot, *of;
    const double *bounds, *geom_xpos, *geom_xmat, *xpos, *xmat;
    const double *R, *p;            /* pose of the carrier */
    double depth;
} Scene;

/* Write the poses of the geoms into the membrane's obstacles, and mark the near bodies. Returns 1
   if any geom has moved. */
static int update_patches(const Scene *s, double *rows, Memory *m, Patch *patches) {
    int moved = 0;
    for (long k = 0; k < s->slots; k++) patches[k].near = 0;
    m->near = 0;
    for (long k = 0; k < s->geoms; k++) {
        double off[3], at[3], turned[9], *row = rows + QS_OBSTACLE * k;
        for (int i = 0; i < 3; i++) off[i] = s->geom_xpos[3 * s->geom[k] + i] - s->p[i];
        into(s->R, off, at);
        const double *bounds = s->bounds + BOUNDS * k, *box = bounds + 1;
        int is_near = at[0] * at[0] + at[1] * at[1] + at[2] * at[2] < bounds[0];
        if (is_near) {
            times(s->R, s->geom_xmat + 9 * s->geom[k], 1, turned);
            double top = at[2];
            for (int i = 0; i < 3; i++) top += turned[6 + i] * box[i] + fabs(turned[6 + i]) * box[3 + i];
            is_near = top > -s->depth;
        }
        if (!is_near) {
            for (int i = 0; i < 3; i++) moved |= put(AWAY, row + 13 + i);
            continue;
        }
        for (int i = 0; i < 9; i++) moved |= put(turned[i], row + 4 + i);
        for (int i = 0; i < 3; i++) moved |= put(at[i], row + 13 + i);
        Patch *own = patches + s->slot[k];
        if (!own->near) own->near = 1, m->near += 1;
    }
    return moved;
}

/* Compute the pose in S of the body of a patch. */
static void pose_of(const Scene *s, long slot, double R_SB[9], double p_SB[3]) {
    double off[3];
    const long body = s->of[slot];
    times(s->R, s->xmat + 9 * body, 1, R_SB);
    for (int i = 0; i < 3; i++) off[i] = s->xpos[3 * body + i] - s->p[i];
    into(s->R, off, p_SB);
}

/* Loads of the nodes in contact (2, count), N; displacements by which they lag behind their bodies
   (2, count), m; patch of each node at the last sticking stiffness, plus one; loads by unit motions of
   the patches (3 slots, 2, count); workspace for a list of nodes (count). */
typedef struct { const int32_t *patch; double *load, *lag, *unit; int32_t *node; } Held;

/* Return the position of a node in the plane, along x or y. */
static inline double x_of(const Membrane *f, const double *x, long k) { return k / f->rows * f->dx - f->numbers.length_x / 2 + x[k]; }
static inline double y_of(const Membrane *f, const double *x, long k) {
    return k % f->rows * f->dy - f->numbers.length_y / 2 + x[f->count + k];
}

/* Return the index of x of a node among the in-plane displacements of the inner nodes; y is next. */
static inline long inner_of(const Membrane *f, long k) { return 2 * ((k / f->rows - 1) * f->inner_rows + k % f->rows - 1); }

/* Compute the displacement of an inner node along `axis` by which it lags, and by the loads of the
   nodes `left` that left the contact. */
static double displacement_of(const Membrane *f, const double *compliance, const Held *h, long k, int axis, long lost, const long *left) {
    const double *row = compliance + (inner_of(f, k) + axis) * 2 * f->inner;
    double sum = h->lag[axis * f->count + k];
    for (long i = 0; i < lost; i++) {
        const long n = left[i];
        sum += row[inner_of(f, n)] * h->load[n] + row[inner_of(f, n) + 1] * h->load[f->count + n];
    }
    return sum;
}

/* Factorize the positive definite A (n, n): A = L L^T in its lower triangle. */
static void factorize(long n, double *A) {
    for (long a = 0; a < n; a++)
        for (long c = 0; c <= a; c++) {
            double sum = A[a * n + c];
            for (long k = 0; k < c; k++) sum -= A[a * n + k] * A[c * n + k];
            A[a * n + c] = c < a ? sum / A[c * n + c] : sqrt(max_of(sum, 1e-30));
        }
}

/* Solve L L^T x = b for the columns of b (n, wide), in place. */
static void solve_factorized(long n, const double *L, long wide, double *b) {
    for (long a = 0; a < n; a++)
        for (long c = 0; c < wide; c++) {
            double sum = b[wide * a + c];
            for (long k = 0; k < a; k++) sum -= L[a * n + k] * b[wide * k + c];
            b[wide * a + c] = sum / L[a * n + a];
        }
    for (long a = n - 1; a >= 0; a--)
        for (long c = 0; c < wide; c++) {
            double sum = b[wide * a + c];
            for (long k = a + 1; k < n; k++) sum -= L[k * n + a] * b[wide * k + c];
            b[wide * a + c] = sum / L[a * n + a];
        }
}

/* Return component `c` of the rigid motions x, y and rotation of a point at `off` from the center. */
static inline double rigid(int c, int axis, const double off[2]) { return c < 2 ? c == axis : axis ? off[0] : -off[1]; }

/* Compute the stiffness `grip` (3 slots, 3 slots) of the contact nodes against x, y and rotation of
   the patches about their centers, and their loads. The nodes of a patch move as one rigid set. A
   node joins the contact without a load: the others were displaced before. The others take over the
   loads of nodes that leave. Returns 1 if memory runs out. */
static int find_grip(const Membrane *f, const double *x, const double *compliance, long slots, double *grip, Held *h, Memory *m,
                     Patch *patches) {
    long count = 0, lost = 0, wide = 0, *node = malloc((2 * f->inner + slots) * sizeof *node), *left = node + f->inner, *column = left + f->inner;
    if (!node) return 1;
    for (long s = 0; s < slots; s++) {
        column[s] = patches[s].touching ? 3 * wide++ : -1;
        patches[s].gripped = 0;
    }
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++) {
            const long k = i * f->rows + j;
            if (h->patch[k]) node[count++] = k, patches[h->patch[k] - 1].gripped += 1;
            else if (h->load[k] != 0 || h->load[f->count + k] != 0) left[lost++] = k;
        }
    const long n = 2 * count, all = 2 * f->inner, loads = 3 * wide, last = loads;
    double *A = malloc((n * n + (loads + 1) * n) * sizeof *A), *b = A + n * n;
    if (!A) return free(node), 1;
    memset(b, 0, (loads + 1) * n * sizeof *b);
    for (long a = 0; a < n; a++) {
        const long ka = node[a / 2], ma = inner_of(f, ka) + a % 2;
        for (long c = 0; c <= a; c++) A[a * n + c] = compliance[ma * all + inner_of(f, node[c / 2]) + c % 2];
        const Patch *own = patches + h->patch[ka] - 1;
        const double off[2] = {x_of(f, x, ka) - own->middle[0], y_of(f, x, ka) - own->middle[1]};
        for (int c = 0; c < 3; c++) b[(loads + 1) * a + column[h->patch[ka] - 1] + c] = rigid(c, a % 2, off);
        b[(loads + 1) * a + last] = displacement_of(f, compliance, h, ka, a % 2, lost, left);
    }
    factorize(n, A), solve_factorized(n, A, loads + 1, b);
    memset(grip, 0, 9 * slots * slots * sizeof *grip);
    memset(h->unit, 0, 6 * slots * f->count * sizeof *h->unit);
    memset(h->lag, 0, 2 * f->count * sizeof *h->lag);
    for (long i = 0; i < lost; i++) h->load[left[i]] = h->load[f->count + left[i]] = 0;
    for (long a = 0; a < n; a++) {
        const long k = node[a / 2], own = h->patch[k] - 1;
        const double off[2] = {x_of(f, x, k) - patches[own].middle[0], y_of(f, x, k) - patches[own].middle[1]};
        const double *row = b + (loads + 1) * a;
        h->load[a % 2 * f->count + k] += row[last];
        for (long t = 0; t < slots; t++)
            for (int d = 0; d < 3 && column[t] >= 0; d++) {
                const double by = row[column[t] + d];
                h->unit[(2 * (3 * t + d) + a % 2) * f->count + k] = by;
                for (int c = 0; c < 3; c++) grip[(3 * own + c) * 3 * slots + 3 * t + d] += rigid(c, a % 2, off) * by;
            }
    }
    m->gripped = (double)count;
    free(A), free(node);
    return 0;
}

/* Compute center and radius of the contact at the nodes of `owner` `label` (0: all), and the
   in-plane displacement `shift` (2) of its nodes since the last solution. */
static void find_middle(const Membrane *f, const double *x, const double *force, const double *x_before, const int32_t *owner,
                        const int32_t *before, int32_t label, double middle[3], double *mean_radius, double shift[2]) {
    double sum[3] = {0}, total = 0, kept = 0;
    shift[0] = shift[1] = 0;
    for (long k = 0; k < f->count; k++) {
        if (!owner[k] || (label && owner[k] != label)) continue;
        total += force[k];
        sum[0] += force[k] * x_of(f, x, k);
        sum[1] += force[k] * y_of(f, x, k);
        sum[2] += force[k] * x[2 * f->count + k];
        if (before[k] != owner[k]) continue;
        kept += force[k];
        for (int c = 0; c < 2; c++) shift[c] += force[k] * (x[c * f->count + k] - x_before[c * f->count + k]);
    }
    for (int c = 0; c < 3; c++) middle[c] = sum[c] / total;
    for (int c = 0; c < 2; c++) shift[c] = kept > 0 ? shift[c] / kept : 0;
    double radius = 0;
    for (long k = 0; k < f->count; k++)
        if (owner[k] && !(label && owner[k] != label))
            radius += force[k] * hypot(x_of(f, x, k) - middle[0], y_of(f, x, k) - middle[1]);
    *mean_radius = radius / total;
}

static void release(Patch *p) {
    p->touching = 0, p->slides = 0, p->gripped = 0, p->radius = 0;
    memset(p->wrench, 0, sizeof p->wrench), memset(p->shear, 0, sizeof p->shear);
}

/* Return the obstacle on which a node lies, or -1: the lowest one over it, or next to it if the node
   has moved off an edge. A thin one was moved under the node by `away`. */
static long obstacle_under(const Membrane *f, const Bodies *bodies, const double at[2]) {
    double height, slope[2], low = INFINITY;
    long found = lowest_of(f, bodies, at[0], at[1], &height, slope);
    for (int i = 0; i < 25 && !isfinite(height); i++) {
        double by;
        const long one = lowest_of(f, bodies, at[0] + (i % 5 - 2) * f->dx / 2, at[1] + (i / 5 - 2) * f->dy / 2, &by, slope);
        if (one >= 0 && by < low) low = by, found = one;
    }
    return found;
}

/* Find the patch of each node in contact, plus one. `line`: padded length of a grid line. */
static void find_owners(const Membrane *f, const Bodies *bodies, const Scene *s, const Seen *seen, long line, const double *x,
                        const double *force, const Memory *m, const Patch *patches, const int32_t *before, int32_t *owner) {
    long only = -1;
    for (long k = 0; k < s->slots; k++)
        if (patches[k].near) only = k;
    for (long k = 0; k < f->count; k++) {
        owner[k] = 0;
        if (!(force[k] > 0)) continue;
        owner[k] = (int32_t)(only + 1);
        if (m->near < 2) continue;
        const long padded = k / f->rows * line + k % f->rows;
        const double at[2] = {x_of(f, x, k) + seen->away[padded], y_of(f, x, k) + seen->away[f->columns * line + padded]};
        const long on = obstacle_under(f, bodies, at);
        if (on >= 0) owner[k] = (int32_t)(s->slot[on] + 1);
        else if (before[k]) owner[k] = before[k];
    }
}

/* Add up the frictionless wrench of each patch, and release those without contact. Returns the
   number of patches in contact. */
static long find_loads(const Membrane *f, const Seen *seen, long line, const double *x, const double *force, const double *found, long slots,
                       Patch *patches, int32_t *owner) {
    long count = 0, last = -1;
    for (long s = 0; s < slots; s++) memset(patches[s].carried, 0, sizeof patches[s].carried);
    for (long k = 0; k < f->count; k++) {
        if (!owner[k]) continue;
        const long padded = k / f->rows * line + k % f->rows;
        const double r[3] = {x_of(f, x, k), y_of(f, x, k), x[2 * f->count + k]};
        const double F[3] = {force[k] * seen->slope[padded], force[k] * seen->slope[f->columns * line + padded], -force[k]};
        double torque[3], *sum = patches[owner[k] - 1].carried;
        across(r, F, torque);
        for (int c = 0; c < 3; c++) sum[c] += F[c], sum[3 + c] += torque[c];
    }
    for (long s = 0; s < slots; s++) {
        Patch *p = patches + s;
        if (!(-p->carried[2] > LEAST)) {
            release(p);
            continue;
        }
        if (!p->touching) release(p);
        p->touching = 1, count++, last = s;
    }
    for (long k = 0; k < f->count; k++)
        if (owner[k] && !patches[owner[k] - 1].touching) owner[k] = 0;
    /* one patch carries all of it: exactly the wrench of the solution */
    if (count == 1) memcpy(patches[last].carried, found, sizeof patches[last].carried);
    return count;
}

/* Return the stiffness against indentation, N/m: tension of the membrane about a disc, plus gas and
   bulge in series for the displaced volume. `fraction`: fraction of the contact area. */
static double normal_stiffness(const Given *g, const double *found, double fraction, Patch *p) {
    const double radius = sqrt(max_of(found[AREA] * fraction, square(g->spacing)) / PI), wide = log(max_of(g->half / radius, 1.2));
    const double lifted = PI * (square(g->half) - square(radius)) / (2 * wide);
    const double gas = g->gas > 0 ? 1 / (1 / g->gas + 1 / g->bulge) : 0;
    p->tension = 2 * PI * found[TENSION] / wide, p->lifted = lifted;
    return 2 * PI * found[TENSION] / wide + gas * square(lifted);
}

/* Return 1 if all obstacles are above the membrane: their bounding boxes, which rotate with them,
   are above its highest node. */
static int is_clear(const Membrane *f, const double *x, long geoms, const double *body, const double *bounds) {
    double top = 0;
    for (long k = 0; k < f->count; k++) top = max_of(top, x[2 * f->count + k]);
    for (long k = 0; k < geoms; k++) {
        const double *row = body + QS_OBSTACLE * k, *up = row + 10, *box = bounds + BOUNDS * k + 1;
        if (row[13] >= AWAY) continue;
        double bottom = row[15];
        for (int i = 0; i < 3; i++) bottom += up[i] * box[i] - fabs(up[i]) * box[3 + i];
        if (bottom < top + f->numbers.half_thickness) return 0;
    }
    return 1;
}

/* Attempt a solution with the obstacles raised by `lift`, m; of what is `touching`, some must stay in
   contact. On failure the state is kept. Returns the status, or a negative error. */
static int64_t attempt(const Solution *c, const double *settings, double lift, int touching, long nodes, double *keep) {
    double *kept_force = keep + 3 * nodes, kept_found[FOUND];
    memcpy(keep, c->x, 3 * nodes * sizeof *keep), memcpy(kept_force, c->force, nodes * sizeof *keep);
    memcpy(kept_found, c->found, sizeof kept_found);
    if (lift > 0)
        for (long k = 0; k < c->geoms; k++) c->body[QS_OBSTACLE * k + 15] += lift;
    const int64_t code = qs_solve(c->numbers, c->law, c->columns, c->rows, c->keeping, c->kept, c->rest, c->roomy, c->room, 1, 0, 1, settings,
                                  c->geoms, c->body, c->pooled, c->pool, c->x, c->force, c->trend, c->found);
    if (code < 0) return code;
    int64_t status = (int64_t)c->found[STATUS];
    if (status == CONVERGED && lift > 0 && touching && !(-c->found[FORCE_Z] > LEAST)) status = NOT_CONVERGED; /* too high */
    if (status == CONVERGED) return CONVERGED;
    memcpy(c->x, keep, 3 * nodes * sizeof *keep), memcpy(c->force, kept_force, nodes * sizeof *keep);
    memcpy(c->found, kept_found, sizeof kept_found), memset(c->trend, 0, 4 * nodes * sizeof *keep);
    return status;
}

/* Find the equilibrium at the present poses. If there is none for more than LATE steps, raise the
   obstacles until there is one. Obstacles stay raised until the next call of `update_patches`. Returns 1 if a
   solution was found, 0 if the last one is kept, or a negative error. */
static int64_t solve(const Solution *c, const Scene *s, const double *settings, long nodes, double *keep, Memory *m, Patch *patches) {
    int64_t status;
    m->solved = 1;
    if (m->pause > 0) return m->pause -= 1, m->lost += 1, 0;
    if (m->lift == 0 || (long)m->lost % EASE == 0) {
        status = attempt(c, settings, 0, 0, nodes, keep);
        if (status < 0) return status;
        m->status = (double)status;
        if (status == CONVERGED) return m->lost = 0, m->lift = 0, 1;
    }
    m->lost += 1;
    if (m->touching && m->lost <= LATE) return 0;
    double once[sizeof(Settings) / sizeof(double)], lift = m->lift > 0 ? m->lift : FIRST_LIFT;
    memcpy(once, settings, sizeof once);
    if (m->lift > FIRST_LIFT && (long)m->lost % LOWER == 0) lift /= 2;
    for (int k = 0; k < DOUBLINGS; k++, lift *= 2) {
        update_patches(s, c->body, m, patches);
        ((Settings *)once)->again = k % 3 == 2; /* from rest, in small steps: slower, but surer */
        if ((status = attempt(c, once, lift, m->touching > 0, nodes, keep)) < 0) return status;
        if (status == CONVERGED) return m->lift = lift, 1;
    }
    m->lift = FIRST_LIFT, m->pause = PAUSE;
    return 0;
}

/* Update the patches after a solution: their bodies, loads, centers and sticking stiffness. The
   latter is updated if enough nodes differ from those of `touched` (3, count): patches of the nodes
   at the last sticking stiffness and at the last solution, and workspace. `shift` (slots, 2): see
   `find_middle`. Returns 1 if memory runs out. */
static int hold_again(const Membrane *f, const Bodies *bodies, const Scene *s, const Seen *seen, long line, const Given *g, const double *x,
                     const double *force, const double *found, const double *compliance, double *x_before, int32_t *touched, Memory *m,
                     Patch *patches, double *grip, Held *held, double *shift) {
    int32_t *was = touched + f->count, *owner = was + f->count;
    long differ = 0, count = 0, others = !m->gripped;
    find_owners(f, bodies, s, seen, line, x, force, m, patches, was, owner);
    m->touching = (double)find_loads(f, seen, line, x, force, found, s->slots, patches, owner);
    for (long k = 0; k < s->slots; k++) {
        Patch *p = patches + k;
        if (!p->touching) continue;
        find_middle(f, x, force, x_before, owner, was, (int32_t)(k + 1), p->middle, &p->radius, shift + 2 * k);
        p->normal = normal_stiffness(g, found, m->touching > 1 ? p->carried[2] / found[FORCE_Z] : 1, p);
        others |= !p->gripped;
    }
    for (long k = 0; k < f->count; k++) was[k] = owner[k], count += was[k] > 0, differ += was[k] != touched[k];
    memcpy(x_before, x, 2 * f->count * sizeof *x);
    if (!m->touching) memset(held->load, 0, 4 * f->count * sizeof *held->load);
    if (!m->touching || !(g->friction > 0) || !(others || differ > CHANGED * (double)count)) return 0;
    memcpy(touched, was, f->count * sizeof *was);
    return find_grip(f, x, compliance, s->slots, grip, held, m, patches);
}

/* Nodes of a sticking contact in turn: index of x in the compliance, limit of the load, N; load, N, and
   lag, m, along x and y. */
typedef struct { long at; double limit, load[2], lag[2]; } Node;

/* Move loads of nodes beyond Coulomb's limit to nodes within it, by projected Gauss-Seidel sweeps.
   `spacing`: length of a row of the compliance. A node within its limit lags behind its body by the
   remaining error only; the next call continues from it. */
static void redistribute(const double *compliance, long spacing, long count, Node *nodes) {
    double mean = 0;
    for (long a = 0; a < count; a++) mean += nodes[a].limit / (double)count;
    long changes = 1, work = 0;
    for (int sweep = 0; sweep < SWEEPS && changes && work < MAX_WORK; sweep++) {
        changes = 0;
        for (long a = 0; a < count; a++) {
            Node *n = nodes + a;
            const double *x = compliance + n->at * spacing, *y = x + spacing;
            const double xx = x[n->at], xy = x[n->at + 1], yy = y[n->at + 1], det = xx * yy - xy * xy;
            double next[2] = {n->load[0] + (yy * n->lag[0] - xy * n->lag[1]) / det, n->load[1] + (xx * n->lag[1] - xy * n->lag[0]) / det};
            const double size = hypot(next[0], next[1]), left = size > n->limit ? n->limit / size : 1;
            const double by[2] = {left * next[0] - n->load[0], left * next[1] - n->load[1]};
            if (fabs(by[0]) + fabs(by[1]) <= CLOSE_LOAD * mean) continue;
            changes++, work += count;
            for (int i = 0; i < 2; i++) n->load[i] += by[i];
            for (long c = 0; c < count; c++) {
                Node *other = nodes + c;
                other->lag[0] -= x[other->at] * by[0] + y[other->at] * by[1];
                other->lag[1] -= x[other->at + 1] * by[0] + y[other->at + 1] * by[1];
            }
        }
    }
}

/* Compute the load `shear` of each patch, and its sliding distance `slip` (slots, 2), m: the mean of
   its nodes, weighted by force. A patch slides if each of its nodes is at the limit. */
static void add_loads(const Membrane *f, const double *x, long count, Node *nodes, long slots, Held *h, Patch *patches, double *slip) {
    for (long s = 0; s < slots; s++) {
        Patch *p = patches + s;
        double weight = 0;
        memset(p->shear, 0, sizeof p->shear), p->slides = 0;
        slip[2 * s] = slip[2 * s + 1] = 0;
        long stuck = 0;
        for (long a = 0; a < count; a++) {
            Node *n = nodes + a;
            const long k = h->node[a];
            if (h->patch[k] != s + 1) continue;
            const double off[2] = {x_of(f, x, k) - p->middle[0], y_of(f, x, k) - p->middle[1]};
            const int is_stuck = hypot(n->load[0], n->load[1]) < (1 - AT_LIMIT) * n->limit;
            stuck += is_stuck, weight += n->limit;
            for (int i = 0; i < 2; i++) {
                for (int c = 0; c < 3; c++) p->shear[c] += rigid(c, i, off) * n->load[i];
                slip[2 * s + i] += n->limit * n->lag[i];
                h->load[i * f->count + k] = n->load[i];
                h->lag[i * f->count + k] = is_stuck ? n->lag[i] : 0;
            }
        }
        p->slides = p->touching && p->gripped > 0 && !stuck;
        for (int i = 0; i < 2; i++) slip[2 * s + i] = p->slides && weight > 0 ? slip[2 * s + i] / weight : 0;
    }
}

/* Move the patches by `along` (slots, 3) against the membrane, up to Coulomb's limit of each node for
   the forces `pressed` (slots). Return the sliding distance, m, of the mean of the patches weighted by
   force: parts of a soft body that are pressed apart slide in opposite directions. Returns -1 if
   memory runs out. */
static double stick(const Membrane *f, const Given *g, const double *compliance, const double *x, const double *force, long slots,
                    const double *pressed, const double *along, Held *h, Patch *patches) {
    double total = 0, mean[2] = {0};
    long count = 0;
    for (long s = 0; s < slots; s++)
        if (patches[s].touching) total += pressed[s];
    for (long i = 1; i < f->columns - 1; i++)
        for (long j = 1; j < f->rows - 1; j++)
            if (h->patch[i * f->rows + j]) h->node[count++] = (int32_t)(i * f->rows + j);
    double *slip = malloc(count * sizeof(Node) + 2 * slots * sizeof *slip);
    if (!slip) return -1;
    Node *nodes = (Node *)(slip + 2 * slots);
    for (long a = 0; a < count; a++) {
        const long k = h->node[a];
        const Patch *p = patches + h->patch[k] - 1;
        Node *n = nodes + a;
        n->at = inner_of(f, k);
        n->limit = p->touching && force[k] > 0 ? g->friction * force[k] * pressed[p - patches] / -p->carried[2] : 0;
        for (int i = 0; i < 2; i++) {
            n->load[i] = h->load[i * f->count + k], n->lag[i] = h->lag[i * f->count + k];
            for (long c = 0; c < 3 * slots; c++)
                if (along[c] != 0) n->load[i] += along[c] * h->unit[(2 * c + i) * f->count + k];
        }
    }
    redistribute(compliance, 2 * f->inner, count, nodes);
    add_loads(f, x, count, nodes, slots, h, patches, slip);
    for (long s = 0; s < slots; s++)
        for (int i = 0; i < 2 && total > 0; i++) mean[i] += pressed[s] / total * slip[2 * s + i];
    free(slip);
    return hypot(mean[0], mean[1]);
}

/* Sum up the patches in the state of the membrane. */
static void sum_patches(const Membrane *f, const double *x, const double *force, const int32_t *was, long slots, const Patch *patches,
                        Memory *m) {
    memset(m->wrench, 0, sizeof m->wrench), m->slides = 0, m->radius = 0;
    if (!m->touching) m->slid = 0;
    for (long s = 0; s < slots; s++) {
        const Patch *p = patches + s;
        if (!p->touching) continue;
        for (int i = 0; i < 6; i++) m->wrench[i] += p->wrench[i];
        m->slides = max_of(m->slides, p->slides);
        if (m->touching == 1) memcpy(m->middle, p->middle, sizeof m->middle), m->radius = p->radius;
    }
    double unused[2];
    if (m->touching > 1) find_middle(f, x, force, x, was, was, 0, m->middle, &m->radius, unused);
}

int64_t qs_follow(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                    const double *rest, int64_t roomy, double *room, const double *settings, int64_t geoms, double *body,
                    int64_t pooled, const double *pool, double *x, double *force, double *trend, double *found, const double *given,
                    const double *compliance, int64_t carrier, int64_t nbody, const double *xpos, const double *xmat, int64_t ngeom,
                    const double *geom_xpos, const double *geom_xmat, const int64_t *geom, const int64_t *slot,
                    const double *bounds, int64_t slots, const int64_t *body_of, double *memory, double *patch, double *grip,
                    int32_t *touched, double *before) {
    const Membrane padded = qs_membrane(numbers, law), f = plain(padded);
    const Given *g = (const Given *)given;
    Memory *m = (Memory *)memory;
    Patch *patches = (Patch *)patch;
    const Scene s = {geoms, slots, geom, slot, body_of, bounds, geom_xpos, geom_xmat, xpos, xmat, xmat + 9 * carrier, xpos + 3 * carrier,
                     f.numbers.depth};
    (void)nbody, (void)ngeom;
    Held held = {touched, before + 6 * f.count, before + 8 * f.count, before + 10 * f.count, touched + 2 * f.count};
    const int has_moved = update_patches(&s, body, m, patches);
    const int again = m->time == g->time; /* same time instant */
    /* a repeated update changes nothing */
    if (again && !has_moved && m->gas_observed == settings[0] && m->sealed_seen == settings[1]) return 0;
    m->gas_observed = settings[0], m->sealed_seen = settings[1];
    const int same_gas = m->gas == settings[0] && m->sealed == settings[1];
    m->solved = 0;
    if (!m->touching && same_gas && (!m->near || is_clear(&f, x, geoms, body, bounds))) return 0;
    m->time = g->time;
    double *own = malloc((6 + 2 + 3 + 2) * (slots + 1) * sizeof *own);
    if (!own) return NO_MEMORY;
    double *moved = own, *shift = moved + 6 * slots, *along = shift + 2 * slots, *further = along + 3 * slots, *pressed = further + slots;
    memset(own, 0, (6 + 2 + 3 + 2) * slots * sizeof *own);
    int still = m->touching > 0 && same_gas; /* 1: the last solution is kept */
    for (long k = 0; k < slots; k++) {
        Patch *p = patches + k;
        if (!p->near && !p->touching) {
            p->known = 0;
            continue;
        }
        static const double origin[3] = {0};
        double R_SB[9], p_SB[3], since[6] = {0};
        pose_of(&s, k, R_SB, p_SB);
        if (!again) memset(p->moved, 0, sizeof p->moved);
        if (p->touching) {
            motion(p->R, p->p, R_SB, p_SB, p->middle, moved + 6 * k);
            for (int i = 0; i < 3 && !again; i++) p->moved[i] = p_SB[i] - p->p[i], p->moved[3 + i] = moved[6 * k + 3 + i];
        }
        if (p->known) motion(p->R_rest, p->p_rest, R_SB, p_SB, p->touching ? p->middle : origin, since);
        const double way = fabs(since[0]) + fabs(since[1]) + fabs(since[2]) + LEVER * (fabs(since[3]) + fabs(since[4]) + fabs(since[5]));
        still &= p->near && p->known && way < CLOSE;
        further[k] = since[2];
        memcpy(p->R, R_SB, sizeof R_SB), memcpy(p->p, p_SB, sizeof p_SB);
    }
    int64_t code = 1;
    if (!still) {
        const Solution c = {numbers, law, columns, rows, keeping, kept, rest, roomy, room, geoms, body, pooled, pool, x, force, trend, found};
        if ((code = solve(&c, &s, settings, f.count, before + 2 * f.count, m, patches)) < 0) return free(own), code;
        if (code) {
            m->gas = settings[0], m->sealed = settings[1];
            for (long k = 0; k < slots; k++) {
                Patch *p = patches + k;
                if (!p->near) continue;
                memcpy(p->R_rest, p->R, sizeof p->R), memcpy(p->p_rest, p->p, sizeof p->p);
                p->known = 1, further[k] = 0;
            }
            const Bodies bodies = {geoms, body, pool, 0};
            const Seen seen = qs_lowest_before(&padded, &room);
            if (hold_again(&f, &bodies, &s, &seen, padded.line, g, x, force, found, compliance, before, touched, m, patches, grip, &held, shift))
                return free(own), NO_MEMORY;
        } else {
            for (long k = 0; k < slots; k++)
                if (patches[k].touching && !patches[k].near) release(patches + k), m->touching -= 1;
        }
        update_patches(&s, body, m, patches);
    }
    const double gas = g->gas > 0 ? 1 / (1 / g->gas + 1 / g->bulge) : 0;
    double displaced = 0;
    m->uncertain = 0;
    for (long k = 0; k < slots; k++)
        if (patches[k].touching) further[k] -= m->lift, displaced += patches[k].lifted * further[k];
    for (long k = 0; k < slots; k++) {
        const Patch *p = patches + k;
        if (!p->touching) continue;
        double added = p->normal * further[k];
        if (m->touching > 1) added += gas * p->lifted * (displaced - p->lifted * further[k]);
        pressed[k] = max_of(-p->carried[2] - added, 0);
        if (m->lost > 0) m->uncertain += fabs(pressed[k] + p->carried[2]);
        for (int i = 0; i < 2; i++) along[3 * k + i] = moved[6 * k + i] - shift[2 * k + i];
        along[3 * k + 2] = moved[6 * k + 5];
    }
    const double slip = stick(&f, g, compliance, x, force, slots, pressed, along, &held, patches);
    if (slip < 0) return free(own), NO_MEMORY;
    m->slid += slip;
    for (long k = 0; k < slots; k++) {
        Patch *p = patches + k;
        if (!p->touching) continue;
        memcpy(p->wrench, p->carried, sizeof p->wrench);
        const double added[3] = {p->shear[0], p->shear[1], -pressed[k] - p->carried[2]};
        double torque[3];
        across(p->middle, added, torque);
        torque[2] += p->shear[2];
        for (int i = 0; i < 3; i++) p->wrench[i] += added[i], p->wrench[3 + i] += torque[i];
    }
    sum_patches(&f, x, force, touched + f.count, slots, patches, m);
    free(own);
    return 0;
}
