/* All kernels. One declaration a line or wrapped, arrays as pointers: library.py reads this file. Return value, where there is
   one: 0 for success. */
#ifndef MJTACTILE_KERNELS_H
#define MJTACTILE_KERNELS_H
#include <stdint.h>

/* sim/picture/renderer.py: blurred discs and a closed curve added to an image `coverage` (height, width). `across` (bins, taps)
   and `down` (bins, taps + 1): see discs.c; `per_px` nodes to a pixel of a rim. `nodes` (count, 2) px, `weights` (count) dx. */
int64_t draw_discs(int64_t n, const double *p_CM, const double *n_C, const double *radii, const double *camera, double per_px,
                   int64_t bins, int64_t taps, const float *across, const float *down, int64_t height, int64_t width,
                   float *coverage);
int64_t fill_curve(int64_t count, const double *nodes, const double *weights, int64_t bins, int64_t taps, const float *across,
                   const float *down, int64_t height, int64_t width, float *coverage);
/* In place: grey levels of what is covered by markers, from the membrane's `contrast` to them and the relative `light`. */
void shade(int64_t count, double marker, double gain, const float *contrast, const float *light, float *coverage);
/* Out: `pixels`, noise added and rounded. */
void expose(int64_t count, const float *gray, const float *noise, double noise_dn, uint8_t *pixels);

/* sim/picture/shadows.py: `out` (count, channels) of `grid` (rows, columns, channels) at `places` (count, 2), fractional columns
   and rows, cut to the grid. */
void bilinear(int64_t rows, int64_t columns, int64_t channels, const double *grid, int64_t count, const double *places,
              double *out);

/* run/scene_picture.py: triangles `corners` (n, 3, 3), right, up, towards the viewer, in their colours `rgb` (n, 3), painted into
   `image` (height, width, 3), whose width goes from -1 to 1, where they are nearer than `depth` (height, width). */
void paint_triangles(int64_t n, const double *corners, const double *rgb, int64_t height, int64_t width, double *depth,
                     double *image);

/* shape/surface.py: the spline through markers `p_SM` (n, 3) with `variance` (n) of their heights and normals `n_S` (n, 3) or
   NULL; `settings` (11): see surface.c. Bands, here and below, as in band.h. Out: `c` (ny, nx), the band of the Cholesky `factor`
   of its inverse covariance, `found` (2): misfit, markers used. */
int64_t fit_surface(int64_t n, const double *p_SM, const double *variance, const double *n_S, const double *settings,
                    const double *prior, double *c, double *factor, double *found);
/* Tables: `grid_x` (nx, grid_nx), `grid_y` (grid_ny, ny), and values and slopes `quad_x` (2, nx, qx), `quad_y` (2, qy, ny). Out:
   heights `z` (grid_ny, grid_nx), `found` (4): area, volume, and their sd. */
int64_t measure_surface(int64_t nx, int64_t ny, const double *c, const double *factor, double misfit, int64_t grid_nx,
                        int64_t grid_ny, const double *grid_x, const double *grid_y, int64_t qx, int64_t qy, const double *quad_x,
                        const double *quad_y, const double *weights, const double *volume_c, const double *stiffness, double *z,
                        double *found);

/* force/sheet.py: `numbers` (11) and `law` of a sheet as in sheet.h; `c`, `gradient` and forces (3, n). Out: `elastic` forces
   and the bulge's `gradient`; returns the bulge, m^3 (NaN: no memory). */
double sheet_state(const double *numbers, const double *law, const double *c, double scale, double *elastic, double *gradient);
/* Out: the band of the stiffness at constant pressure, components of a spline together. */
int64_t sheet_tangent(const double *numbers, const double *law, const double *c, double scale, double pressure, double *band);
/* In place: a band's Cholesky factor, pushed towards the identity until it is definite. */
int64_t factor_definite(int64_t n, int64_t width, double *band);
/* Out: `softened` (3 n), what a factorised stiffness makes of the gas's `gradient`; returns the share of it in inverses. */
double soften(const double *numbers, const double *factor, const double *gradient, double gas_stiffness, double *softened);
/* Out: displacements `out` (3, n) by `forces`. */
int64_t sheet_solve(const double *numbers, const double *factor, const double *softened, double share, const double *forces,
                    double *out);

/* force/inverse.py: r rows, the whitened positions of `markers` at `material` (markers, 2) by `weights` (markers, 3, 3) and,
   where `tilts` (2, markers, 2, 3) is not NULL, two slopes each; J = jx jy nodes. Out: `half` (r, 3 J) and what they see of a
   `bulge` (3, n). */
int64_t inverse_gain(const double *numbers, const double *factor, const double *softened, double share, int64_t markers,
                     const double *material, const double *weights, const double *tilts, int64_t jx, int64_t jy,
                     const double *load_x, const double *load_y, const double *root_x, const double *root_y, const double *prior,
                     const double *bulge, double *half, double *bulge_seen);
/* `innovation` (r, r): its lower factor; `data` (markers, 3) displacements, `slopes_off` (markers, 2) or NULL. Out: `change`
   (3, n) of c, `traction` (3, J), `misfit` and `noise` (r), `drift_found` (4) in sd. */
int64_t inverse_step(const double *numbers, const double *factor, const double *softened, double share, int64_t markers,
                     const double *material, const double *weights, const double *tilts, int64_t jx, int64_t jy,
                     const double *load_x, const double *load_y, const double *root_x, const double *root_y, const double *prior,
                     const double *innovation, const double *drift, const double *gas_load, const double *c,
                     const double *residual, const double *data, const double *slopes_off, double *change, double *traction,
                     double *misfit, double *noise, double *drift_found);

/* Out: covariance `cov` (6, 6) of the net wrench of tractions on nodes at `positions` (J, 3) with `areas` (J), given what r
   markers saw. */
int64_t wrench_posterior(int64_t r, int64_t jx, int64_t jy, const double *root_x, const double *root_y, const double *prior,
                         const double *positions, const double *areas, const double *half, const double *innovation,
                         double *cov);

/* touch/patches.py: a patch on nodes (nx, ny), of which the inner ones carry `traction` (3, J) Pa on `node_area` (J) and have `sunk`
   (J) m, and on a grid (na, nb) `refine` times as fine, of `position` (3, na, nb) m, with the pressure `fine` (na, nb). `owner`
   (na, nb): the `number` of each point's patch, or NULL for one alone; `settings` (8): see patches.c. Returns 1, or 0 where it
   carries too little to be one. Out: its cells `inside` (na, nb), zero before, its nodes `mask` (ny, nx), `found` (10): force,
   centroid, depth, area, semi-axes, angle. */
int64_t measure_patch(int64_t nx, int64_t ny, int64_t refine, const double *fine, const double *position, const int32_t *owner,
                      int64_t number, const double *traction, const double *node_area, const double *sunk, double gauge,
                      double node_variance, const double *settings, uint8_t *inside, uint8_t *mask, double *found);

/* image/candidates.py: area moments of n borders, `counts` (n) points each in `points` (x, y) of an image (height, width); out:
   `misfit` (n) px, the largest distance of the border from the ellipse with these moments, and whether the image cuts it. */
int64_t border_moments(int64_t n, const int64_t *counts, const int32_t *points, int64_t height, int64_t width, double *centers,
                       double *shapes, double *misfit, int64_t *cut);
/* image/markers.py: out: `status` (n) of borders, of fits, and whether a fit is likely a marker at all; `settings` (29): see
   candidates.c; `levels` (2, n) and `found` (5, n) as below; `sign`: 1 for dark markers, -1 for bright ones. */
int64_t judge_borders(int64_t n, const double *shapes, const double *misfit, const int64_t *cut, double min_radius,
                      const double *settings, int64_t *status);
int64_t judge_fits(int64_t n, const double *centers, const double *shapes, const double *cov, const double *levels,
                   const double *found, const double *starts, const double *start_shapes, const double *misfit,
                   const int64_t *cut, double sign, int64_t height, int64_t width, double min_radius, const double *settings,
                   int64_t *status, int64_t *keep);
/* image/ellipse.py: semi-axes (n, 2), angles (n) and the covariance (n, 5, 5) of (u, v, a, b, angle) from those of (u, v, p, q, s) */
int64_t ellipse_axes(int64_t n, const double *shapes, const double *cov, double *semi_axes, double *angles, double *out);

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

/* pose/identity.py: `ids` (n) of circles `found` (n, 2) m among m markers, -1 for none; `expected`, `layout` (m, 2) m, `order`
   (m, k) each one's nearest markers; `settings` (5): see identity.c. NaN: not known. */
int64_t match_markers(int64_t n, int64_t m, int64_t k, const double *found, const double *expected, const double *layout,
                      const int64_t *order, double pitch, const double *settings, int64_t *ids);
/* Circles that were found to be markers, `circles` (count) of N, `factors` (count) times as large as assumed, seen from the
   `origin` (3): the one of their two poses (N, 3) whose normal fits the surface through all of the first, of which the `slopes`
   (2, count, count) are by its heights. `work` (2, count). Out: places `p` in S, `normals` (count, 3), `cov_p` (count, 3, 3). */
void name_circles(int64_t count, const int64_t *circles, const double *first, const double *first_n, const double *second,
                  const double *second_n, const double *cov, const double *factors, const double *camera, const double *origin,
                  const double *slopes, double *work, double *p, double *normals, double *cov_p);
/* sim/sensor/chamber.py: volume between vertices `p` (n, 3) and the plane z = 0; out: its `gradient` (n, 3). */
double chamber_volume(int64_t n, const double *p, int64_t m, const int64_t *triangles, double *gradient);
/* What a gas of this pressure and stiffness does to k vertices that have `moved` (k, 3): the tendon's `coefficients` (k), its
   `spring` (1) and length at `rest` (2), off by `offset_share` of what adds up to it; and `forces` (k, 3). */
void push(int64_t k, const double *gradient, const double *moved, double offset_share, double least, double pressure,
          double stiffness, double *coefficients, double *spring, double *rest, double *forces);
/* Here and below, MuJoCo's `contacts`: how many, the address of the first one's `dist`, and the `layout` (9) of the `list`, see
   sim/sensor/contacts.py. */
/* sim/truth.py: out: total forces `loads` (n, 3) N, frame W, on n `membranes` (n, 3): first and last sphere, flex. */
void membrane_loads(int64_t contacts, int64_t list, const int64_t *layout, const double *force, int64_t n,
                    const int64_t *membranes, double *loads);
/* sim/sensor/rubber.py: MuJoCo's stiffness `rows` (m, 21), of which six are written, from the strain of triangles of `edges`
   (m, 3) between `ends` (e, 2). `metric` (m, 3, 3), `law` (5): mu, Poisson's ratio, lambda', its least and most. */
void rubber_stiffness(int64_t m, const int64_t *edges, const int64_t *ends, const double *p, const double *metric,
                      const double *law, const double *by_mu, const double *by_lambda, double *rows);
/* sim/sensor/facets.py: sums of the principal curvatures `out` (n) 1/m of MuJoCo's geoms of `kinds` and `sizes` (n, 3) where their
   surfaces have the `normals` (n, 3) in their frames; `end`: the least cosine of a normal to a cylinder's end. */
void curvatures(int64_t n, const int32_t *kinds, const double *sizes, const double *normals, double end, double *out);
/* The number of contacts with the spheres `first` to `first + count - 1`; out: curvatures (count) of what each of them touches,
   the mean where it touches nothing. `kinds`, `sizes` (g, 3) and `axes` (g, 3, 3) of all geoms. */
int64_t touched_curvatures(int64_t contacts, int64_t list, const int64_t *layout, int64_t first, int64_t count,
                           const int32_t *kinds, const double *sizes, const double *axes, double end, double *out);
/* sim/sensor/stiction.py: number of MuJoCo's contacts with the spheres `first` to `first + count - 1`. `memory` (count, 6) of
   friction and shift in S and `slides` (count) become those after this step; out: `goal` (count) of the margins, velocity of the
   `surface` (count, 3). None touched: all stay. */
int64_t stick(int64_t contacts, int64_t list, const int64_t *layout, const double *force, const double *kbip,
              const double *softness, const double *velocity, const double *travel, const double *R_WS, int64_t first,
              int64_t count, const double *settings, double *goal, double *memory, uint8_t *slides, double *surface);

#endif
