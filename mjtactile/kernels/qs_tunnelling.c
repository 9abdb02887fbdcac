/* Check for obstacles that pass through the membrane between its nodes, where no node detects
   them. */
#include <math.h>

#include "qs_lowest_obstacle.h"
#include "qs_workspace.h"
#include "small_linalg.h"

#define BEHIND 1.5          /* distance behind the membrane, spacings */
#define BEHIND_UNSEEN 0.2
/* a cone of 45 degrees, whose force is at worst a third too small, is up to 0.6; steeper ones slip
   aside */
#define BEHIND_TIP 0.65

/* Return 1 if an obstacle is behind the membrane, by more than `behind` spacings, over a position
   in the cell of node `k`. The membrane is taken as flat there, and no obstacle is below
   `floor`. */
static int is_beyond_membrane(const Membrane *f, const Bodies *bodies, const double *x, const ContactNodes *seen, long k,
                              const double at[2], double floor, double behind) {
    const long corners[4] = {k, k + 1, k + f->line, k + f->line + 1};
    const double spacing = max_of(f->dx, f->dy);
    double height, slope[2], z = 0;
    int touches = 0;
    for (int c = 0; c < 4; c++) z += x[2 * f->count + corners[c]] / 4, touches |= seen->touching[corners[c]];
    if (z - floor <= BEHIND_UNSEEN * spacing) return 0;
    /* the rim is checked instead */
    if (f->uncut && f->uncut[k / f->line * f->rows + k % f->line] == 0) return 0;
    for (long i = -1; i <= 2 && !touches; i++)
        for (long j = -1; j <= 2; j++) {
            const long near = k + i * f->line + j;
            touches |= near >= 0 && near < f->count && seen->touching[near];
        }
    const double much = (touches ? behind : BEHIND_UNSEEN) * spacing;
    if (z - floor <= much || lowest(f, bodies, at[0], at[1], &height, slope)) return 0;
    return z - height > much;
}

/* Check the centers of the cells. */
static int penetrates_cell(const Membrane *f, const Bodies *bodies, const double *x, const ContactNodes *seen) {
    const long first = seen->box[2], last = (long)min_of(seen->box[3], f->rows - 1);
    double at_x[QS_MAX_LINE], at_y[QS_MAX_LINE], floor[QS_MAX_LINE];
    for (long i = seen->box[0]; i < min_of(seen->box[1], f->columns - 1); i++) {
        for (long j = first; j < last; j++) {
            const double *x0 = x + i * f->line + j, *x1 = x0 + f->line, *y0 = x0 + f->count, *y1 = x1 + f->count;
            at_x[j] = ((double)i + 0.5) * f->dx - f->numbers.length_x / 2 + (x0[0] + x0[1] + x1[0] + x1[1]) / 4;
            at_y[j] = ((double)j + 0.5) * f->dy - f->numbers.length_y / 2 + (y0[0] + y0[1] + y1[0] + y1[1]) / 4;
        }
        lower_bound_at(seen, last - first, at_x + first, at_y + first, floor + first);
        for (long j = first; j < last; j++) {
            const double at[2] = {at_x[j], at_y[j]};
            if (is_beyond_membrane(f, bodies, x, seen, i * f->line + j, at, floor[j], BEHIND)) return 1;
        }
    }
    return 0;
}

/* Check the ends of the obstacles. */
static int penetrates_at_end(const Membrane *f, const Bodies *bodies, const double *x, const ContactNodes *seen) {
    for (long b = 0; b < bodies->count; b++) {
        const Obstacle *one = qs_obstacle_at(bodies, b);
        const double half = one->kind == BODY_CAPSULE || one->kind == BODY_CYLINDER ? one->sizes[1] : 0;
        for (int end = half > 0 ? -1 : 1; end <= 1; end++) {
            const double at[2] = {one->p[0] + end * half * one->R[2], one->p[1] + end * half * one->R[5]};
            const double i = floor((at[0] + f->numbers.length_x / 2) / f->dx), j = floor((at[1] + f->numbers.length_y / 2) / f->dy);
            if (i < 0 || j < 0 || i > f->columns - 2 || j > f->rows - 2) continue;
            const double tip = BEHIND_TIP + f->numbers.half_thickness / max_of(f->dx, f->dy), behind = one->kind == BODY_CONE ? tip : BEHIND;
            double below;
            lower_bound_at(seen, 1, at, at + 1, &below);
            if (is_beyond_membrane(f, bodies, x, seen, (long)i * f->line + (long)j, at, below, behind)) return 1;
        }
    }
    return 0;
}

int penetrates_membrane(const Membrane *f, const Bodies *bodies, const double *x, const ContactNodes *seen) {
    return penetrates_cell(f, bodies, x, seen) || penetrates_at_end(f, bodies, x, seen);
}
