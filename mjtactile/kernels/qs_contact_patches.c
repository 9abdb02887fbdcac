/* Contact patches of a quasi-static membrane after a solution: nodes, loads, centers and stiffness of
   each body. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "qs_contact_patches.h"
#include "qs_lowest_obstacle.h"
#include "small_linalg.h"

/* fraction of contact nodes that may change before the sticking stiffness is computed again */
#define CHANGED 0.1

/* Patches of the nodes in contact, plus one, and the next patch over each node's cell with the
   `fraction` of the cell that lies under it (count). */
typedef struct { int32_t *owner, *other; double *fraction; } Owners;

/* Return the fraction of a node's force that acts on the patch `label` (0: all). */
static double part_of(const Owners *o, long k, int32_t label) {
    if (!o->owner[k]) return 0;
    if (!label) return 1;
    return o->owner[k] == label ? 1 - o->fraction[k] : o->other[k] == label ? o->fraction[k] : 0;
}

/* Compute center and radius of the contact of the patch `label` (0: all), and the in-plane
   displacement `shift` (2) of its nodes since the last solution. */
static void find_middle(const Membrane *f, const double *x, const double *force, const double *x_before, const Owners *o,
                        const int32_t *before, int32_t label, double middle[3], double *mean_radius, double shift[2]) {
    double sum[3] = {0}, total = 0, kept = 0;
    shift[0] = shift[1] = 0;
    for (long k = 0; k < f->count; k++) {
        const double own = force[k] * part_of(o, k, label);
        if (!(own > 0)) continue;
        total += own;
        sum[0] += own * qs_x_of(f, x, k);
        sum[1] += own * qs_y_of(f, x, k);
        sum[2] += own * x[2 * f->count + k];
        if (!before[k]) continue;
        kept += own;
        for (int c = 0; c < 2; c++) shift[c] += own * (x[c * f->count + k] - x_before[c * f->count + k]);
    }
    for (int c = 0; c < 3; c++) middle[c] = sum[c] / total;
    for (int c = 0; c < 2; c++) shift[c] = kept > 0 ? shift[c] / kept : 0;
    double radius = 0;
    for (long k = 0; k < f->count; k++)
        radius += force[k] * part_of(o, k, label) * hypot(qs_x_of(f, x, k) - middle[0], qs_y_of(f, x, k) - middle[1]);
    *mean_radius = radius / total;
}

void qs_release(Patch *p) {
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

/* Compute the fraction of a node's cell that lies under another patch than `slot`. The force of a node
   moves gradually from one body to the next as their border crosses the cell: a jump would excite
   oscillations of both. The difference of their heights is linear over the cell. */
static double fraction_of_other(const Membrane *f, const Bodies *bodies, const Scene *s, const double at[2], long slot, int32_t *other) {
    double own = INFINITY, next = INFINITY, slope[2] = {0}, by[2] = {0};
    *other = 0;
    for (long b = 0; b < bodies->count; b++) {
        double height, here[2];
        if (qs_obstacle_height(f, qs_obstacle_at(bodies, b), bodies->pool, at[0], at[1], &height, here) || height > f->numbers.roof) continue;
        if (s->slot[b] == slot && height < own) own = height, memcpy(slope, here, sizeof slope);
        if (s->slot[b] != slot && height < next) next = height, memcpy(by, here, sizeof by), *other = (int32_t)(s->slot[b] + 1);
    }
    if (!isfinite(own) || !*other) return *other = 0, 0;
    const double range = fabs(by[0] - slope[0]) * f->dx + fabs(by[1] - slope[1]) * f->dy;
    return range > 0 ? clip(0.5 - (next - own) / range, 0, 1) : 0;
}

/* Find the patch of each node in contact, plus one. `line`: padded length of a grid line. */
static void find_owners(const Membrane *f, const Bodies *bodies, const Scene *s, const ContactNodes *seen, long line, const double *x,
                        const double *force, const Memory *m, const Patch *patches, const int32_t *before, Owners *o) {
    int32_t *owner = o->owner;
    long only = -1;
    for (long k = 0; k < s->slots; k++)
        if (patches[k].near) only = k;
    for (long k = 0; k < f->count; k++) {
        owner[k] = o->other[k] = 0, o->fraction[k] = 0;
        if (!(force[k] > 0)) continue;
        owner[k] = (int32_t)(only + 1);
        if (m->near < 2) continue;
        const long padded = k / f->rows * line + k % f->rows;
        const double at[2] = {qs_x_of(f, x, k) + seen->away[padded], qs_y_of(f, x, k) + seen->away[f->columns * line + padded]};
        const long on = obstacle_under(f, bodies, at);
        if (on >= 0) owner[k] = (int32_t)(s->slot[on] + 1);
        else if (before[k]) owner[k] = before[k];
        o->fraction[k] = fraction_of_other(f, bodies, s, at, owner[k] - 1, o->other + k);
    }
}

/* Add up the frictionless wrench of each patch, and release those without contact. Returns the
   number of patches in contact. */
static long find_loads(const Membrane *f, const ContactNodes *seen, long line, const double *x, const double *force, const double *found,
                       long slots, Patch *patches, const Owners *o) {
    long count = 0, last = -1;
    for (long s = 0; s < slots; s++) memset(patches[s].carried, 0, sizeof patches[s].carried);
    for (long k = 0; k < f->count; k++) {
        if (!o->owner[k]) continue;
        const long padded = k / f->rows * line + k % f->rows;
        const double r[3] = {qs_x_of(f, x, k), qs_y_of(f, x, k), x[2 * f->count + k]};
        const double F[3] = {force[k] * seen->slope[padded], force[k] * seen->slope[f->columns * line + padded], -force[k]};
        double torque[3];
        across(r, F, torque);
        for (int next = 0; next < 2; next++) {
            const int32_t label = next ? o->other[k] : o->owner[k];
            const double part = part_of(o, k, label);
            for (int c = 0; c < 3 && label; c++) patches[label - 1].carried[c] += part * F[c], patches[label - 1].carried[3 + c] += part * torque[c];
        }
    }
    for (long s = 0; s < slots; s++) {
        Patch *p = patches + s;
        if (!(-p->carried[2] > QS_LEAST)) {
            qs_release(p);
            continue;
        }
        if (!p->touching) qs_release(p);
        p->touching = 1, count++, last = s;
    }
    for (long k = 0; k < f->count; k++)
        if (o->owner[k] && !patches[o->owner[k] - 1].touching) o->owner[k] = 0;
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

int qs_update_patches(const Membrane *f, const Bodies *bodies, const Scene *s, const ContactNodes *seen, long line, const Given *g,
                      const double *x, const double *force, const double *found, const double *compliance, double *x_before,
                      int32_t *touched, Memory *m, Patch *patches, double *grip, Held *held, double *shift) {
    int32_t *was = touched + f->count, *owner = was + f->count;
    long differ = 0, count = 0, others = !m->gripped;
    double *fraction = malloc(f->count * (sizeof *fraction + sizeof(int32_t)));
    if (!fraction) return 1;
    Owners o = {owner, (int32_t *)(fraction + f->count), fraction};
    find_owners(f, bodies, s, seen, line, x, force, m, patches, was, &o);
    m->touching = (double)find_loads(f, seen, line, x, force, found, s->slots, patches, &o);
    for (long k = 0; k < s->slots; k++) {
        Patch *p = patches + k;
        if (!p->touching) continue;
        find_middle(f, x, force, x_before, &o, was, (int32_t)(k + 1), p->middle, &p->radius, shift + 2 * k);
        p->normal = normal_stiffness(g, found, m->touching > 1 ? p->carried[2] / found[FORCE_Z] : 1, p);
        others |= !p->gripped;
    }
    free(fraction);
    for (long k = 0; k < f->count; k++) was[k] = owner[k], count += was[k] > 0, differ += was[k] != touched[k];
    memcpy(x_before, x, 2 * f->count * sizeof *x);
    if (!m->touching) memset(held->load, 0, 4 * f->count * sizeof *held->load);
    if (!m->touching || !(g->friction > 0) || !(others || differ > CHANGED * (double)count)) return 0;
    memcpy(touched, was, f->count * sizeof *was);
    return qs_find_grip(f, x, compliance, s->slots, grip, held, m, patches);
}

void qs_sum_patches(const Membrane *f, const double *x, const double *force, const int32_t *was, long slots, const Patch *patches,
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
    const Owners all = {(int32_t *)was, 0, 0};
    if (m->touching > 1) find_middle(f, x, force, x, &all, was, 0, m->middle, &m->radius, unused);
}
