/* Obstacles of a quasi-static membrane in a MuJoCo scene: their poses, and the equilibrium on them. */
#ifndef MJTACTILE_QS_SCENE_H
#define MJTACTILE_QS_SCENE_H
#include "quasistatic.h"
#include "qs_friction.h"

/* Arguments of a solution. */
typedef struct {
    const double *numbers, *law;
    int64_t columns, rows, keeping;
    const float *kept;
    const double *rest;
    int64_t roomy;
    double *room;
    int64_t geoms;
    double *body;
    int64_t pooled;
    const double *pool;
    double *x, *force, *trend, *found;
} Solution;

/* MuJoCo's geoms and bodies near a membrane. `slot`: patch of each geom; `of`: body of each patch. The membrane is within the
   half-extents, m, and from the glass at -`depth` to `top` m. */
typedef struct {
    long geoms, slots;
    const int64_t *geom, *slot, *of;
    const double *bounds, *geom_xpos, *geom_xmat, *xpos, *xmat;
    const double *R, *p;            /* pose of the carrier */
    double half_x, half_y, depth, top;
} Scene;

/* Write the poses of the geoms into the membrane's obstacles, and mark the near bodies. Returns 1
   if any geom has moved. */
int qs_place_obstacles(const Scene *s, double *rows, Memory *m, Patch *patches);

/* Compute the pose in S of the body of a patch. */
void qs_pose_of(const Scene *s, long slot, double R_SB[9], double p_SB[3]);

/* Return 1 if all obstacles are above the membrane: their bounding boxes, which rotate with them,
   are above its highest node. */
int qs_is_clear(const Membrane *f, const double *x, long geoms, const double *body, const double *bounds);

/* Find the equilibrium at the present poses. If there is none for more than LATE steps, raise the
   obstacles until there is one. They stay raised until the next call of `qs_place_obstacles`. Returns 1 if a
   solution was found, 0 if the last one is kept, or a negative error. */
int64_t qs_solve_scene(const Solution *c, const Scene *s, const double *settings, long nodes, double *keep, Memory *m, Patch *patches);

#endif
