/* The film: a sheet on a regular grid over a gas, pressed by bodies that are heights over it; mjtactile/film has the equations.
   Fields are over all nodes (nodes_x, nodes_y), y fastest, the frame's among them, which never move; what is solved for are the
   inner nodes alone. Displacements are three fields: along x, along y, and the height. Python's fields are of nodes alone; inside,
   lines along y are padded to whole vectors with nodes that are none, and at rest. */
#ifndef MJTACTILE_FILM_H
#define MJTACTILE_FILM_H
#include <math.h>
#include <stdint.h>

#define FILM_MOST_LINE 400
#define FILM_LAW 11 /* coefficients of the law's polynomial, lowest first */

typedef struct {
    double length_x, length_y, nodes_x, nodes_y;
    double lambda2;                          /* pre-stretch squared */
    double neo_hookean, modulus, poisson;    /* modulus times thickness, N/m: mu h, or E h / (1 - nu^2) */
    double law_middle, law_per_unit;         /* of the polynomial's argument, 1 / sqrt(det C) */
    double tension_slope;                    /* dT/dJ at rest, N/m */
    double shell;                            /* Young's modulus times thickness, N/m */
    double chamber_flat, ambient, polytropic_exponent;
    double half_thickness, depth;            /* of the sheet; of the chamber behind it */
    double opening;                          /* m^2 of the frame's */
    double cut;                              /* address of what its outline leaves of the grid (film_cut.h); 0: all, of a rectangle */
} FilmNumbers;

typedef struct {
    FilmNumbers numbers;
    const double *law;
    const double *inside, *whole; /* over all nodes, of an outline: see film_cut.h; 0 of a rectangle */
    const double *cuts;       /* triangles of the cells that it cuts, in groups of eight */
    long groups;
    int lopsided;             /* whether half a turn, or a mirror along y, makes another outline of it */
    long columns, rows;       /* of all nodes: along x, along y */
    long inner_rows, inner;   /* of those that move */
    long line, count;         /* nodes of a padded line; of all lines */
    double dx, dy;
} Film;

Film film_of(const double *numbers, const double *law);

static inline int film_free(const Film *film, long i, long j) { /* whether node (i, j) moves */
    const int within = i > 0 && i < film->columns - 1 && j > 0 && j < film->rows - 1;
    return within && (!film->inside || film->inside[i * film->rows + j] > 0);
}

/* One body, as Python describes it. */
typedef struct {
    double kind, sizes[3], R[9], p[3]; /* R_SO by rows and p_SO */
    double first, number;              /* of its entries in the pool: planes, triangles, heights */
    double least;                      /* m, how wide it is where it is thinnest */
    double reach;                      /* m, how far from p it ends at the latest */
} FilmBody;
#define FILM_BODY 20

enum { BODY_SPHERE, BODY_CAPSULE, BODY_ELLIPSOID, BODY_CYLINDER, BODY_BOX, BODY_PLANE, BODY_QUADRIC, BODY_DISC, BODY_CONE,
       BODY_CONVEX, BODY_TRIANGLES, BODY_HEIGHTS };

#define FILM_STEEPEST 4.0 /* 75 degrees */

/* What a distance across a slope is along z; where it is too steep to follow, the surface is nearly met from the side. */
static inline double film_farther_along_z(const double slope[2]) {
    const double farther = sqrt(1 + slope[0] * slope[0] + slope[1] * slope[1]);
    return farther < FILM_STEEPEST ? farther : FILM_STEEPEST;
}

/* Height of the body's lower side over (x, y), as far out as the sheet's middle stays from it, and its slopes; 1 where the body
   is not over that place, and then nothing is written. */
int film_body_height(const Film *film, const FilmBody *body, const double *pool, double x, double y, double *height,
                     double slope[2]);

#endif
