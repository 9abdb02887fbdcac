/* Common parts of the kernels of a quasi-static membrane: workspace, obstacles at the nodes, and
   gas. */
#ifndef MJTACTILE_QS_WORKSPACE_H
#define MJTACTILE_QS_WORKSPACE_H
#include "quasistatic.h"
#include "qs_elasticity.h"

enum { CONVERGED, NOT_CONVERGED, RIM_CONTACT, GLASS_CONTACT, INVERTED, NUMERICAL_FAILURE, TUNNELLING, OVERSTRETCHED };

/* Results, one row per environment. */
enum { FORCE_X, FORCE_Y, FORCE_Z, TORQUE_X, TORQUE_Y, TORQUE_Z, PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED_AREA, TENSION,
       LAST_STEP, FOUND };

/* Settings of a solution. gas: p V^gamma if sealed, otherwise the constant gauge pressure, Pa.
   again: retry without contact and in small steps if another start fails. below_rim: depth of
   obstacles, m, down to which the frame's rim supports them. sticks: the in-plane force of the
   contact is `shear`, N; otherwise there is no friction. */
typedef struct { double gas, sealed, tolerance, max_steps, again, below_rim, sticks, shear[2]; } Settings;

/* faces: see `qs_faces`; 0: none */
typedef struct { long count; const double *body, *pool, *faces; } Bodies;

static inline const Obstacle *qs_obstacle_at(const Bodies *bodies, long number) {
    return (const Obstacle *)(bodies->body + number * QS_OBSTACLE);
}

#define QS_DIRECTIONS 3  /* directions in which a plane can face: down, up and neither */
#define QS_SIDE 4  /* planes that are processed together */
/* Face values of hulls, one hull after the other, stored for a solution, in which poses are
   constant. `qs_faces_of` is the number of values of one obstacle. `qs_faces_height` gives the
   result of `qs_obstacle_height` for a hull from its own values. */
static inline long qs_faces_stride(const Obstacle *body) { return (long)body->number + QS_DIRECTIONS * (QS_SIDE - 1); }
static inline long qs_faces_of(const Obstacle *body) { return body->kind == BODY_CONVEX ? QS_SIDE + 3 * qs_faces_stride(body) : 0; }
void qs_faces(const Bodies *bodies, double *faces);
int qs_faces_height(const Membrane *membrane, const Obstacle *body, const double *faces, double x, double y, double *height, double slope[2]);

#define QS_FLOORS 32   /* maximum number of obstacles with lower bounds */
#define QS_TANGENTS 5  /* tangent planes of each */
#define QS_PLANES (3 * (QS_TANGENTS + 1)) /* numbers of these, and of a horizontal plane */

/* Obstacles at the nodes, and nodes in contact. Fields (count). */
typedef struct {
    /* heights, see `extrapolate_obstacles`, slopes (2, count), correction */
    double *obstacle, *level, *slope, *lower;
    double *owner; /* number of the obstacle over a node; -1: none, or a thin one next to it */
    double *away; /* (2, count), m: from a node to a thin obstacle that was moved under it */
    double *edge, *spring;                    /* (4, count): see `find_edges` and `find_springs` */
    double *along_x, *along_y;                /* links of the membrane, see qs_elasticity.h */
    double *cell;                             /* projected area of a node's cell, m^2 */
    double *planes;                           /* (QS_FLOORS, QS_PLANES), see `find_lower_bounds` */
    long floors; /* number of obstacles with lower bounds; -1: unknown */
    uint8_t *touching;
    uint8_t *requested; /* 1 if an obstacle may soon be at the membrane here, or at a neighbor */
    /* lines and nodes on them beyond which there is no obstacle: first, last plus one, for each */
    long box[4];
    int narrow;                               /* 1 if obstacles are not evaluated beyond the box */
} ContactNodes;

static inline double *qs_take(double **from, long n) {
    double *here = *from;
    *from += n;
    return here;
}

long qs_contact_size(const Membrane *membrane);
ContactNodes qs_contact_in(const Membrane *membrane, double **room); /* initially empty */
/* Return the fields as the last solution in this workspace left them. */
ContactNodes qs_last_contact(const Membrane *membrane, double **room);

/* Convert between Python's fields of nodes only and padded ones; `fields` of them, one after the
   other. */
void qs_pad(const Membrane *membrane, long fields, const double *from, double *to);
void qs_unpad(const Membrane *membrane, long fields, const double *from, double *to);

/* Mark nodes with a contact force as in contact. The box begins with these nodes and grows with the
   obstacles. */
void mark_contact(const Membrane *membrane, const double *force, ContactNodes *seen);
/* Restrict the evaluation of obstacles to nodes near the contact, if they are neither thin nor
   sharp. */
void limit_to_contact(const Membrane *membrane, const Bodies *bodies, ContactNodes *seen);
/* Compute planes below all obstacles, by tangents about the contact. They are valid while the
   obstacles stay in place, or are lifted. */
void find_lower_bounds(const Membrane *membrane, const Bodies *bodies, ContactNodes *seen);
/* Compute the height (count) below which there is no obstacle, at each of some positions. */
void lower_bound_at(const ContactNodes *seen, long count, const double *x, const double *y, double *floor);
/* Evaluate the obstacles: heights and slopes over the nodes at their present positions; edges next
   to a node, to 2^-halves; heights from the last slopes; corrections. */
void evaluate_obstacles(const Membrane *membrane, const Bodies *bodies, const double *x, ContactNodes *seen);
void find_edges(const Membrane *membrane, const Bodies *bodies, const double *x, long node, int halves, ContactNodes *seen);
void extrapolate_obstacles(const Membrane *membrane, const double *x, ContactNodes *seen);
void correct_round_obstacles(const Membrane *membrane, ContactNodes *seen);
/* Return 1 if an obstacle is behind the membrane between its nodes: by more than they can detect,
   or where none of them is in contact. */
int penetrates_membrane(const Membrane *membrane, const Bodies *bodies, const double *x, const ContactNodes *seen);
int check_rim_contact(const Membrane *membrane, const Settings *set, const ContactNodes *seen);
/* Compute the springs of a membrane that bends over edges, (4, count) by the side of the node on
   the obstacle. Returns a number that identifies the set of springs. */
double find_springs(const Membrane *membrane, const double *z, ContactNodes *seen);
/* Return the height of the node at a side of `k` above the extended face. */
double height_over_edge(const Membrane *membrane, const ContactNodes *seen, const double *z, long k, int side);
static inline long qs_next(const Membrane *membrane, int side) { /* sides: +x, -x, +y, -y */
    return side < 2 ? (side ? -membrane->line : membrane->line) : side == 2 ? 1 : -1;
}

void evaluate_gas(const Membrane *membrane, const Settings *set, double bulge, double *pressure, double *stiffness);
/* Compute the wrench about the origin of S and the contact area in `found`, whose pressure and
   tension are known. */
void sum_contact(const Membrane *membrane, const double *x, const double *force, double *found, const ContactNodes *seen);

#endif
