/* Common parts of the kernels of a quasi-static membrane: workspace, obstacles at the nodes, and
   gas. */
#ifndef MJTACTILE_FILM_WORK_H
#define MJTACTILE_FILM_WORK_H
#include "quasistatic.h"
#include "qs_sheet.h"

enum { CONVERGED, NOT_CONVERGED, RIM_CONTACT, GLASS_CONTACT, INVERTED, NUMERICAL_FAILURE, TUNNELLING, OVERSTRETCHED };

/* Results, one row per environment. */
enum { FORCE_X, FORCE_Y, FORCE_Z, TORQUE_X, TORQUE_Y, TORQUE_Z, PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED_AREA, TENSION,
       LAST_STEP, FOUND };

/* Settings of a solution. gas: p V^gamma if sealed, otherwise the constant gauge pressure, Pa.
   again: retry without contact and in small steps if another start fails. below_rim: depth of
   obstacles, m, down to which the frame's rim supports them. */
typedef struct { double gas, sealed, tolerance, max_steps, again, below_rim; } Settings;

/* faces: see `film_faces`; 0: none */
typedef struct { long count; const double *body, *pool, *faces; } Bodies;

static inline const FilmBody *film_body_of(const Bodies *bodies, long number) {
    return (const FilmBody *)(bodies->body + number * FILM_BODY);
}

#define FILM_WAYS 3  /* directions in which a plane can face: down, up and neither */
#define FILM_SIDE 4  /* planes that are processed together */
/* Face values of hulls, one hull after the other, stored for a solution, in which poses are
   constant. `film_faces_of` is the number of values of one obstacle. `film_faces_height` gives the
   result of `film_body_height` for a hull from its own values. */
static inline long film_faces_stride(const FilmBody *body) { return (long)body->number + FILM_WAYS * (FILM_SIDE - 1); }
static inline long film_faces_of(const FilmBody *body) { return body->kind == BODY_CONVEX ? FILM_SIDE + 3 * film_faces_stride(body) : 0; }
void film_faces(const Bodies *bodies, double *faces);
int film_faces_height(const Film *film, const FilmBody *body, const double *faces, double x, double y, double *height, double slope[2]);

#define FILM_FLOORS 32   /* maximum number of obstacles with lower bounds */
#define FILM_TANGENTS 5  /* tangent planes of each */
#define FILM_PLANES (3 * (FILM_TANGENTS + 1)) /* numbers of these, and of a horizontal plane */

/* Obstacles at the nodes, and nodes in contact. Fields (count). */
typedef struct {
    /* heights, see `follow_bodies`, slopes (2, count), correction */
    double *obstacle, *level, *slope, *lower;
    double *away; /* (2, count), m: from a node to a thin obstacle that was moved under it */
    double *edge, *spring;                    /* (4, count): see `find_edges` and `find_springs` */
    double *along_x, *along_y;                /* links of the membrane, see qs_sheet.h */
    double *cell;                             /* projected area of a node's cell, m^2 */
    double *planes;                           /* (FILM_FLOORS, FILM_PLANES), see `find_floors` */
    long floors; /* number of obstacles with lower bounds; -1: unknown */
    uint8_t *touching;
    uint8_t *wanted; /* 1 if an obstacle may soon be at the membrane here, or at a neighbor */
    /* lines and nodes on them beyond which there is no obstacle: first, last plus one, for each */
    long box[4];
    int narrow;                               /* 1 if obstacles are not evaluated beyond the box */
} Seen;

static inline double *film_take(double **from, long n) {
    double *here = *from;
    *from += n;
    return here;
}

long film_seen_size(const Film *film);
Seen film_seen_in(const Film *film, double **room); /* initially empty */

/* Convert between Python's fields of nodes only and padded ones; `fields` of them, one after the
   other. */
void film_pad(const Film *film, long fields, const double *from, double *to);
void film_unpad(const Film *film, long fields, const double *from, double *to);

/* Mark nodes with a contact force as in contact. The box begins with these nodes and grows with the
   obstacles. */
void see_touch(const Film *film, const double *force, Seen *seen);
/* Restrict the evaluation of obstacles to nodes near the contact, if they are neither thin nor
   sharp. */
void look_narrowly(const Film *film, const Bodies *bodies, Seen *seen);
/* Compute planes below all obstacles, by tangents about the contact. They are valid while the
   obstacles stay in place, or are lifted. */
void find_floors(const Film *film, const Bodies *bodies, Seen *seen);
/* Compute the height (count) below which there is no obstacle, at each of some positions. */
void floor_at(const Seen *seen, long count, const double *x, const double *y, double *floor);
/* Evaluate the obstacles: heights and slopes over the nodes at their present positions; edges next
   to a node, to 2^-halves; heights from the last slopes; corrections. */
void see_bodies(const Film *film, const Bodies *bodies, const double *x, Seen *seen);
void find_edges(const Film *film, const Bodies *bodies, const double *x, long node, int halves, Seen *seen);
void follow_bodies(const Film *film, const double *x, Seen *seen);
void lower_round_bodies(const Film *film, Seen *seen);
/* Return 1 if an obstacle is behind the membrane between its nodes: by more than they can detect,
   or where none of them is in contact. */
int goes_through(const Film *film, const Bodies *bodies, const double *x, const Seen *seen);
int against_the_frame(const Film *film, const Settings *set, const Seen *seen);
/* Compute the springs of a membrane that bends over edges, (4, count) by the side of the node on
   the obstacle. Returns a number that identifies the set of springs. */
double find_springs(const Film *film, const double *z, Seen *seen);
/* Return the height of the node at a side of `k` above the extended face. */
double rises_over_edge(const Film *film, const Seen *seen, const double *z, long k, int side);
static inline long film_next(const Film *film, int side) { /* sides: +x, -x, +y, -y */
    return side < 2 ? (side ? -film->line : film->line) : side == 2 ? 1 : -1;
}

void gas_of(const Film *film, const Settings *set, double bulge, double *pressure, double *stiffness);
/* Compute the wrench about the origin of S and the contact area in `found`, whose pressure and
   tension are known. */
void add_up(const Film *film, const double *x, const double *force, double *found, const Seen *seen);

#endif
