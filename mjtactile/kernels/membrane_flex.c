/* Membrane computations before every MuJoCo step: gas volume, rubber, and contact with memory.
   Equations: docstrings of chamber.py, rubber_flex.py,
   curvature_standoff.py and stiction.py in sim/sensor. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"

#define ROW 21          /* entries of a triangle in MuJoCo's `flex_stiffness` */
#define FLATTEST 1e-2   /* minimum of det C: a collapsing triangle keeps a finite stress */
#define UNSTRAINED 1e-6 /* tr E below which the moduli are those without strain */
#define SMALLEST 1e-24  /* replaces zero in a denominator or under a root */

/* Return 1 if all numbers are valid indices below `limit`. */
static int are_below(int64_t limit, int64_t count, const int64_t *numbers) {
    for (int64_t i = 0; i < count; i++)
        if (numbers[i] < 0 || numbers[i] >= limit) return 0;
    return 1;
}

int64_t chamber_volume(int64_t n, const double *p, int64_t m, const int64_t *triangles, double *gradient, double *volume) {
    double sum = 0;
    if (!are_below(n, 3 * m, triangles)) return REFUSED;
    memset(gradient, 0, 3 * n * sizeof *gradient);
    for (const int64_t *t = triangles; t < triangles + 3 * m; t += 3) {
        const double *a = p + 3 * t[0], *b = p + 3 * t[1], *c = p + 3 * t[2];
        double u[3], w[3];
        for (int i = 0; i < 3; i++) u[i] = b[i] - a[i], w[i] = c[i] - a[i];
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            double area = 0.5 * (u[j] * w[k] - u[k] * w[j]);
            sum += (a[i] + b[i] + c[i]) * area / 9;
            for (int corner = 0; corner < 3; corner++) gradient[3 * t[corner] + i] += area / 3;
        }
    }
    *volume = sum;
    return 0;
}

void apply_gas_load(int64_t k, const double *gradient, const double *moved, double offset_fraction, double min_offset, double pressure,
                    double stiffness, double *coefficients, double *spring, double *rest, double *forces) {
    double length = 0, size = 0;
    for (int64_t v = 0; v < k; v++) {
        double normal = gradient[3 * v + 2], term = normal * moved[3 * v + 2];
        coefficients[v] = normal, length += term, size += fabs(term);
        for (int i = 0; i < 3; i++) forces[3 * v + i] = pressure * gradient[3 * v + i];
    }
    double offset = offset_fraction * (size + min_offset);
    for (int64_t v = 0; v < k; v++) forces[3 * v + 2] += stiffness * offset * coefficients[v];
    spring[0] = stiffness, rest[0] = rest[1] = length - offset;
}

/* Fields of MuJoCo's contacts, which are read in place (sim/sensor/contact_list.py), in the order
   of `layout`. */
enum { STRIDE, DIST, MARGIN, FRAME, FRICTION, DIM, GEOMS, FLEXES, FIRST_ROW };

typedef struct { double dist, margin; const double *frame, *friction; const int32_t *geoms, *flexes; int32_t dim, row; } Contact;

static Contact contact_of(int64_t k, int64_t list, const int64_t *layout) {
    const char *at = (const char *)(intptr_t)list + k * layout[STRIDE];
#define FIELD(type, name) ((const type *)(at + layout[name]))
    return (Contact){*FIELD(double, DIST), *FIELD(double, MARGIN), FIELD(double, FRAME), FIELD(double, FRICTION),
                     FIELD(int32_t, GEOMS), FIELD(int32_t, FLEXES), *FIELD(int32_t, DIM), *FIELD(int32_t, FIRST_ROW)};
#undef FIELD
}

/* Return the number of a contact's force rows: one along the normal, two along the surface. Rows of
   torques behind them are not used. */
static int force_rows(const Contact *c) { return c->dim < 3 ? c->dim : 3; }

int64_t membrane_loads(int64_t contacts, int64_t list, const int64_t *layout, int64_t rows, const double *force, int64_t n,
                       const int64_t *membranes, double *loads) {
    memset(loads, 0, 3 * n * sizeof *loads);
    for (int64_t k = 0; k < contacts; k++) {
        const Contact c = contact_of(k, list, layout);
        if (c.row >= 0 && c.row + force_rows(&c) > rows) return REFUSED;
        for (int64_t m = 0; m < n && c.row >= 0; m++) {
            const int64_t *own = membranes + 3 * m;
            int side[2];
            for (int e = 0; e < 2; e++) side[e] = (c.geoms[e] >= own[0] && c.geoms[e] <= own[1]) || c.flexes[e] == own[2];
            if (!side[0] && !side[1]) continue;
            /* MuJoCo's force acts on the second geom; the rows of `frame` are its axes */
            double sign = side[1] ? 1 : -1;
            for (int axis = 0; axis < force_rows(&c); axis++)
                for (int i = 0; i < 3; i++) loads[3 * m + i] += sign * force[c.row + axis] * c.frame[3 * axis + i];
        }
    }
    return 0;
}

/* Return c / det C, with the squared thickness stretch c. ln c comes from two Newton steps:
   core/neo_hookean.py. */
static double thickness_over_area(double log_det, double poisson) {
    double half = poisson / (1 - 2 * poisson), x = log_det * (-poisson / (1 - poisson));
    for (int i = 0; i < 2; i++) {
        double c = exp(x);
        x -= (c - 1 + half * (x + log_det)) / (c + half);
    }
    return exp(x - log_det);
}

int64_t rubber_stiffness(int64_t m, const int64_t *edges, int64_t e, const int64_t *ends, int64_t n, const double *p,
                         const double *metric, const double *law, const double *by_mu, const double *by_lambda, double *thin,
                         double *rows) {
    if (!are_below(e, 3 * m, edges) || !are_below(n, 2 * e, ends)) return REFUSED;
    double shear = law[0], poisson = law[1], first = law[2], min_ratio = law[3], max_ratio = law[4];
    for (int64_t t = 0; t < m; t++) {
        double C[3] = {0}, mu, lambda = first;
        for (int side = 0; side < 3; side++) {
            const int64_t *end = ends + 2 * edges[3 * t + side];
            double square = 0;
            for (int i = 0; i < 3; i++) {
                double along = p[3 * end[1] + i] - p[3 * end[0] + i];
                square += along * along;
            }
            for (int i = 0; i < 3; i++) C[i] += metric[9 * t + 3 * i + side] * square;
        }
        double trace = (C[0] + C[1]) / 2 - 1;
        thin[t] = thickness_over_area(log(fmax(C[0] * C[1] - C[2] * C[2], FLATTEST)), poisson);
        mu = shear * thin[t];
        if (!(fabs(trace) < UNSTRAINED))
            lambda = fmin(fmax((shear - mu * (1 + 2 * trace)) / trace, min_ratio * mu), max_ratio * first);
        for (int i = 0; i < 6; i++) rows[ROW * t + i] = mu * by_mu[6 * t + i] + lambda * by_lambda[6 * t + i];
    }
    return 0;
}

/* Return the energy W over the shear modulus of neo-Hookean rubber at C11, C22, C12:
   core/neo_hookean.py. `q` = c / det C. */
static double energy(const double *C, double q, double poisson) {
    double det = fmax(C[0] * C[1] - C[2] * C[2], FLATTEST), c = q * det, log_volume = log(c * det) / 2;
    return (C[0] + C[1] + c - 3 - 2 * log_volume) / 2 + poisson / (1 - 2 * poisson) * log_volume * log_volume;
}

int64_t viscoelastic_forces(int64_t m, const int64_t *triangles, int64_t n, const double *p, const double *inverse, const double *section,
                            const double *law, const double *thin, int64_t terms, const double *shares, const double *kept, double *memory,
                            double *max_energy, double *work, int64_t k, const int64_t *interior, double *rows, double *forces) {
    if (!are_below(n, 3 * m, triangles) || !are_below(n, k, interior)) return REFUSED;
    double shear = law[0], poisson = law[1], stretch2 = law[2], softening = law[3], softening_energy = law[4], quick = 1;
    double *slopes = work, *stress = work + 6 * m, *faded = work + 9 * m, *load = work + 12 * m;
    for (int64_t i = 0; i < terms; i++) quick += shares[i];
    for (int64_t t = 0; t < m; t++) {
        const int64_t *corner = triangles + 3 * t;
        const double *in = inverse + 4 * t;
        double *g = slopes + 6 * t, C[3] = {0}, by = shear;
        for (int x = 0; x < 3; x++) {
            double a = p[3 * corner[0] + x], u = p[3 * corner[1] + x] - a, w = p[3 * corner[2] + x] - a;
            for (int i = 0; i < 2; i++) g[3 * i + x] = in[2 * i] * u + in[2 * i + 1] * w;
            C[0] += stretch2 * g[x] * g[x], C[1] += stretch2 * g[3 + x] * g[3 + x], C[2] += stretch2 * g[x] * g[3 + x];
        }
        double q = thin ? thin[t] : thickness_over_area(log(fmax(C[0] * C[1] - C[2] * C[2], FLATTEST)), poisson);
        if (softening > 0) { /* the energy is needed only for softening */
            double W = shear * energy(C, q, poisson);
            max_energy[t] = fmax(max_energy[t], W), by *= 1 - softening * erf((max_energy[t] - W) / softening_energy);
        }
        stress[t] = by * (1 - q * C[1]), stress[m + t] = by * (1 - q * C[0]), stress[2 * m + t] = by * q * C[2];
        if (rows)
            for (int i = 0; i < 6; i++) rows[ROW * t + i] *= quick * by / shear;
    }
    memset(faded, 0, 3 * m * sizeof *faded);
    for (int64_t j = 0; j < 3 * m; j++) {
        double mean = (memory[j] + stress[j]) / 2;
        memory[j] = stress[j], stress[j] = mean;
    }
    for (int64_t i = 0; i < terms; i++) {
        double *restrict r = memory + 3 * m * (i + 1), left = kept[i], gained = (1 - left) * shares[i];
        for (int64_t j = 0; j < 3 * m; j++) r[j] = left * r[j] + gained * stress[j], faded[j] += r[j];
    }
    memset(load, 0, 3 * n * sizeof *load);
    for (int64_t t = 0; t < m; t++) {
        const int64_t *corner = triangles + 3 * t;
        const double *in = inverse + 4 * t, *g = slopes + 6 * t;
        double along = section[t] * faded[t], across = section[t] * faded[m + t], both = section[t] * faded[2 * m + t];
        for (int x = 0; x < 3; x++) {
            double one = along * g[x] + both * g[3 + x], two = both * g[x] + across * g[3 + x];
            double u = in[0] * one + in[2] * two, w = in[1] * one + in[3] * two;
            load[3 * corner[1] + x] += u, load[3 * corner[2] + x] += w, load[3 * corner[0] + x] -= u + w;
        }
    }
    for (int64_t v = 0; v < k; v++)
        for (int i = 0; i < 3; i++) forces[3 * v + i] += load[3 * interior[v] + i];
    return 0;
}

enum { SPHERE = 2, CAPSULE = 3, ELLIPSOID = 4, CYLINDER = 5 }; /* MuJoCo's mjtGeom */

/* Return the sum of a geom's principal curvatures, 1/m, where its surface has the unit normal n, in
   its frame. */
static double curvature(int32_t kind, const double *size, const double *n, double end) {
    double axial = fabs(n[2]);
    if (kind == SPHERE) return 2 / size[0];
    if (kind == CAPSULE) return (axial < 0.1 ? 1 : 2) / size[0];
    if (kind == CYLINDER) return (axial < end) / size[0];
    if (kind != ELLIPSOID) return 0;
    /* squared length of the gradient of half of sum (x/a)^2, at the point with this normal */
    double length2 = 0, over = 0, bent = 0, root = 0;
    for (int i = 0; i < 3; i++) root += size[i] * size[i] * n[i] * n[i];
    for (int i = 0; i < 3; i++) {
        double slope2 = n[i] * n[i] / root, square = size[i] * size[i];
        length2 += slope2, over += 1 / square, bent += slope2 / square;
    }
    return (length2 * over - bent) / (length2 * sqrt(length2));
}

void curvatures(int64_t n, const int32_t *kinds, const double *sizes, const double *normals, double end, double *out) {
    for (int64_t k = 0; k < n; k++) out[k] = curvature(kinds[k], sizes + 3 * k, normals + 3 * k, end);
}

int64_t touched_curvatures(int64_t contacts, int64_t list, const int64_t *layout, int64_t first, int64_t count,
                           int64_t geoms, const int32_t *kinds, const double *sizes, const double *axes, double end, double *out) {
    int64_t found = 0;
    double sum = 0;
    for (int64_t v = 0; v < count; v++) out[v] = NAN;
    for (int64_t k = 0; k < contacts; k++) {
        const Contact c = contact_of(k, list, layout);
        int64_t numbers[2] = {c.geoms[0] - first, c.geoms[1] - first};
        int second = numbers[1] >= 0 && numbers[1] < count;
        int64_t v = numbers[second], other = c.geoms[1 - second];
        if (v < 0 || v >= count) continue;
        if (other >= geoms) return REFUSED;
        double bend = 0, n[3] = {0};
        if (other >= 0) {  /* otherwise it is a flex */
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) n[i] += axes[9 * other + 3 * j + i] * c.frame[j];
            bend = curvature(kinds[other], sizes + 3 * other, n, end);
        }
        found++, sum += bend, out[v] = bend;
    }
    for (int64_t v = 0; v < count; v++)
        if (isnan(out[v])) out[v] = found ? sum / found : 0;
    return found;
}

typedef struct { double x, y; } Plane;  /* components in a contact's plane */

static double dot(Plane a, Plane b) { return a.x * b.x + a.y * b.y; }

static Plane add(Plane a, double scale, Plane b) { return (Plane){a.x + scale * b.x, a.y + scale * b.y}; }

static Plane limit_length(Plane a, double limit) { return add((Plane){0}, fmin(limit / sqrt(fmax(dot(a, a), SMALLEST)), 1), a); }

/* State of a vertex: its contact sticks, slides, or does not exist while others slide. */
enum { STICKS, SLIDES, JOINS };

typedef struct { double step, mend, kept, excess, on_cone, give, slower; } StictionSettings;

/* Return the vertex of a contact, or -1 if it is not one of `count` spheres from `first` on. */
static int64_t vertex_of(const Contact *c, int64_t first, int64_t count) {
    int64_t second = c->geoms[1] - first, v = second >= 0 && second < count ? second : c->geoms[0] - first;
    return v >= 0 && v < count && c->row >= 0 ? v : -1;
}

/* Return the mean speed of the sliding contacts along their surfaces, m/s; 0 without any. */
static double slide_speed(int64_t contacts, int64_t list, const int64_t *layout, int64_t rows, const double *velocity,
                          int64_t first, int64_t count, const uint8_t *states) {
    double sum = 0;
    int64_t sliding = 0;
    for (int64_t k = 0; k < contacts; k++) {
        const Contact c = contact_of(k, list, layout);
        int64_t v = vertex_of(&c, first, count);
        if (v < 0 || states[v] != SLIDES || c.dim < 3 || c.row + 3 > rows) continue;
        sum += hypot(velocity[c.row + 1], velocity[c.row + 2]), sliding++;
    }
    return sliding ? sum / sliding : 0;
}

int64_t update_stiction(int64_t contacts, int64_t list, const int64_t *layout, int64_t rows, const double *force,
                        const double *kbip, const double *softness, const double *velocity, const double *travel,
                        const double *R_WS, int64_t first, int64_t count, const double *settings, double *give, double *memory,
                        uint8_t *states, double *surface, double *slide) {
    const StictionSettings set = {settings[0], settings[1], settings[2], settings[3],
                                  settings[4], settings[5], settings[6]};
    int64_t found = 0, sliding = 0;
    double *after = calloc(6 * count + 1, sizeof *after), *goal = calloc(count + 1, sizeof *goal), slip[3] = {0}, normal = 0;
    uint8_t *states_after = malloc(count + 1);
    int refused = 0, failed = !after || !goal || !states_after;
    double speed_after = failed ? 0 : slide_speed(contacts, list, layout, rows, velocity, first, count, states);
    int slows = speed_after < set.slower * slide[0];
    memset(surface, 0, 3 * count * sizeof *surface);
    if (!failed) memset(states_after, JOINS, count);
    for (int64_t k = 0; k < contacts && !failed; k++) {
        const Contact c = contact_of(k, list, layout);
        int64_t v = vertex_of(&c, first, count), row = c.row;
        if (v < 0) continue;
        if (row + force_rows(&c) > rows) {
            refused = 1;
            break;
        }
        found++, states_after[v] = STICKS, normal += force[row];
        double depth = c.margin - c.dist;
        goal[v] = fmax(fmax(depth, 0), give[v] - fmax(depth - set.step * velocity[row], 0));
        if (c.dim < 3) continue;
        /* axes in S; MuJoCo's signs are those of the second geom */
        double axes[2][3], sign = c.geoms[1] == first + v ? 1 : -1;
        for (int a = 0; a < 2; a++)
            for (int i = 0; i < 3; i++) {
                const double *W = c.frame + 3 + 3 * a;
                axes[a][i] = sign * (W[0] * R_WS[i] + W[1] * R_WS[3 + i] + W[2] * R_WS[6 + i]);
            }
        Plane held = {force[row + 1], force[row + 2]}, moving = {velocity[row + 1], velocity[row + 2]};
        Plane moved = {set.step * travel[row + 1], set.step * travel[row + 2]}, was = {0}, shift = {0};
        for (int i = 0; i < 3; i++) {
            double f = memory[6 * v + i], s = memory[6 * v + 3 + i];
            was.x += axes[0][i] * f, was.y += axes[1][i] * f, shift.x += axes[0][i] * s, shift.y += axes[1][i] * s;
        }
        double limit = c.friction[0] * force[row], target = (1 + set.excess) * limit, mass = 1 / softness[row + 1];
        double damping = set.step * kbip[4 * (row + 1) + 1], drag = damping / (1 + damping);
        int slid = states[v] == SLIDES, slips;
        Plane next = add(slid ? was : held, -mass / set.step, moving); /* friction if it stuck */
        if (slid)
            slips = dot(was, moving) < 0 && !slows;
        else if (states[v] == JOINS)
            slips = dot(next, next) >= limit * limit;
        else
            slips = dot(held, held) >= set.on_cone * set.on_cone * limit * limit && dot(held, moving) <= 0;
        if (slid && !slips) held = limit_length(was, limit);
        shift = slips ? add((Plane){0}, set.kept, shift) : add(shift, 1, moved);
        held = slips ? add((Plane){0}, target / sqrt(fmax(dot(next, next), SMALLEST)), next)
                     : limit_length(add(held, -set.mend / (set.step * set.step) * mass, shift), target);
        Plane belt = add(add((Plane){0}, slips ? -drag : 1 - drag, moving), -set.step / mass, held);
        if (slips) states_after[v] = SLIDES, sliding++;
        for (int i = 0; i < 3; i++) {
            if (slips) slip[i] += axes[0][i] * moving.x + axes[1][i] * moving.y;
            after[6 * v + i] = axes[0][i] * held.x + axes[1][i] * held.y;
            after[6 * v + 3 + i] = axes[0][i] * shift.x + axes[1][i] * shift.y;
            surface[3 * v + i] = (axes[0][i] * belt.x + axes[1][i] * belt.y) / drag;
        }
    }
    if (found && !refused) {
        slide[0] = speed_after, slide[4] = normal;
        for (int i = 0; i < 3; i++) slide[1 + i] = sliding ? slip[i] / sliding : 0;
        for (int64_t v = 0; v < count; v++) {
            give[v] += set.give * (goal[v] - give[v]);
            if (states_after[v] != JOINS) continue;
            if (!sliding) states_after[v] = STICKS;
            for (int i = 0; i < 3; i++) surface[3 * v + i] = -slide[1 + i];
        }
        memcpy(memory, after, 6 * count * sizeof *after), memcpy(states, states_after, count);
    }
    free(after), free(goal), free(states_after);
    return failed ? NO_MEMORY : refused ? REFUSED : found;
}
