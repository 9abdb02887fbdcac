/* A quasi-static membrane in a moving scene: one update of its equilibrium and contact patches. Its
   forces on MuJoCo are in qs_joint_forces.c. Arrays: sim/sensor/quasistatic_sensor.py. Frame S unless
   a name contains W. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "qs_contact_patches.h"
#include "kernels.h"
#include "small_linalg.h"

/* obstacle motion up to which the last solution is kept, m; in between, the membrane is a linear
   spring */
#define CLOSE 8e-6
/* the same with several bodies in contact: side by side they take over each other's load, which a spring
   of each body does not include */
#define CLOSE_TOGETHER 1e-7
#define LEVER 0.01      /* lever arm that converts a rotation into a distance, m */

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
                     f.numbers.length_x / 2, f.numbers.length_y / 2, f.numbers.depth, f.numbers.roof};
    (void)nbody, (void)ngeom;
    Held held = {touched, before + 6 * f.count, before + 8 * f.count, before + 10 * f.count, touched + 2 * f.count};
    const int has_moved = qs_place_obstacles(&s, body, m, patches);
    const int again = m->time == g->time; /* same time instant */
    /* a repeated update changes nothing */
    if (again && !has_moved && m->gas_observed == settings[0] && m->sealed_seen == settings[1]) return 0;
    m->gas_observed = settings[0], m->sealed_seen = settings[1];
    const int same_gas = m->gas == settings[0] && m->sealed == settings[1];
    m->solved = 0;
    if (!m->touching && same_gas && (!m->near || qs_is_clear(&f, x, geoms, body, bounds))) return 0;
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
        qs_pose_of(&s, k, R_SB, p_SB);
        if (!again) memset(p->moved, 0, sizeof p->moved);
        if (p->touching) {
            motion(p->R, p->p, R_SB, p_SB, p->middle, moved + 6 * k);
            for (int i = 0; i < 3 && !again; i++) p->moved[i] = p_SB[i] - p->p[i], p->moved[3 + i] = moved[6 * k + 3 + i];
        }
        if (p->known) motion(p->R_rest, p->p_rest, R_SB, p_SB, p->touching ? p->middle : origin, since);
        const double way = fabs(since[0]) + fabs(since[1]) + fabs(since[2]) + LEVER * (fabs(since[3]) + fabs(since[4]) + fabs(since[5]));
        still &= p->near && p->known && way < (m->touching > 1 ? CLOSE_TOGETHER : CLOSE);
        further[k] = since[2];
        memcpy(p->R, R_SB, sizeof R_SB), memcpy(p->p, p_SB, sizeof p_SB);
    }
    int64_t code = 1;
    if (!still) {
        const Solution c = {numbers, law, columns, rows, keeping, kept, rest, roomy, room, geoms, body, pooled, pool, x, force, trend, found};
        if ((code = qs_solve_scene(&c, &s, settings, f.count, before + 2 * f.count, m, patches)) < 0) return free(own), code;
        if (code) {
            m->gas = settings[0], m->sealed = settings[1];
            for (long k = 0; k < slots; k++) {
                Patch *p = patches + k;
                if (!p->near) continue;
                memcpy(p->R_rest, p->R, sizeof p->R), memcpy(p->p_rest, p->p, sizeof p->p);
                p->known = 1, further[k] = 0;
            }
            const Bodies bodies = {geoms, body, pool, 0};
            const ContactNodes seen = qs_last_contact(&padded, &room);
            if (qs_update_patches(&f, &bodies, &s, &seen, padded.line, g, x, force, found, compliance, before, touched, m, patches, grip, &held, shift))
                return free(own), NO_MEMORY;
        } else {
            for (long k = 0; k < slots; k++)
                if (patches[k].touching && !patches[k].near) qs_release(patches + k), m->touching -= 1;
        }
        qs_place_obstacles(&s, body, m, patches);
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
    const double slip = qs_apply_friction(&f, g, compliance, x, force, slots, pressed, along, &held, patches);
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
    qs_sum_patches(&f, x, force, touched + f.count, slots, patches, m);
    free(own);
    return 0;
}
