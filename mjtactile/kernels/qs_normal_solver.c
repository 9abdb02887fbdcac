#include "qs_normal_solver.h"

#include <math.h>
#include <string.h>

#include "band_cholesky_f32.h"
#include "small_linalg.h"

#define SHELL 0.3
#define MIN_SCALE 0.1f

/* a line is a whole number of panels, and reaches the next */
static long height_of(const Membrane *f) { return f->line + PANEL; }

long qs_normal_size(const Membrane *f) { return 8 + f->count * height_of(f) + f->count * f->line; }

RestHeights qs_heights_at(const Membrane *f, float *kept) {
    return (RestHeights){.tension = kept, .factor = kept + 8, .left = kept + 8 + f->count * height_of(f)};
}

long qs_normal_workspace_size(const Membrane *f) { return f->count * height_of(f) + 6 * (f->count + height_of(f)); }

Heights qs_normal_in(const Membrane *f, const RestHeights *rest, float **room) {
    Heights h = {.rest = rest, .stride = f->count + height_of(f), .scale = 1};
    h.window = *room, h.solved = h.window + f->count * height_of(f), h.mirrored = h.solved + 3 * h.stride;
    *room = h.mirrored + 3 * h.stride;
    memset(h.solved, 0, 6 * h.stride * sizeof *h.solved);
    return h;
}

/* Return the additional stiffness of a curved membrane against further bending. It must stretch, as
   a shell does: Y (k_x l_y^2 + k_y l_x^2)^2 for a wave (l_x, l_y) of length one on curvatures k.
   Here it is the mean over all waves. It accelerates convergence and does not affect the result. */
static double shell_at(const Membrane *f, const double *z, long k) {
    const double bend_x = (z[k + f->line] + z[k - f->line] - 2 * z[k]) / square(f->dx);
    const double bend_y = (z[k + 1] + z[k - 1] - 2 * z[k]) / square(f->dy);
    return SHELL * f->numbers.shell * f->dx * f->dy * (square(bend_x) + square(bend_y)) / 2;
}

/* Factors of the terms in line `i` of the stiffness: its links to the lines before and behind it,
   and its own terms. `block` holds its panels. A node that is fixed or in contact has a row and a
   column of its own. */
typedef struct { double before, behind, own; } Shares;

static int is_free(const Membrane *f, const uint8_t *touching, long i, long j) {
    return qs_free(f, i, j) && !touching[i * f->line + j];
}

static void put_line(const Membrane *f, const double *z, const ContactNodes *seen, long i, Shares fraction, int last, float *block) {
    const long line = f->line, height = height_of(f);
    memset(block, 0, line * height * sizeof *block);
    for (long j = 0; j < line; j++) {
        const long k = i * line + j, down = j / PANEL * PANEL;
        float *column = block + j * height;
        if (!is_free(f, seen->touching, i, j)) {
            column[j - down] = 1;
            continue;
        }
        const double sides = seen->along_y[k] + seen->along_y[k - 1] + shell_at(f, z, k);
        column[j - down] = (float)(fraction.before * seen->along_x[k - line] + fraction.behind * seen->along_x[k] + fraction.own * sides);
        if (is_free(f, seen->touching, i, j + 1)) column[j + 1 - down] = (float)(-fraction.own * seen->along_y[k]);
        if (!last && is_free(f, seen->touching, i + 1, j)) column[line + j - down] = (float)-seen->along_x[k];
    }
}

int qs_normal_remainder(const Membrane *f, const double *x, const MembraneFields *fields, RestHeights *rest) {
    const long line = f->line, height = height_of(f), per_line = line / PANEL;
    const double *z = x + 2 * f->count;
    uint8_t no_contact[f->count];
    memset(no_contact, 0, f->count);
    const ContactNodes seen = {.along_x = fields->along_x, .along_y = fields->along_y, .touching = no_contact};
    memset(fields->along_x, 0, f->count * sizeof *fields->along_x), memset(fields->along_y, 0, f->count * sizeof *fields->along_y);
    *rest->tension = (float)qs_elastic(f, x, QS_ALL, 0, f->columns - 1, fields).tension;
    for (long i = 0; i < f->columns; i++) put_line(f, z, &seen, i, (Shares){1, 1, 1}, i == f->columns - 1, rest->factor + i * line * height);
    for (long i = 0; i < f->columns; i++) {
        float *block = rest->factor + i * line * height, *left = rest->left + i * line * line;
        memset(left, 0, line * line * sizeof *left);
        for (long j = 0; j < line; j++) {
            if (!is_free(f, no_contact, i, j)) continue;
            const long k = i * line + j, down = j / PANEL * PANEL;
            for (long r = j; r < line; r++) left[j * line + r] = block[j * height + r - down];
            left[j * line + j] -= (float)(fields->along_x[k] + (fields->along_y[k] + fields->along_y[k - 1] + shell_at(f, z, k)) / 2);
            if (qs_free(f, i, j + 1)) left[j * line + j + 1] += (float)(fields->along_y[k] / 2);
        }
        for (long r = f->rows - 1; r < line; r++)
            for (long j = 0; j < line; j++) left[j * line + r] = 0;
        const long behind = (f->columns - 1 - i) * per_line;
        if (panels_factor(per_line, behind, height, block)) return 1;
    }
    return 0;
}

int qs_normal_factor(const Membrane *f, const double *z, const ContactNodes *seen, Heights *h) {
    const long line = f->line, height = height_of(f), first = h->first, last = h->last;
    const int at_left = first > 0, at_right = last < f->columns - 1;
    h->scale = h->scale > MIN_SCALE ? h->scale : MIN_SCALE;
    for (long i = first; i <= last; i++) {
        const int left = at_left && i == first, right = at_right && i == last;
        const Shares fraction = {.before = !left, .behind = !right, .own = 1};
        put_line(f, z, seen, i, fraction, i == last, h->window + (i - first) * line * height);
    }
    for (int side = 0; side < 2; side++) {
        if (!(side ? at_right : at_left)) continue;
        const long i = side ? last : first;
        float *block = h->window + (i - first) * line * height;
        const float *left = h->rest->left + (side ? f->columns - 1 - i : i) * line * line;
        for (long j = 1; j < f->rows - 1; j++)
            for (long r = j; r < f->rows - 1; r++) {
                const long from = side ? (f->rows - 1 - r) * line + f->rows - 1 - j : j * line + r;
                block[j * height + r - j / PANEL * PANEL] += h->scale * left[from];
            }
    }
    return panels_factor((last - first + 1) * line / PANEL, 0, height, h->window);
}

/* Rotate line `i` of all right-hand sides by half a turn, to or from its place in `mirrored`. */
static void turn_line(const Membrane *f, const Heights *h, int many, long i, int back, int adds) {
    for (int m = 0; m < many; m++) {
        float *one = h->solved + m * h->stride + i * f->line;
        float *other = h->mirrored + m * h->stride + (f->columns - 1 - i) * f->line;
        for (long j = 0; j < f->rows; j++) {
            if (!back) other[f->rows - 1 - j] = one[j];
            else one[j] = (adds ? one[j] : 0) + other[f->rows - 1 - j];
        }
    }
}

static void scale(long n, int many, long stride, float by, float *x) {
    for (int m = 0; m < many; m++)
        for (long k = 0; k < n; k++) x[m * stride + k] *= by;
}

void qs_normal_solve(const Membrane *f, int many, Heights *h) {
    const long line = f->line, per_line = line / PANEL, height = height_of(f), first = h->first, last = h->last;
    const long behind = f->columns - 1 - last, stride = h->stride;
    const float *rest = h->rest->factor, over = 1 / h->scale;
    float *window = h->solved + first * line;
    panels_forward(first * per_line, height, rest, many, stride, h->solved);
    for (long i = last + 1; i < f->columns; i++) turn_line(f, h, many, i, 0, 0);
    for (int m = 0; m < many; m++) memset(h->mirrored + m * stride + behind * line, 0, line * sizeof *h->mirrored);
    panels_forward(behind * per_line, height, rest, many, stride, h->mirrored);
    if (behind) turn_line(f, h, many, last, 1, 1);
    panels_forward((last - first + 1) * per_line, height, h->window, many, stride, window);
    panels_backward((last - first + 1) * per_line, height, h->window, many, stride, window);
    scale(first * line, many, stride, over, h->solved), scale(behind * line, many, stride, over, h->mirrored);
    panels_backward(first * per_line, height, rest, many, stride, h->solved);
    turn_line(f, h, many, last, 0, 0);
    panels_backward(behind * per_line, height, rest, many, stride, h->mirrored);
    for (long i = last + 1; i < f->columns; i++) turn_line(f, h, many, i, 1, 0);
}

void qs_normal_times(const Membrane *f, const double *z, const ContactNodes *seen, const Heights *h, int touching, const float *what,
                     float *out) {
    const long line = f->line;
    for (long i = max_of(h->first, 1); i <= min_of(h->last, f->columns - 2); i++)
        for (long k = i * line + 1; k < i * line + f->rows - 1; k++) {
            if (seen->touching[k] != touching || (f->inside && !qs_free(f, i, k - i * line))) continue;
            double sum = shell_at(f, z, k) * what[k];
            sum += seen->along_x[k] * (what[k] - what[k + line]) + seen->along_x[k - line] * (what[k] - what[k - line]);
            sum += seen->along_y[k] * (what[k] - what[k + 1]) + seen->along_y[k - 1] * (what[k] - what[k - 1]);
            out[k] = (float)sum;
        }
}
