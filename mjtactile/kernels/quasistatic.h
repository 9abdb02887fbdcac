/* Quasi-static membrane on a regular grid over a gas, loaded by obstacles that are height fields
   over it. Equations: docs/theory/quasistatic_membrane.md. Fields are over all nodes
   (nodes_x, nodes_y), y fastest, including the fixed nodes on the frame. The solution has only
   inner nodes. Displacements are three fields: along x, along y, and the height. Python's fields
   have nodes only. In the kernels, lines along y are padded to whole vectors with nodes that do not
   exist and do not move. */
#ifndef MJTACTILE_QUASISTATIC_H
#define MJTACTILE_QUASISTATIC_H
#include <math.h>
#include <stdint.h>

#define QS_MAX_LINE 400
#define QS_LAW 11 /* number of coefficients of the law's polynomial, lowest power first */

typedef struct {
    double length_x, length_y, nodes_x, nodes_y;
    double lambda2;                          /* pre-stretch squared */
    /* modulus times thickness, N/m: mu h, or E h / (1 - nu^2) */
    double neo_hookean, modulus, poisson;
    /* center and scale of the polynomial's argument, 1 / sqrt(det C) */
    double law_middle, law_per_unit;
    double tension_slope; /* slope of the tension by the area ratio, dT/dJ, N/m */
    double shell;                            /* Young's modulus times thickness, N/m */
    double chamber_flat, ambient, polytropic_exponent;
    /* half thickness of the membrane, and depth of the chamber behind it, m */
    double half_thickness, depth;
    /* height that the membrane does not reach, m. An obstacle beyond is not over a node: an edge in
       front of it is an edge. */
    double roof;
    double opening;                          /* area of the frame's opening, m^2 */
    double cut; /* address of the cells that an outline cuts (qs_cut_cells.h); 0: rectangle */
} MembraneNumbers;

typedef struct {
    MembraneNumbers numbers;
    const double *law;
    /* over all nodes, for an outline: see qs_cut_cells.h; 0: rectangle */
    const double *inside, *uncut;
    const double *cuts;       /* triangles of cut cells, in groups of eight */
    long groups;
    int lopsided;             /* 1 if the outline changes under half a turn or a mirror along y */
    long columns, rows;       /* numbers of all nodes along x and along y */
    long inner_rows, inner;   /* numbers of inner nodes along y and in total */
    long line, count;         /* nodes of a padded line; of all lines */
    double dx, dy;
} Membrane;

Membrane qs_membrane(const double *numbers, const double *law);

static inline int qs_free(const Membrane *membrane, long i, long j) { /* 1 if node (i, j) is free */
    const int within = i > 0 && i < membrane->columns - 1 && j > 0 && j < membrane->rows - 1;
    return within && (!membrane->inside || membrane->inside[i * membrane->rows + j] > 0);
}

/* One obstacle, as Python passes it. */
typedef struct {
    double kind, sizes[3], R[9], p[3]; /* kind, sizes, R_SO by rows and p_SO */
    /* first entry and number of entries in the pool: planes, triangles, heights */
    double first, number;
    double min_width;                      /* minimum width, m */
    double reach;                      /* maximum distance from p, m */
} Obstacle;
#define QS_OBSTACLE 20

enum { BODY_SPHERE, BODY_CAPSULE, BODY_ELLIPSOID, BODY_CYLINDER, BODY_BOX, BODY_PLANE, BODY_QUADRIC, BODY_DISC, BODY_CONE,
       BODY_CONVEX, BODY_TRIANGLES, BODY_HEIGHTS };

#define QS_STEEPEST 4.0 /* ratio of distances at a slope of 75 degrees */

/* Return the ratio of a distance along z to the distance across a slope. It is limited: on steeper
   slopes the membrane meets the surface from the side. */
static inline double qs_farther_along_z(const double slope[2]) {
    const double farther = sqrt(1 + slope[0] * slope[0] + slope[1] * slope[1]);
    return farther < QS_STEEPEST ? farther : QS_STEEPEST;
}

/* Compute the height of the obstacle's lower side over (x, y), minus the membrane's half thickness,
   and its slopes. Returns 1, without a height, if the obstacle is not over that position. */
int qs_obstacle_height(const Membrane *membrane, const Obstacle *body, const double *pool, double x, double y, double *height,
                     double slope[2]);

#endif
