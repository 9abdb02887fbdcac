/* Elastic forces of the membrane on its grid, in the number type REAL (qs_elasticity.c includes this
   file for each type). A cell is evaluated at its four corners. The tangents of a corner are the
   two edges of the cell that meet there. Contributions of the corners are summed on edges; a node's
   force is a difference of edges. Loops run along a line of nodes in whole vectors: lines are
   padded, and padding cells have zero weight. */

/* Metric relative to the free membrane, and second Piola-Kirchhoff stress times thickness. `root`
   is 1 / sqrt(det C). */
typedef struct { REAL C11, C22, C12, root, S11, S22, S12; } TYPE(Strained);

typedef struct {
    REAL lambda2, modulus, poisson, middle, per_unit, law[QS_LAW], over_x, over_y;
} TYPE(Numbers);

INLINE TYPE(Numbers) TYPE(numbers_of)(const Membrane *f) {
    const MembraneNumbers *o = &f->numbers;
    TYPE(Numbers) n = {.lambda2 = (REAL)o->lambda2, .modulus = (REAL)o->modulus, .poisson = (REAL)o->poisson,
                       .middle = (REAL)o->law_middle, .per_unit = (REAL)o->law_per_unit, .over_x = (REAL)(1 / f->dx),
                       .over_y = (REAL)(1 / f->dy)};
    for (int k = 0; k < QS_LAW; k++) n.law[k] = (REAL)f->law[k];
    return n;
}

INLINE REAL TYPE(law_at)(const TYPE(Numbers) *o, REAL root) {
    const REAL t = (root - o->middle) * o->per_unit;
    REAL q = o->law[QS_LAW - 1];
    for (int k = QS_LAW - 2; k >= 0; k--) q = q * t + o->law[k];
    return q;
}

INLINE TYPE(Strained) TYPE(strained)(const TYPE(Numbers) *o, REAL C11, REAL C22, REAL C12, int neo_hookean) {
    TYPE(Strained) s = {.C11 = C11, .C22 = C22, .C12 = C12};
    const REAL det = C11 * C22 - C12 * C12, M = o->modulus, nu = o->poisson;
    s.root = 1 / SQRT(det > (REAL)MIN_DET ? det : (REAL)MIN_DET);
    if (neo_hookean) {
        const REAL q = TYPE(law_at)(o, s.root);
        s.S11 = M - M * q * C22, s.S22 = M - M * q * C11, s.S12 = M * q * C12;
    } else {
        const REAL E11 = (C11 - 1) / 2, E22 = (C22 - 1) / 2;
        s.S11 = M * (E11 + nu * E22), s.S22 = M * (E22 + nu * E11), s.S12 = M * (1 - nu) * C12 / 2;
    }
    return s;
}

/* A line of edges: tangents, their squares times lambda2, and the heights of their first nodes. */
typedef struct { REAL *g[3], *C, *z; } TYPE(Edges);

/* Loads on the edges of a line: elastic forces and volume gradients, of three and two
   displacements. Along y also the corners' contributions to the volume gradient by height, low and
   high. Then the stiffness of links. */
typedef struct { REAL *force[3], *volume[2], *low, *high, *link; } TYPE(Loads);

#define LOADS 8
typedef struct {
    TYPE(Edges) across, along[2]; /* edges to the next line; on this line and on the next */
    /* across: from the cells before; along: of this line and of the next */
    TYPE(Loads) before, low, high, left, right;
    REAL *weight, *area, *tension, *turn, *root; /* the last two: minima over cells */
} TYPE(Lines);

#define LINES (3 * 5 + 5 * LOADS + 5)
typedef struct { REAL *next; long line; } TYPE(Room);

/* with room before its first and behind its last entry */
INLINE REAL *TYPE(a_line)(TYPE(Room) *room) {
    REAL *here = room->next + 8;
    room->next += room->line + 16;
    return here;
}

INLINE TYPE(Edges) TYPE(edges_in)(TYPE(Room) *room) {
    TYPE(Edges) e;
    for (int k = 0; k < 3; k++) e.g[k] = TYPE(a_line)(room);
    e.C = TYPE(a_line)(room), e.z = TYPE(a_line)(room);
    return e;
}

INLINE TYPE(Loads) TYPE(loads_in)(TYPE(Room) *room) {
    TYPE(Loads) l;
    for (int k = 0; k < 3; k++) l.force[k] = TYPE(a_line)(room);
    for (int k = 0; k < 2; k++) l.volume[k] = TYPE(a_line)(room);
    l.low = TYPE(a_line)(room), l.high = TYPE(a_line)(room), l.link = TYPE(a_line)(room);
    return l;
}

/* Compute the edges from nodes `from` to nodes `to`, along x or y. */
INLINE void TYPE(see_edges)(const double *const from[3], const double *const to[3], double over, int axis, REAL lambda2, long line,
                            const TYPE(Edges) *e) {
    REAL *restrict g0 = e->g[0], *restrict g1 = e->g[1], *restrict g2 = e->g[2], *restrict C = e->C, *restrict z = e->z;
    VECTORS
    for (long j = 0; j < line; j++) {
        const REAL a = (REAL)((axis == 0) + (to[0][j] - from[0][j]) * over), b = (REAL)((axis == 1) + (to[1][j] - from[1][j]) * over);
        const REAL c = (REAL)((to[2][j] - from[2][j]) * over);
        g0[j] = a, g1[j] = b, g2[j] = c, C[j] = lambda2 * (a * a + b * b + c * c), z[j] = (REAL)from[2][j];
    }
}

/* One corner: its stress times weight, and its contributions to sums and links. */
typedef struct { REAL S11, S22, S12, xx, yy, turn, tension, area, root; } TYPE(Corner);

INLINE TYPE(Corner) TYPE(see_corner)(const TYPE(Numbers) *o, const REAL g1[3], const REAL g2[3], REAL C11, REAL C22, REAL weight,
                                     int neo_hookean, int parts) {
    const REAL C12 = o->lambda2 * (g1[0] * g2[0] + g1[1] * g2[1] + g1[2] * g2[2]);
    const TYPE(Strained) s = TYPE(strained)(o, C11, C22, C12, neo_hookean);
    TYPE(Corner) c = {.S11 = weight * s.S11, .S22 = weight * s.S22, .S12 = weight * s.S12, .turn = g1[0] * g2[1] - g1[1] * g2[0]};
    c.tension = (c.S11 * C11 + c.S22 * C22 + 2 * c.S12 * C12) * s.root / 2;
    c.area = weight / s.root, c.root = s.root;
    if (parts & QS_LINKS) {
        const REAL fair = (REAL)MIN_TENSION * (c.tension > 0 ? c.tension : 0), by = 1 / (1 + g1[2] * g1[2] + g2[2] * g2[2]);
        c.xx = by * (c.S11 > fair ? c.S11 : fair) * o->over_x * o->over_x;
        c.yy = by * (c.S22 > fair ? c.S22 : fair) * o->over_y * o->over_y;
    }
    return c;
}

/* Compute the cells between a line and the next. */
INLINE void TYPE(see_cells)(const Membrane *f, const TYPE(Lines) *l, int neo_hookean, int parts) {
    const TYPE(Numbers) o = TYPE(numbers_of)(f);
    const int first = parts & QS_PLANE ? 0 : 2, last = parts & QS_HEIGHTS ? 3 : 2;
    const long line = f->line;
    VECTORS
    for (long j = 0; j < line; j++) {
        REAL low[3], high[3], left[3], right[3];
        for (int k = 0; k < 3; k++) {
            low[k] = l->across.g[k][j], high[k] = l->across.g[k][j + 1];
            left[k] = l->along[0].g[k][j], right[k] = l->along[1].g[k][j];
        }
        const REAL weight = l->weight[j], C_low = l->across.C[j], C_high = l->across.C[j + 1];
        const REAL C_left = l->along[0].C[j], C_right = l->along[1].C[j];
        const TYPE(Corner) ll = TYPE(see_corner)(&o, low, left, C_low, C_left, weight, neo_hookean, parts);
        const TYPE(Corner) lr = TYPE(see_corner)(&o, low, right, C_low, C_right, weight, neo_hookean, parts);
        const TYPE(Corner) hl = TYPE(see_corner)(&o, high, left, C_high, C_left, weight, neo_hookean, parts);
        const TYPE(Corner) hr = TYPE(see_corner)(&o, high, right, C_high, C_right, weight, neo_hookean, parts);
        for (int k = first; k < last; k++) {
            l->low.force[k][j] = o.over_x * ((ll.S11 + lr.S11) * low[k] + ll.S12 * left[k] + lr.S12 * right[k]);
            l->high.force[k][j] = o.over_x * ((hl.S11 + hr.S11) * high[k] + hl.S12 * left[k] + hr.S12 * right[k]);
            l->left.force[k][j] += o.over_y * ((ll.S22 + hl.S22) * left[k] + ll.S12 * low[k] + hl.S12 * high[k]);
            l->right.force[k][j] = o.over_y * ((lr.S22 + hr.S22) * right[k] + lr.S12 * low[k] + hr.S12 * high[k]);
        }
        if (parts & QS_PLANE) {
            /* volume of a corner: its height times its projected area */
            const REAL wx = weight * o.over_x, wy = weight * o.over_y;
            const REAL zll = l->along[0].z[j], zhl = l->along[0].z[j + 1], zlr = l->along[1].z[j], zhr = l->along[1].z[j + 1];
            for (int k = 0; k < 2; k++) {
                const REAL sign = k ? -1 : 1;
                l->low.volume[k][j] = sign * wx * (zll * left[1 - k] + zlr * right[1 - k]);
                l->high.volume[k][j] = sign * wx * (zhl * left[1 - k] + zhr * right[1 - k]);
                l->left.volume[k][j] -= sign * wy * (zll * low[1 - k] + zhl * high[1 - k]);
                l->right.volume[k][j] = -sign * wy * (zlr * low[1 - k] + zhr * high[1 - k]);
            }
        }
        l->left.low[j] += weight * ll.turn, l->left.high[j] += weight * hl.turn;
        l->right.low[j] = weight * lr.turn, l->right.high[j] = weight * hr.turn;
        l->tension[j] += ll.tension + lr.tension + hl.tension + hr.tension;
        l->area[j] += ll.area + lr.area + hl.area + hr.area;
        const REAL turn_low = ll.turn < lr.turn ? ll.turn : lr.turn, turn_high = hl.turn < hr.turn ? hl.turn : hr.turn;
        const REAL turn = turn_low < turn_high ? turn_low : turn_high;
        l->turn[j] = weight > 0 && turn < l->turn[j] ? turn : l->turn[j];
        const REAL root_low = ll.root < lr.root ? ll.root : lr.root, root_high = hl.root < hr.root ? hl.root : hr.root;
        const REAL root = root_low < root_high ? root_low : root_high;
        l->root[j] = weight > 0 && root < l->root[j] ? root : l->root[j];
        if (parts & QS_LINKS) {
            l->low.link[j] = ll.xx + lr.xx, l->high.link[j] = hl.xx + hr.xx;
            l->left.link[j] += ll.yy + hl.yy, l->right.link[j] = lr.yy + hr.yy;
        }
    }
}

static void TYPE(see_heights)(const Membrane *f, const TYPE(Lines) *l) {
    if (f->numbers.neo_hookean != 0) TYPE(see_cells)(f, l, 1, QS_HEIGHTS);
    else TYPE(see_cells)(f, l, 0, QS_HEIGHTS);
}

static void TYPE(see_links)(const Membrane *f, const TYPE(Lines) *l) {
    if (f->numbers.neo_hookean != 0) TYPE(see_cells)(f, l, 1, QS_HEIGHTS | QS_LINKS);
    else TYPE(see_cells)(f, l, 0, QS_HEIGHTS | QS_LINKS);
}

static void TYPE(see_plane)(const Membrane *f, const TYPE(Lines) *l) {
    if (f->numbers.neo_hookean != 0) TYPE(see_cells)(f, l, 1, QS_PLANE);
    else TYPE(see_cells)(f, l, 0, QS_PLANE);
}

static void TYPE(see_all)(const Membrane *f, const TYPE(Lines) *l) {
    if (f->numbers.neo_hookean != 0) TYPE(see_cells)(f, l, 1, QS_HEIGHTS | QS_PLANE | QS_LINKS);
    else TYPE(see_cells)(f, l, 0, QS_HEIGHTS | QS_PLANE | QS_LINKS);
}

/* Compute the forces on a line's nodes from its edges: incoming minus outgoing. Edges across the
   line are stored for the line behind. */
INLINE void TYPE(gather)(const Membrane *f, REAL *restrict before, const REAL *restrict low, const REAL *restrict high,
                         const REAL *restrict along, REAL *restrict to) {
    const long line = f->line;
    VECTORS
    for (long j = 0; j < line; j++) {
        const REAL across = low[j] + high[j - 1];
        to[j] = before[j] - across + along[j - 1] - along[j];
        before[j] = across;
    }
    to[0] = 0;
    for (long j = f->rows - 1; j < line; j++) to[j] = 0;
}

/* Triangles of cut cells: contributions of eight at a time, which are then summed. */
typedef REAL TYPE(Vector) __attribute__((vector_size(LANES * sizeof(REAL)), aligned(8)));
typedef struct { TYPE(Vector) elastic[3][3], gradient[3][3], link[3]; } TYPE(Borne);

INLINE TYPE(Vector) TYPE(vector_of)(const double *from) {
    Lanes here;
    memcpy(&here, from, sizeof here);
    return __builtin_convertvector(here, TYPE(Vector));
}

INLINE void TYPE(see_group)(const Membrane *f, const TYPE(Numbers) *o, const CutGroup *cut, const double *x, int parts, TYPE(Borne) *to,
                            MembraneSums *sums, double *tension, double *area) {
    const TYPE(Vector) weight = TYPE(vector_of)(cut->area);
    TYPE(Vector) bx[3], by[3], g1[3], g2[3], mean = 0 * weight, root;
    for (int k = 0; k < 3; k++) g1[k] = 0 * weight + (REAL)(k == 0), g2[k] = 0 * weight + (REAL)(k == 1);
    for (int a = 0; a < 3; a++) {
        bx[a] = TYPE(vector_of)(cut->by_x[a]), by[a] = TYPE(vector_of)(cut->by_y[a]);
        for (int k = 0; k < 3; k++) {
            TYPE(Vector) u;
            for (int n = 0; n < LANES; n++) u[n] = (REAL)x[k * f->count + (long)cut->node[a][n]];
            g1[k] += u * bx[a], g2[k] += u * by[a];
            if (k == 2) mean += u / 3;
        }
    }
    const TYPE(Vector) C11 = o->lambda2 * (g1[0] * g1[0] + g1[1] * g1[1] + g1[2] * g1[2]);
    const TYPE(Vector) C22 = o->lambda2 * (g2[0] * g2[0] + g2[1] * g2[1] + g2[2] * g2[2]);
    const TYPE(Vector) C12 = o->lambda2 * (g1[0] * g2[0] + g1[1] * g2[1] + g1[2] * g2[2]);
    const TYPE(Vector) det = C11 * C22 - C12 * C12, M = weight * o->modulus, turn = g1[0] * g2[1] - g1[1] * g2[0];
    for (int n = 0; n < LANES; n++) root[n] = 1 / SQRT(det[n] > (REAL)MIN_DET ? det[n] : (REAL)MIN_DET);
    TYPE(Vector) S11, S22, S12;
    if (f->numbers.neo_hookean != 0) {
        const TYPE(Vector) t = (root - o->middle) * o->per_unit;
        TYPE(Vector) q = 0 * t + o->law[QS_LAW - 1];
        for (int k = QS_LAW - 2; k >= 0; k--) q = q * t + o->law[k];
        S11 = M - M * q * C22, S22 = M - M * q * C11, S12 = M * q * C12;
    } else {
        const TYPE(Vector) E11 = (C11 - 1) / 2, E22 = (C22 - 1) / 2;
        S11 = M * (E11 + o->poisson * E22), S22 = M * (E22 + o->poisson * E11), S12 = M * (1 - o->poisson) * C12 / 2;
    }
    const TYPE(Vector) stressed = (S11 * C11 + S22 * C22 + 2 * S12 * C12) * root / 2, bulge = weight * turn * mean;
    for (int n = 0; n < LANES; n++) {
        if (weight[n] > 0) sums->min_turn = min_of(sums->min_turn, (double)turn[n]);
        if (weight[n] > 0) sums->min_root = min_of(sums->min_root, (double)root[n]);
        *tension += (double)stressed[n], *area += (double)(weight[n] / root[n]), sums->volume += (double)bulge[n];
    }
    for (int a = 0; a < 3; a++) {
        for (int k = parts & QS_PLANE ? 0 : 2; k < 3; k++)
            to->elastic[a][k] = (S11 * g1[k] + S12 * g2[k]) * bx[a] + (S22 * g2[k] + S12 * g1[k]) * by[a];
        to->gradient[a][0] = weight * mean * (g2[1] * bx[a] - g1[1] * by[a]);
        to->gradient[a][1] = weight * mean * (g1[0] * by[a] - g2[0] * bx[a]);
        to->gradient[a][2] = weight * turn / 3;
    }
    if (!(parts & QS_HEIGHTS)) return;
    const TYPE(Vector) flat = 1 / (1 + g1[2] * g1[2] + g2[2] * g2[2]);
    TYPE(Vector) xx, yy;
    for (int n = 0; n < LANES; n++) {
        const REAL fair = (REAL)MIN_TENSION * (stressed[n] > 0 ? stressed[n] : 0);
        xx[n] = S11[n] > fair ? S11[n] : fair, yy[n] = S22[n] > fair ? S22[n] : fair;
    }
    for (int a = 0; a < 3; a++) /* link of the side from a corner to the next */
        to->link[a] = -flat * (xx * bx[a] * bx[(a + 1) % 3] + yy * by[a] * by[(a + 1) % 3]);
}

static void TYPE(see_cuts)(const Membrane *f, const double *x, int parts, long first, long last, const TYPE(MembraneFields) *to,
                           MembraneSums *sums, double *tension, double *area) {
    const TYPE(Numbers) o = TYPE(numbers_of)(f);
    const long count = f->count;
    const int low = parts & QS_PLANE ? 0 : 2, high = parts & QS_HEIGHTS ? 3 : 2;
    for (long g = 0; g < f->groups; g++) {
        const CutGroup *cut = qs_cut_group(f, g);
        TYPE(Borne) borne;
        TYPE(see_group)(f, &o, cut, x, parts, &borne, sums, tension, area);
        for (int n = 0; n < LANES; n++)
            for (int a = 0; a < 3; a++) {
                const long node = (long)cut->node[a][n];
                for (int k = low; k < high && node; k++) to->elastic[k * count + node] += borne.elastic[a][k][n];
                for (int k = parts & QS_PLANE ? 0 : 2; k < 3 && node; k++) to->gradient[k * count + node] += borne.gradient[a][k][n];
                const long link = (long)cut->link[a][n] / 2, line = link / f->line;
                if (!link || !(parts & QS_HEIGHTS) || line < first || line > last) continue;
                if ((long)cut->link[a][n] % 2) to->along_y[link] += borne.link[a][n];
                else if (line < last) to->along_x[link] += borne.link[a][n];
            }
    }
}

MembraneSums TYPE(qs_elastic)(const Membrane *f, const double *x, int parts, long first, long last, const TYPE(MembraneFields) *to) {
    const long line = f->line, count = f->count;
    REAL numbers[LINES * (QS_MAX_LINE + 16)];
    TYPE(Room) room = {numbers, line};
    memset(numbers, 0, LINES * (line + 16) * sizeof *numbers);
    TYPE(Lines) l;
    l.across = TYPE(edges_in)(&room), l.along[0] = TYPE(edges_in)(&room), l.along[1] = TYPE(edges_in)(&room);
    l.before = TYPE(loads_in)(&room), l.low = TYPE(loads_in)(&room), l.high = TYPE(loads_in)(&room);
    l.left = TYPE(loads_in)(&room), l.right = TYPE(loads_in)(&room);
    l.weight = TYPE(a_line)(&room), l.area = TYPE(a_line)(&room), l.tension = TYPE(a_line)(&room), l.turn = TYPE(a_line)(&room);
    l.root = TYPE(a_line)(&room);
    for (long j = 0; j < line; j++) l.weight[j] = j < f->rows - 1 ? (REAL)(f->dx * f->dy / 4) : 0, l.turn[j] = 1, l.root[j] = (REAL)1e9;
    l.across.g[0][line] = l.across.C[line] = 1;
    const double *at[3] = {x, x + count, x + 2 * count};
    const double *above[3] = {x + 1, x + count + 1, x + 2 * count + 1};
    const REAL lambda2 = (REAL)f->numbers.lambda2;
    MembraneSums sums = {.min_turn = INFINITY, .min_root = INFINITY};
    TYPE(see_edges)(at, above, 1 / f->dy, 1, lambda2, line, &l.along[1]);
    for (long i = 0; i < f->columns - 1; i++) {
        if (f->uncut)
            for (long j = 0; j < f->rows - 1; j++) l.weight[j] = (REAL)(f->uncut[i * f->rows + j] * (f->dx * f->dy / 4));
        const TYPE(Edges) kept = l.along[0];
        const TYPE(Loads) done = l.left;
        l.along[0] = l.along[1], l.along[1] = kept, l.left = l.right, l.right = done;
        const double *next[3] = {at[0] + line, at[1] + line, at[2] + line};
        for (int k = 0; k < 3; k++) above[k] += line;
        TYPE(see_edges)(at, next, 1 / f->dx, 0, lambda2, line, &l.across);
        TYPE(see_edges)(next, above, 1 / f->dy, 1, lambda2, line, &l.along[1]);
        const int links = i >= first && i < last;
        if ((parts & QS_PLANE) && (parts & QS_HEIGHTS)) TYPE(see_all)(f, &l);
        else if (parts & QS_PLANE) TYPE(see_plane)(f, &l);
        else if (links) TYPE(see_links)(f, &l);
        else TYPE(see_heights)(f, &l);
        const long here = i * line;
        for (int k = parts & QS_PLANE ? 0 : 2; k < (parts & QS_HEIGHTS ? 3 : 2); k++)
            TYPE(gather)(f, l.before.force[k], l.low.force[k], l.high.force[k], l.left.force[k], to->elastic + k * count + here);
        for (int k = 0; k < 2 && parts & QS_PLANE; k++)
            TYPE(gather)(f, l.before.volume[k], l.low.volume[k], l.high.volume[k], l.left.volume[k], to->gradient + k * count + here);
        REAL *restrict by_height = to->gradient + 2 * count + here;
        REAL bulge = 0;
        VECTORS
        for (long j = 0; j < line; j++) {
            const REAL cell = l.left.low[j] + l.left.high[j - 1];
            by_height[j] = cell, bulge += cell * l.along[0].z[j];
        }
        sums.volume += bulge;
        by_height[0] = 0;
        for (long j = f->rows - 1; j < line; j++) by_height[j] = 0;
        if (links)
            for (long j = 0; j < line; j++) to->along_x[here + j] = l.low.link[j] + l.high.link[j - 1];
        if (links || (i > first && i == last))
            for (long j = 0; j < line; j++) to->along_y[here + j] = l.left.link[j];
        for (int k = 0; k < 3; k++) at[k] = next[k];
    }
    for (int k = 0; k < 3; k++) /* zero on the frame */
        for (int end = 0; end < 2; end++) {
            const long here = k * count + end * (f->columns - 1) * line;
            memset(to->elastic + here, 0, line * sizeof *to->elastic), memset(to->gradient + here, 0, line * sizeof *to->gradient);
        }
    double tension = 0, area = 0;
    if (f->groups) TYPE(see_cuts)(f, x, parts, first, last, to, &sums, &tension, &area);
    for (long j = 0; j < line; j++) {
        tension += (double)l.tension[j], area += (double)l.area[j];
        if ((double)l.turn[j] < sums.min_turn) sums.min_turn = (double)l.turn[j];
        if ((double)l.root[j] < sums.min_root) sums.min_root = (double)l.root[j];
    }
    sums.tension = tension / f->numbers.opening, sums.area = area / f->numbers.lambda2;
    return sums;
}
#undef LINES
#undef LOADS
