/* All kernels. One declaration a line or wrapped, arrays as pointers: library.py reads this file. Return value, where there is
   one: 0 for success. */
#ifndef MJTACTILE_KERNELS_H
#define MJTACTILE_KERNELS_H
#include <stdint.h>

/* image/profiles.py: ellipses (n) from profiles across their edges in a softened image (height, width). `centers` (n, 2) and
   `shapes` (n, 3) are moved; `settings` (10): see profiles.c; out: `cov` (n, 5, 5) of (u, v, p, q, s), `levels` (2, n) inside and
   outside, `found` (5, n): blur, residual, number of profiles, share lost, motion. */
int64_t fit_profiles(const float *image, int64_t height, int64_t width, int64_t n, double *centers, double *shapes,
                     const double *settings, double *cov, double *levels, double *found);

/* pose/circles.py; `camera` (12): see optics.h; `covs` (n, 5, 5) of (u, v, a, b, angle). Out: `uv` (n, 2) px of the centre,
   `poses` (4, n, 3): centre and normal of the pose preferred, and of the other; `cov_p` (n, 3, 3). */
int64_t circle_poses(int64_t n, const double *centers, const double *semi_axes, const double *angles, const double *covs,
                     const double *radii, const double *camera, double *uv, double *poses, double *cov_p);
/* Out: covariances (n, 5, 5) of centre and (n_x, n_y) at fixed n_z of poses that were found for the ellipses. */
int64_t circle_covariances(int64_t n, const double *centers, const double *semi_axes, const double *angles, const double *covs,
                           const double *p, const double *normals, const double *camera, double *out);
/* Out: cones (n, 3, 3) of ellipses with `shapes` (n, 3), without the pane. */
int64_t cones(int64_t n, const double *centers, const double *shapes, const double *camera, double *out);
/* Out: `poses` (4, n, 3): centres of the first and the second circle on each cone `Q` (n, 3, 3), then their normals. */
int64_t circles_on_cones(int64_t n, const double *Q, const double *radii, double *poses);

#endif
