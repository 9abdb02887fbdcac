/* Approximate response of a membrane in equilibrium to changes of its obstacles: one height
   step. */
#include <math.h>
#include <string.h>

#include "qs_step.h"
#include "kernels.h"

/* Prepare a height step of a membrane in equilibrium on obstacles: everything except the change of
   the obstacles. */
static int start_response(const Membrane *f, const Settings *set, const Bodies *bodies, Work *w) {
    const double *z = w->x + 2 * f->count;
    mark_contact(f, w->force, &w->seen), limit_to_contact(f, bodies, &w->seen);
    w->heights.first = f->lopsided ? 0 : f->columns, w->heights.last = f->lopsided ? f->columns - 1 : -1;
    update_obstacles(f, bodies, 0, 0, w), widen_window(f, 0, w);
    update_membrane(f, set, QS_HEIGHTS, w);
    find_springs(f, z, &w->seen), stiffen_edges(f, z, 1, w);
    memset(w->residual + 2 * f->count, 0, f->count * sizeof *w->residual);
    return prepare_heights(f, z, w);
}

int64_t qs_approximate_sensitivities(const double *numbers, const double *law, int64_t columns, int64_t rows, int64_t keeping, const float *kept,
                    int64_t roomy, double *room, const double *settings, int64_t bodies, int64_t changes, const double *body,
                    int64_t pooled, const double *pool, const double *steps, const double *x, const double *force, double *by_z,
                    double *by_force) {
    const Membrane f = qs_membrane(numbers, law);
    if (columns != f.columns || rows != f.rows || f.line > QS_MAX_LINE || keeping < qs_factors_size(numbers)) return REFUSED;
    if (roomy < qs_workspace_size_of(&f)) return REFUSED;
    (void)pooled;
    const long n = f.count, nodes = columns * rows;
    const RestHeights at_rest = qs_heights_at(&f, (float *)kept);
    const Bodies base = {bodies, body, pool, 0};
    Work w = qs_work_in(&f, &at_rest, kept + qs_normal_size(&f), room);
    ContactNodes *s = &w.seen;
    qs_pad(&f, 3, x, w.x), qs_pad(&f, 1, force, w.force);
    if (start_response(&f, (const Settings *)settings, &base, &w)) return NOT_DEFINITE;
    const double *z = w.x + 2 * n;
    double *was = w.fine.elastic;
    for (long k = 0; k < n; k++) was[k] = s->obstacle[k] - s->lower[k];
    for (long a = 0; a < changes; a++) {
        const Bodies changed = {bodies, body + (1 + a) * bodies * QS_OBSTACLE, pool, 0};
        update_obstacles(&f, &changed, 0, 0, &w);
        for (long k = 0; k < n; k++) {
            const double rise = (s->obstacle[k] - s->lower[k] - was[k]) / steps[a];
            /* the step begins at the present heights */
            s->obstacle[k] = z[k] + (isfinite(rise) ? rise : 0), s->lower[k] = 0;
        }
        step_heights(&f, z, a == 0, &w);
        for (long i = 0; i < columns; i++)
            for (long j = 0; j < rows; j++) {
                const long to = a * nodes + i * rows + j, from = i * f.line + j;
                by_z[to] = (double)w.moved[from], by_force[to] = (double)w.pushed[from];
            }
    }
    return 0;
}
