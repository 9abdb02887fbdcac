/* What a film's kernels share: their room, the bodies as nodes see them, and the gas. */
#ifndef MJTACTILE_FILM_WORK_H
#define MJTACTILE_FILM_WORK_H
#include "quasistatic.h"
#include "qs_sheet.h"

enum { CONVERGED, NOT_CONVERGED, RIM_CONTACT, GLASS_CONTACT, INVERTED, NUMERICAL_FAILURE, TUNNELLING, OVERSTRETCHED };

/* What is found, one row an environment. */
enum { FORCE_X, FORCE_Y, FORCE_Z, TORQUE_X, TORQUE_Y, TORQUE_Z, PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED_AREA, TENSION,
       LAST_STEP, FOUND };

typedef struct { double gas, sealed, tolerance, max_steps, again, below_rim; } Settings; /* gas: p V^gamma if sealed, else the pressure
    held; again: from rest, in small steps, where a start from elsewhere ends nowhere; below_rim: m that bodies may be below the frame's
    rim, which bears them there */

typedef struct { long count; const double *body, *pool, *faces; } Bodies; /* faces: see `film_faces`; 0: there are none */

static inline const FilmBody *film_body_of(const Bodies *bodies, long number) {
    return (const FilmBody *)(bodies->body + number * FILM_BODY);
}

#define FILM_WAYS 3  /* that a plane can face: down, up and neither */
#define FILM_SIDE 4  /* planes that are looked at side by side */
/* What a solution keeps of hulls, whose poses stay, one after the other, in so many numbers of each body; and what `film_body_height`
   says of one, by its own. */
static inline long film_faces_stride(const FilmBody *body) { return (long)body->number + FILM_WAYS * (FILM_SIDE - 1); }
static inline long film_faces_of(const FilmBody *body) { return body->kind == BODY_CONVEX ? FILM_SIDE + 3 * film_faces_stride(body) : 0; }
void film_faces(const Bodies *bodies, double *faces);
int film_faces_height(const Film *film, const FilmBody *body, const double *faces, double x, double y, double *height, double slope[2]);

#define FILM_FLOORS 32   /* bodies at most of which it is known where they cannot be */
#define FILM_TANGENTS 5  /* of each */
#define FILM_PLANES (3 * (FILM_TANGENTS + 1)) /* numbers of these, and of a level one */

/* Bodies as nodes see them, and what touches them. Fields (count). */
typedef struct {
    double *obstacle, *level, *slope, *lower; /* heights, see `follow_bodies`, slopes (2, count), correction */
    double *away;                             /* (2, count) m, from a node to what is thin and was moved under it */
    double *edge, *spring;                    /* see `find_edges` and `find_springs`, (4, count) */
    double *along_x, *along_y;                /* the sheet's links, see film_sheet.h */
    double *cell;                             /* m^2 of the plane that a node stands for */
    double *planes;                           /* (FILM_FLOORS, FILM_PLANES), see `find_floors` */
    long floors;                              /* bodies that have some; -1: it is not known */
    uint8_t *touching;
    uint8_t *wanted;                          /* whether a body may be where the sheet, or that of a neighbour, soon is */
    long box[4];                              /* of nodes, lines and places on them, beyond which there is no body: from, to behind */
    int narrow;                               /* beyond which bodies are not looked at */
} Seen;

static inline double *film_take(double **from, long n) {
    double *here = *from;
    *from += n;
    return here;
}

long film_seen_size(const Film *film);
Seen film_seen_in(const Film *film, double **room); /* nothing seen yet */

/* Between Python's fields of nodes alone and padded ones; `fields` of them, one after the other. */
void film_pad(const Film *film, long fields, const double *from, double *to);
void film_unpad(const Film *film, long fields, const double *from, double *to);

/* What touches is what bears a force; the box begins as what holds it, and grows with what is seen of bodies. */
void see_touch(const Film *film, const double *force, Seen *seen);
/* From now on bodies are looked at near what touches only, where that is all they are seen by: neither thin nor sharp. */
void look_narrowly(const Film *film, const Bodies *bodies, Seen *seen);
/* Planes below which the bodies are not, by tangents about what touches; they are used as long as bodies stay where they are, or are
   lifted. */
void find_floors(const Film *film, const Bodies *bodies, Seen *seen);
/* The height (count) below which no body is, at each of some places. */
void floor_at(const Seen *seen, long count, const double *x, const double *y, double *floor);
/* Of bodies: heights and slopes over the nodes where they are; where they end beside a node, to 2^-halves; corrections. */
void see_bodies(const Film *film, const Bodies *bodies, const double *x, Seen *seen);
void find_edges(const Film *film, const Bodies *bodies, const double *x, long node, int halves, Seen *seen);
void follow_bodies(const Film *film, const double *x, Seen *seen);
void lower_round_bodies(const Film *film, Seen *seen);
/* Whether a body is behind the sheet between its nodes: by more than they can tell, or where none of them touches. */
int goes_through(const Film *film, const Bodies *bodies, const double *x, const Seen *seen);
int against_the_frame(const Film *film, const Settings *set, const Seen *seen);
/* Springs of a sheet that bends over edges, (4, count) by the side of the node on the body; returns a number that tells which. */
double find_springs(const Film *film, const double *z, Seen *seen);
/* How much farther than the face, drawn on, the node at a side of `k` is. */
double rises_over_edge(const Film *film, const Seen *seen, const double *z, long k, int side);
static inline long film_next(const Film *film, int side) { /* +x, -x, +y, -y */
    return side < 2 ? (side ? -film->line : film->line) : side == 2 ? 1 : -1;
}

void gas_of(const Film *film, const Settings *set, double bulge, double *pressure, double *stiffness);
/* Wrench about S and the area that touches, into `found`, whose pressure and tension are known. */
void add_up(const Film *film, const double *x, const double *force, double *found, const Seen *seen);

#endif
