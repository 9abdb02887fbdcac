/* Friction of a quasi-static membrane: sticking stiffness of its contact nodes, and Coulomb's limit
   of each. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "qs_friction.h"
#include "small_linalg.h"

/* sweeps over the loads of nodes at the friction limit, and work after which none starts, in pairs of
   nodes */
#define SWEEPS 8
#define MAX_WORK 8000
#define CLOSE_LOAD 1e-3 /* change of a load that is ignored, over the mean limit */
#define AT_LIMIT 1e-6   /* relative distance from the limit that is rounding error */

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

int qs_find_grip(const Membrane *f, const double *x, const double *compliance, long slots, double *grip, Held *h, Memory *m,
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
        const double off[2] = {qs_x_of(f, x, ka) - own->middle[0], qs_y_of(f, x, ka) - own->middle[1]};
        for (int c = 0; c < 3; c++) b[(loads + 1) * a + column[h->patch[ka] - 1] + c] = qs_rigid(c, a % 2, off);
        b[(loads + 1) * a + last] = displacement_of(f, compliance, h, ka, a % 2, lost, left);
    }
    factorize(n, A), solve_factorized(n, A, loads + 1, b);
    memset(grip, 0, 9 * slots * slots * sizeof *grip);
    memset(h->unit, 0, 6 * slots * f->count * sizeof *h->unit);
    memset(h->lag, 0, 2 * f->count * sizeof *h->lag);
    for (long i = 0; i < lost; i++) h->load[left[i]] = h->load[f->count + left[i]] = 0;
    for (long a = 0; a < n; a++) {
        const long k = node[a / 2], own = h->patch[k] - 1;
        const double off[2] = {qs_x_of(f, x, k) - patches[own].middle[0], qs_y_of(f, x, k) - patches[own].middle[1]};
        const double *row = b + (loads + 1) * a;
        h->load[a % 2 * f->count + k] += row[last];
        for (long t = 0; t < slots; t++)
            for (int d = 0; d < 3 && column[t] >= 0; d++) {
                const double by = row[column[t] + d];
                h->unit[(2 * (3 * t + d) + a % 2) * f->count + k] = by;
                for (int c = 0; c < 3; c++) grip[(3 * own + c) * 3 * slots + 3 * t + d] += qs_rigid(c, a % 2, off) * by;
            }
    }
    m->gripped = (double)count;
    free(A), free(node);
    return 0;
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
            const double off[2] = {qs_x_of(f, x, k) - p->middle[0], qs_y_of(f, x, k) - p->middle[1]};
            const int is_stuck = hypot(n->load[0], n->load[1]) < (1 - AT_LIMIT) * n->limit;
            stuck += is_stuck, weight += n->limit;
            for (int i = 0; i < 2; i++) {
                for (int c = 0; c < 3; c++) p->shear[c] += qs_rigid(c, i, off) * n->load[i];
                slip[2 * s + i] += n->limit * n->lag[i];
                h->load[i * f->count + k] = n->load[i];
                h->lag[i * f->count + k] = is_stuck ? n->lag[i] : 0;
            }
        }
        p->slides = p->touching && p->gripped > 0 && !stuck;
        for (int i = 0; i < 2; i++) slip[2 * s + i] = p->slides && weight > 0 ? slip[2 * s + i] / weight : 0;
    }
}

double qs_apply_friction(const Membrane *f, const Given *g, const double *compliance, const double *x, const double *force, long slots,
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
