#include "qs_stiffness_stencil.h"

#include "qs_cut_cells.h"

#include <math.h>
#include <string.h>

#define MIN_DET 1e-2f

/* One corner of eight cells: its tangents and height, its inverse edge lengths, and the energy's
   derivatives by tangents. */
typedef struct {
    Eight g[2][3], height;
    float over[2];           /* inverse edge lengths along x and y, 1/m, signed */
    Eight by[2][2][3][3];    /* second derivatives by tangent a's component k and tangent b's l */
    Eight tension_by[2][3];  /* derivatives of the mean tension */
} Corner;

long qs_stencil_size(const Membrane *f) { return (9 * PAIRS + 3) * (f->count + LANES); }

Stencil qs_stencil_in(const Membrane *f, float **room) {
    Stencil s = {.stride = f->count + LANES};
    for (int pair = 0; pair < PAIRS; pair++) s.block[pair] = *room, *room += 9 * s.stride;
    s.tension_by = *room, *room += 3 * s.stride;
    return s;
}

/* Convert eight differences or heights from double to single precision. */
static Eight eight_of(Lanes value) { return __builtin_convertvector(value, Eight); }

static Lanes lanes_at(const double *from) {
    Lanes value;
    memcpy(&value, from, sizeof value);
    return value;
}

static Eight eight_at(const double *from) { return eight_of(lanes_at(from)); }

static void add_at(float *to, Eight value) { EIGHT(to) += value; }

/* Return c/det C of the law, and its slope by 1 / sqrt(det C). */
static Eight law_and_slope(const Membrane *f, Eight root, Eight *slope) {
    const Eight t = (root - (float)f->numbers.law_middle) * (float)f->numbers.law_per_unit;
    Eight value = (float)f->law[QS_LAW - 1] - 0 * t, by = 0 * t;
    for (int k = QS_LAW - 2; k >= 0; k--) by = by * t + value, value = value * t + (float)f->law[k];
    *slope = by * (float)f->numbers.law_per_unit;
    return value;
}

/* Compute the law at a corner: stress times thickness `S` (11, 22, 12), and its derivatives `D` by
   strains e11, e22 and 2 e12 (Eq. F10). */
static void strain(const Membrane *f, Corner *c, Eight weight) {
    const float M = (float)f->numbers.modulus, nu = (float)f->numbers.poisson, l = (float)f->numbers.lambda2;
    Eight C[3] = {0}, S[3], D[3][3], root;
    for (int k = 0; k < 3; k++) C[0] += l * c->g[0][k] * c->g[0][k], C[1] += l * c->g[1][k] * c->g[1][k], C[2] += l * c->g[0][k] * c->g[1][k];
    const Eight det = C[0] * C[1] - C[2] * C[2];
    for (int n = 0; n < LANES; n++) root[n] = 1 / sqrtf(det[n] > MIN_DET ? det[n] : MIN_DET);
    const Eight det_by[3] = {2 * l * C[1], 2 * l * C[0], -2 * l * C[2]}, root_by = -root * root * root / 2;
    memset(D, 0, sizeof D);
    if (f->numbers.neo_hookean != 0) {
        Eight slope;
        const Eight q = law_and_slope(f, root, &slope);
        const Eight A[3] = {C[1], C[0], -C[2]};
        S[0] = M - M * q * C[1], S[1] = M - M * q * C[0], S[2] = M * q * C[2];
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) D[a][b] = -M * A[a] * slope * root_by * det_by[b];
        D[0][1] -= 2 * M * l * q, D[1][0] -= 2 * M * l * q, D[2][2] += M * l * q;
    } else {
        const Eight E11 = (C[0] - 1) / 2, E22 = (C[1] - 1) / 2;
        S[0] = M * (E11 + nu * E22), S[1] = M * (E22 + nu * E11), S[2] = M * (1 - nu) * C[2] / 2;
        D[0][0] += M * l, D[1][1] += M * l, D[0][1] += nu * M * l, D[1][0] += nu * M * l, D[2][2] += (1 - nu) / 2 * M * l;
    }
    const Eight energy = S[0] * C[0] + S[1] * C[1] + 2 * S[2] * C[2];
    const Eight own[3] = {2 * l * S[0], 2 * l * S[1], 2 * l * S[2]};
    Eight tension[3];
    for (int e = 0; e < 3; e++) {
        tension[e] = root * (own[e] + C[0] * D[0][e] + C[1] * D[1][e] + 2 * C[2] * D[2][e]) + energy * root_by * det_by[e];
        tension[e] *= weight / (float)(2 * f->numbers.opening);
    }
    for (int k = 0; k < 3; k++) {
        c->tension_by[0][k] = tension[0] * c->g[0][k] + tension[2] * c->g[1][k];
        c->tension_by[1][k] = tension[1] * c->g[1][k] + tension[2] * c->g[0][k];
    }
    const Eight stress[2][2] = {{S[0], S[2]}, {S[2], S[1]}}, none = {0};
    for (int a = 0; a < 2; a++)
        for (int k = 0; k < 3; k++) {
            /* strains by tangent a's component k, and the resulting stress */
            const Eight e[3] = {a ? none : c->g[0][k], a ? c->g[1][k] : none, c->g[1 - a][k]};
            Eight made[3];
            for (int n = 0; n < 3; n++) made[n] = weight * (D[n][0] * e[0] + D[n][1] * e[1] + D[n][2] * e[2]);
            for (int b = 0; b < 2; b++)
                for (int m = 0; m < 3; m++)
                    c->by[a][b][k][m] = made[b] * c->g[b][m] + made[2] * c->g[1 - b][m] + (k == m ? weight * stress[a][b] : none);
        }
}

/* Subtract the term of the gas, whose volume here is height times (g1 x g2)_z. */
static void push(Corner *c, Eight pressure, Eight turn_by[2][3]) {
    c->by[0][1][0][1] -= pressure * c->height, c->by[0][1][1][0] += pressure * c->height;
    c->by[1][0][1][0] -= pressure * c->height, c->by[1][0][0][1] += pressure * c->height;
    for (int a = 0; a < 2; a++) {
        const float by = (a ? -1.f : 1.f) * c->over[a];
        turn_by[a][0] = -pressure * by * c->g[1 - a][1], turn_by[a][1] = pressure * by * c->g[1 - a][0], turn_by[a][2] -= turn_by[a][2];
    }
}

static void add_block(const Stencil *to, int pair, long node, int turned, Eight block[3][3]) {
    for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m++) add_at(to->block[pair] + (3 * k + m) * to->stride + node, turned ? block[m][k] : block[k][m]);
}

/* Add corner (ci, cj) of the cells from (i, j) on. */
static void add_corner(const Membrane *f, const double *x, double pressure, long i, long j, int ci, int cj, const Stencil *to) {
    const long count = f->count, line = f->line, node = (i + ci) * line + j + cj;
    const long end[2] = {(i + 1 - ci) * line + j + cj, (i + ci) * line + j + 1 - cj};
    Corner c = {.over = {(float)((ci ? -1 : 1) / f->dx), (float)((cj ? -1 : 1) / f->dy)}, .height = eight_of(lanes_at(x + 2 * count + node))};
    Eight weight, turn_by[2][3] = {{{0}}}, across[3][3], own[3][3] = {{{0}}};
    for (int n = 0; n < LANES; n++) weight[n] = j + n < f->rows - 1 ? (float)(f->dx * f->dy / 4) : 0;
    for (int n = 0; n < LANES && f->uncut && j + n < f->rows - 1; n++) weight[n] *= (float)f->uncut[i * f->rows + j + n];
    for (int a = 0; a < 2; a++)
        for (int k = 0; k < 3; k++)
            c.g[a][k] = (float)(k == a) + c.over[a] * eight_of(lanes_at(x + k * count + end[a]) - lanes_at(x + k * count + node));
    strain(f, &c, weight);
    push(&c, weight * (float)pressure, turn_by);
    const int pairs[2] = {PAIR_BESIDE, PAIR_UP};
    for (int a = 0; a < 2; a++) {
        /* blocks at the end of the edge, and between the corner and it */
        Eight there[3][3], between[3][3];
        for (int k = 0; k < 3; k++)
            for (int m = 0; m < 3; m++) {
                there[k][m] = c.over[a] * c.over[a] * c.by[a][a][k][m];
                between[k][m] = -there[k][m] - c.over[0] * c.over[1] * c.by[1 - a][a][k][m] + (k == 2 ? turn_by[a][m] : 0 * weight);
                /* the corner moves relative to both ends; its height alone does not */
                own[k][m] += there[k][m] + c.over[0] * c.over[1] * c.by[1 - a][a][k][m];
                own[k][m] -= (k == 2 ? turn_by[a][m] : 0 * weight) + (m == 2 ? turn_by[a][k] : 0 * weight);
                if (a) across[k][m] = c.over[0] * c.over[1] * c.by[0][1][k][m];
            }
        add_block(to, PAIR_OWN, end[a], 0, there);
        add_block(to, pairs[a], a ? (i + ci) * line + j : i * line + j + cj, a ? cj : ci, between);
        for (int k = 0; k < 3; k++) {
            const Eight by = c.over[a] * c.tension_by[a][k];
            add_at(to->tension_by + k * to->stride + end[a], by), add_at(to->tension_by + k * to->stride + node, -by);
        }
    }
    add_block(to, PAIR_OWN, node, 0, own);
    add_block(to, ci == cj ? PAIR_FALLING : PAIR_RISING, i * line + j + (ci == cj), !ci, across);
}

/* Compute the energy's second derivatives by the displacements of two corners of eight triangles,
   minus the term of the gas. Its volume is the corners' mean height times (g1 x g2)_z. */
static void between_corners(const CutGroup *cut, const Corner *c, double pressure, int a, int b, Eight block[3][3]) {
    const Eight own[2] = {eight_at(cut->by_x[a]), eight_at(cut->by_y[a])}, other[2] = {eight_at(cut->by_x[b]), eight_at(cut->by_y[b])};
    const Eight push = (float)pressure * eight_at(cut->area), third = push / 3;
    for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m++) {
            block[k][m] = 0 * push;
            for (int p = 0; p < 2; p++)
                for (int q = 0; q < 2; q++) block[k][m] += own[p] * other[q] * c->by[p][q][k][m];
        }
    const Eight turn = push * c->height * (own[0] * other[1] - own[1] * other[0]);
    block[0][1] -= turn, block[1][0] += turn;
    block[0][2] -= third * (c->g[1][1] * own[0] - c->g[0][1] * own[1]), block[1][2] -= third * (c->g[0][0] * own[1] - c->g[1][0] * own[0]);
    block[2][0] -= third * (c->g[1][1] * other[0] - c->g[0][1] * other[1]), block[2][1] -= third * (c->g[0][0] * other[1] - c->g[1][0] * other[0]);
}

static void add_entries(const Membrane *f, const Stencil *to, long node, long other, const Eight block[3][3], int lane) {
    for (int pair = 0; pair < PAIRS; pair++)
        for (int k = 0; k < 3 && other == node + qs_pair_offset(f, pair); k++)
            for (int m = 0; m < 3; m++) to->block[pair][(3 * k + m) * to->stride + node] += block[k][m][lane];
}

static void add_cuts(const Membrane *f, const double *x, double pressure, const CutGroup *cut, const Stencil *to) {
    Corner c = {.over = {0}};
    Lanes g[2][3] = {{{0}}}, height = {0}; /* differences of large numbers for small triangles */
    for (int a = 0; a < 3; a++)
        for (int n = 0; n < LANES; n++) {
            for (int p = 0; p < 2; p++)
                for (int k = 0; k < 3; k++) g[p][k][n] += (p ? cut->by_y : cut->by_x)[a][n] * x[k * f->count + (long)cut->node[a][n]];
            height[n] += x[2 * f->count + (long)cut->node[a][n]] / 3;
        }
    c.height = eight_of(height);
    for (int p = 0; p < 2; p++)
        for (int k = 0; k < 3; k++) c.g[p][k] = (float)(k == p) + eight_of(g[p][k]);
    strain(f, &c, eight_at(cut->area));
    for (int a = 0; a < 3; a++) {
        for (int k = 0; k < 3; k++) {
            const Eight by = eight_at(cut->by_x[a]) * c.tension_by[0][k] + eight_at(cut->by_y[a]) * c.tension_by[1][k];
            for (int n = 0; n < LANES; n++)
                if (cut->node[a][n] > 0) to->tension_by[k * to->stride + (long)cut->node[a][n]] += by[n];
        }
        for (int b = 0; b < 3; b++) {
            Eight block[3][3];
            between_corners(cut, &c, pressure, a, b, block);
            for (int n = 0; n < LANES; n++)
                if (cut->node[a][n] > 0 && cut->node[b][n] > 0) add_entries(f, to, (long)cut->node[a][n], (long)cut->node[b][n], block, n);
        }
    }
}

void qs_stencil(const Membrane *f, const double *x, double pressure, const Stencil *to) {
    memset(to->block[0], 0, qs_stencil_size(f) * sizeof *to->block[0]);
    for (long i = 0; i < f->columns - 1; i++)
        for (long j = 0; j < f->line; j += LANES)
            for (int corner = 0; corner < 4; corner++) add_corner(f, x, pressure, i, j, corner / 2, corner % 2, to);
    for (long g = 0; g < f->groups; g++) add_cuts(f, x, pressure, qs_cut_group(f, g), to);
}

void qs_stencil_times(const Membrane *f, const Stencil *s, long first, long last, const Eight *restrict what, Eight *restrict to) {
    const long count = f->count, node_stride = s->stride;
    for (long node = first * f->line; node < last * f->line; node++) {
        if (node % f->line >= f->rows) continue;
        Eight own[3], sum[3];
        for (int k = 0; k < 3; k++) own[k] = what[k * count + node], sum[k] = to[k * count + node];
        for (int k = 0; k < 3; k++)
            for (int m = 0; m < 3; m++) sum[k] += s->block[PAIR_OWN][(3 * k + m) * node_stride + node] * own[m];
        for (int pair = PAIR_UP; pair < PAIRS; pair++) {
            const long other = node + qs_pair_offset(f, pair);
            if (other >= count) continue;
            const float *block = s->block[pair] + node;
            Eight there[3], back[3];
            for (int k = 0; k < 3; k++) there[k] = what[k * count + other], back[k] = to[k * count + other];
            for (int k = 0; k < 3; k++)
                for (int m = 0; m < 3; m++) {
                    const float by = block[(3 * k + m) * node_stride];
                    sum[k] += by * there[m], back[m] += by * own[k];
                }
            for (int k = 0; k < 3; k++) to[k * count + other] = back[k];
        }
        for (int k = 0; k < 3; k++) to[k * count + node] = sum[k];
    }
}

void qs_stencil_band(const Membrane *f, const Stencil *s, double *band) {
    const long stride = BAND_STRIDE(QS_WIDTH(f));
    memset(band, 0, 3 * f->inner * stride * sizeof *band);
    for (long node = 0; node < f->count; node++)
        for (int pair = 0; pair < PAIRS && qs_inner(f, node) >= 0; pair++) {
            const long first = 3 * qs_inner(f, node), other = 3 * qs_inner(f, node + qs_pair_offset(f, pair));
            for (int k = 0; k < 3 && other >= 0; k++)
                for (int l = pair == PAIR_OWN ? k : 0; l < 3; l++)
                    band[(first + k) * stride + other + l - first - k] = qs_block(s, pair, k, l, node);
        }
    for (long k = 0; k < 3 * f->inner; k++) /* a node fixed by an outline has a row of its own */
        if (band[k * stride] == 0) band[k * stride] = 1;
}
