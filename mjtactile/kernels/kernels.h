/* Declarations of all kernels, parsed by bindings.py. There is one declaration per line, or it is
   wrapped. The comment after each array gives its required shape, in terms of the call's integers
   and of the macros below. NULL is allowed only where stated. A function that returns int64_t
   returns a negative code on failure, otherwise 0 or the stated value. */
#ifndef MJTACTILE_KERNELS_H
#define MJTACTILE_KERNELS_H
#include <stdint.h>

enum { NO_MEMORY = -1, REFUSED = -2, NOT_DEFINITE = -3 };

#define CAMERA_NUMBERS 16 /* of a `Camera`: see optics.h */
/* Stride of a band's columns: panels of four columns and vectors of four need seven rows more. */
#define BAND_STRIDE(width) (((width) + 11) / 4 * 4)
#define SPLINE_BAND_WIDTH(ny) (9 * (ny) + 11) /* band width of a membrane's stiffness */
#define SURFACE_WIDTH(nx) (3 * (nx) + 3) /* band width of a surface's normal equations */

/* Add blurred discs, or a closed curve, to an image `coverage` (sim/rendering/renderer.py).
   `across`, `down`: see render_discs.c. `per_px`: nodes per pixel of a rim. `nodes`: points of the
   curve, px; `weights`: dx. */
int64_t render_discs(int64_t n, const double *p_CM /* n, 3 */, const double *n_C /* n, 3 */, const double *radii /* n */,
                   const double *camera /* CAMERA_NUMBERS */, double per_px, int64_t bins, int64_t taps,
                   const float *across /* bins, taps */, const float *down /* bins, taps + 1 */, int64_t height, int64_t width,
                   float *coverage /* height, width */);
int64_t fill_curve(int64_t count, const double *nodes /* count, 2 */, const double *weights /* count */, int64_t bins,
                   int64_t taps, const float *across /* bins, taps */, const float *down /* bins, taps + 1 */, int64_t height,
                   int64_t width, float *coverage /* height, width */);
/* Compute gray levels in place of the `coverage` by markers, from the membrane's `contrast` to a
   `marker`, the relative `light` and a `gain`. */
void shade(int64_t count, double marker, double gain, const float *contrast /* count */, const float *light /* count */,
           float *coverage /* count */);
/* Compute `pixels`: gray levels plus noise, rounded. */
void expose(int64_t count, const float *gray /* count */, const float *noise /* count */, double noise_dn,
            uint8_t *pixels /* count */);

/* Interpolate `grid` bilinearly at `places`, fractional columns and rows, clipped to the grid
   (sim/rendering/shadows.py). */
int64_t bilinear(int64_t rows, int64_t columns, int64_t channels, const double *grid /* rows, columns, channels */,
                 int64_t count, const double *places /* count, 2 */, double *out /* count, channels */);

/* Paint triangles with colors `rgb` into `image` where they are nearer than `depth`
   (report/software_renderer.py). `corners`: right, up, towards the viewer. The width of the image
   is from -1 to 1. */
void paint_triangles(int64_t n, const double *corners /* n, 3, 3 */, const double *rgb /* n, 3 */, int64_t height,
                     int64_t width, double *depth /* height, width */, double *image /* height, width, 3 */);

/* Fit the spline through markers `p_SM` with `variance` of their heights and normals `n_S`
   (sensing/surface/surface.py). `settings`: see smoothing_spline.c. Bands, here and below: see
   band_cholesky_f64.h. Out: coefficients `c`; band of the Cholesky `factor` of their inverse
   covariance; `found`: misfit, number of markers used. */
int64_t fit_surface(int64_t n, const double *p_SM /* n, 3 */, const double *variance /* n */,
                    const double *n_S /* n, 3 or NULL */, int64_t nx, int64_t ny, const double *settings /* 9 */,
                    const double *prior /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *c /* ny, nx */,
                    double *factor /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *found /* 2 */);
/* Measure a fitted surface. Tables: `grid_x`, `grid_y`, and values and slopes `quad_x`, `quad_y`.
   Out: heights `z`; `found`: area, volume and their standard deviations. */
int64_t measure_surface(int64_t nx, int64_t ny, const double *c /* ny, nx */,
                        const double *factor /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double misfit, int64_t grid_nx,
                        int64_t grid_ny, const double *grid_x /* nx, grid_nx */, const double *grid_y /* grid_ny, ny */,
                        int64_t qx, int64_t qy, const double *quad_x /* 2, nx, qx */, const double *quad_y /* 2, qy, ny */,
                        const double *weights /* qy, qx */, const double *volume_c /* ny, nx */,
                        const double *stiffness /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *z /* grid_ny, grid_nx */,
                        double *found /* 4 */);

/* Compute the state of a membrane of nx, ny splines, at least four each, at coefficients `c`
   (sensing/force/spline_fem.py). `numbers`, `law`: see spline_fem.h. `turns`: derivatives of the
   parametric coordinates by position at the Gauss points, see spline_fem.c; NULL if both are the
   same. Out: `elastic` forces; `gradient`, m^2, and `volume`, m^3, of the bulge. */
int64_t spline_state(int64_t nx, int64_t ny, const double *numbers /* 8 */, int64_t entries, const double *law /* 2, entries */,
                    const double *turns /* 2 * (nx - 1), 2 * (ny - 1), 5 or NULL */, const double *c /* 3, nx, ny */,
                    double scale, double *elastic /* 3, nx, ny */, double *gradient /* 3, nx, ny */, double *volume /* 1 */);
/* Compute the band of the stiffness at constant pressure, with the components of a spline
   together. */
int64_t spline_tangent(int64_t nx, int64_t ny, const double *numbers /* 8 */, int64_t entries,
                      const double *law /* 2, entries */,
                      const double *turns /* 2 * (nx - 1), 2 * (ny - 1), 5 or NULL */, const double *c /* 3, nx, ny */,
                      double scale, double pressure, double *band /* 3 * nx * ny, BAND_STRIDE(SPLINE_BAND_WIDTH(ny)) */);
/* Compute a band's Cholesky factor in place. Multiples of the identity are added until it is
   positive definite. */
int64_t factor_definite(int64_t n, int64_t width, double *band /* n, BAND_STRIDE(width) */);
/* Compute `softened`, w: the solution of a factored stiffness for the gas's `gradient`. Returns the
   factor `fraction` of the gas's change of the inverse, -share w w^T. */
double soften(int64_t nx, int64_t ny, const double *factor /* 3 * nx * ny, BAND_STRIDE(SPLINE_BAND_WIDTH(ny)) */,
              const double *gradient /* 3, nx, ny */, double gas_stiffness, double *softened /* 3, nx, ny */);
/* Compute displacements `out` due to `forces`. */
int64_t spline_solve(int64_t nx, int64_t ny, const double *factor /* 3 * nx * ny, BAND_STRIDE(SPLINE_BAND_WIDTH(ny)) */,
                    const double *softened /* 3, nx, ny */, double fraction, const double *forces /* 3, nx, ny */,
                    double *out /* 3, nx, ny */);

/* Linearize r observations of the membrane (sensing/force/inverse_fem.py): the positions of
   `markers` at `material`, whitened by `weights`, and two slopes each if `tilts` is given. Out:
   `half`, the observations times loads and root of the prior covariance; `bulge_seen`, the
   observations of a `bulge`. */
int64_t inverse_gain(int64_t nx, int64_t ny, const double *numbers /* 8 */,
                     const double *factor /* 3 * nx * ny, BAND_STRIDE(SPLINE_BAND_WIDTH(ny)) */, const double *softened /* 3, nx, ny */,
                     double fraction, int64_t r, int64_t markers, const double *material /* markers, 2 */,
                     const double *weights /* markers, 3, 3 */, const double *tilts /* 2, markers, 2, 3 or NULL */, int64_t jx,
                     int64_t jy, const double *load_x /* nx, jx */, const double *load_y /* ny, jy */,
                     const double *root_x /* jx, jx */, const double *root_y /* jy, jy */, const double *prior /* 3, jx, jy */,
                     const double *bulge /* 3, nx, ny */, double *half /* r, 3, jx, jy */, double *bulge_seen /* r */);
/* Do one Gauss-Newton step. `innovation`: lower factor of the observations' covariance. `data`:
   displacements, and `slopes_off` if there are tilts. Out: `change` of c, `traction`, `misfit`,
   `noise`, and `drift_found` in standard deviations. */
int64_t inverse_step(int64_t nx, int64_t ny, const double *numbers /* 8 */,
                     const double *factor /* 3 * nx * ny, BAND_STRIDE(SPLINE_BAND_WIDTH(ny)) */, const double *softened /* 3, nx, ny */,
                     double fraction, int64_t r, int64_t markers, const double *material /* markers, 2 */,
                     const double *weights /* markers, 3, 3 */, const double *tilts /* 2, markers, 2, 3 or NULL */, int64_t jx,
                     int64_t jy, const double *load_x /* nx, jx */, const double *load_y /* ny, jy */,
                     const double *root_x /* jx, jx */, const double *root_y /* jy, jy */, const double *prior /* 3, jx, jy */,
                     const double *innovation /* r, r */, int64_t modes, const double *drift /* r, modes */,
                     const double *gas_load /* 3, nx, ny */,
                     const double *c /* 3, nx, ny */, const double *residual /* 3, nx, ny */, const double *data /* markers, 3 */,
                     const double *slopes_off /* markers, 2 or NULL */, double *change /* 3, nx, ny */,
                     double *traction /* 3, jx, jy */, double *misfit /* r */, double *noise /* r */,
                     double *drift_found /* modes */);

/* Solve L x = b with the lower factor L for k columns b. `x`: b on input, x on output. */
int64_t solve_lower(int64_t n, int64_t k, const double *factor /* n, n */, double *x /* n, k */);

/* Compute the covariance `cov` of the net wrench of tractions on nodes at `positions` with `areas`,
   given r observations. */
int64_t wrench_posterior(int64_t r, int64_t jx, int64_t jy, const double *root_x /* jx, jx */, const double *root_y /* jy, jy */,
                         const double *prior /* 3, jx, jy */, const double *positions /* jx * jy, 3 */,
                         const double *areas /* jx, jy */, const double *half /* r, 3, jx, jy */,
                         const double *innovation /* r, r */, double *cov /* 6, 6 */);

/* Measure one contact patch (sensing/touch/patches.py). On nodes (nx, ny), the inner ones have
   `traction`, Pa, `node_area` and indentation `sunk`, m. The grid (na, nb) is `refine` times as
   fine, with `position`, m, and pressure `fine`. `owner`: patch of each point, `number` is this
   one; NULL: only one patch. `settings`: see patches.c. Returns 1, or 0 if the force is too small
   for a patch. Out: its cells `inside`, zero on input; its nodes `mask`; `found`: force, centroid,
   depth, area, semi-axes, angle. */
int64_t measure_patch(int64_t nx, int64_t ny, int64_t refine, int64_t na, int64_t nb, const double *fine /* na, nb */,
                      const double *position /* 3, na, nb */,
                      const int32_t *owner /* na, nb or NULL */, int64_t number,
                      const double *traction /* 3, nx - 2, ny - 2 */, const double *node_area /* nx - 2, ny - 2 */,
                      const double *sunk /* nx - 2, ny - 2 */, double gauge, double node_variance, const double *settings /* 8 */,
                      uint8_t *inside /* na, nb */, uint8_t *mask /* ny, nx */, double *found /* 10 */);

/* Compute area moments of n borders (sensing/image/candidates.py), with `counts` points each in
   `points` (x, y) of an image (height, width). Out: `misfit`, px, the maximum distance of a border
   from the ellipse with these moments; `cut`, 1 if the image cuts it. */
int64_t border_moments(int64_t n, const int64_t *counts /* n */, int64_t all, const int32_t *points /* all, 2 */, int64_t height,
                       int64_t width, double *centers /* n, 2 */, double *shapes /* n, 3 */, double *misfit /* n */,
                       int64_t *cut /* n */);
/* Classify borders and fits (sensing/image/fit_validation.py). Out: `status`; `keep`, 1 for a
   probable marker. `settings`: see candidates.c. `levels`, `found`: as in fit_profiles. `sign`: 1
   for dark markers, -1 for bright ones. */
int64_t check_borders(int64_t n, const double *shapes /* n, 3 */, const double *misfit /* n */, const int64_t *cut /* n */,
                      double min_radius, const double *settings /* 29 */, int64_t *status /* n */);
int64_t check_fits(int64_t n, const double *centers /* n, 2 */, const double *shapes /* n, 3 */, const double *cov /* n, 5, 5 */,
                   const double *levels /* 2, n */, const double *found /* 5, n */, const double *starts /* n, 2 */,
                   const double *start_shapes /* n, 3 */, const double *misfit /* n */, const int64_t *cut /* n */, double sign,
                   int64_t height, int64_t width, double min_radius, const double *settings /* 29 */, int64_t *status /* n */,
                   int64_t *keep /* n */);
/* Compute semi-axes, angles and the covariance of (u, v, a, b, angle) from shapes and the
   covariance of (u, v, p, q, s) (sensing/image/ellipse_fit.py). */
void ellipse_axes(int64_t n, const double *shapes /* n, 3 */, const double *cov /* n, 5, 5 */, double *semi_axes /* n, 2 */,
                  double *angles /* n */, double *out /* n, 5, 5 */);

/* Fit ellipses to profiles across their edges in a softened image (sensing/image/profile_fit.py).
   `centers` and `shapes` are updated in place. `settings`: see ellipse_profiles.c. Out: `cov` of
   (u, v, p, q, s); `levels` inside and outside; `found`: blur, residual, number of profiles, lost
   fraction of weight, motion. */
int64_t fit_profiles(const float *image /* height, width */, int64_t height, int64_t width, int64_t n, double *centers /* n, 2 */,
                     double *shapes /* n, 3 */, const double *settings /* 10 */, double *cov /* n, 5, 5 */,
                     double *levels /* 2, n */, double *found /* 5, n */);

/* Fit ellipses to the pixels of the bands along their edges (sensing/image/edge_fit.py). `counts` of
   pixels per marker, whose coordinates are relative to its origin. `settings`: see edge_fits.c.
   `thetas`, the parameters, are updated in place. Out: `normals`, normal matrices; `sums` of weight,
   of weighted residual and of weighted squared residual, and the last change of center and shape. */
int64_t fit_edges(int64_t n, int64_t all, const int64_t *counts /* n */, const float *x /* all */, const float *y /* all */,
                  const float *observed /* all */, const double *settings /* 8 */, double *thetas /* n, 10 */,
                  double *normals /* n, 10, 10 */, double *sums /* n, 4 */);

/* Sum the normal equations of each marker in gray levels of a camera with gamma
   (sensing/image/gamma.py). `thetas` as in `fit_edges`. `curve`: gamma, middle gray level, darkest
   light, robust. Out: `normals`; `sums` of products with the residual (10) and with the derivative by
   log gamma (10), of that derivative squared, of derivative and residual, of the squared residual, of
   the weights; of the last two, the part at the edge. */
int64_t gamma_equations(int64_t n, int64_t all, const int64_t *counts /* n */, const float *x /* all */, const float *y /* all */,
                        const float *observed /* all */, const double *curve /* 4 */, const double *thetas /* n, 10 */,
                        double *normals /* n, 10, 10 */, double *sums /* n, 26 */);

/* Estimate circle poses from ellipses (sensing/pose/circles.py). `camera`: see optics.h. `covs`:
   covariances of (u, v, a, b, angle). Out: `uv`, px, of the center; `poses`: center and normal of
   the preferred pose, then of the other; `cov_p`, covariance of the center. */
void circle_poses(int64_t n, const double *centers /* n, 2 */, const double *semi_axes /* n, 2 */, const double *angles /* n */,
                  const double *covs /* n, 5, 5 */, const double *radii /* n */, const double *camera /* CAMERA_NUMBERS */,
                  double *uv /* n, 2 */, double *poses /* 4, n, 3 */, double *cov_p /* n, 3, 3 */);
/* Compute covariances of the center and of (n_x, n_y) at fixed n_z, of poses estimated from the
   ellipses. */
void circle_covariances(int64_t n, const double *centers /* n, 2 */, const double *semi_axes /* n, 2 */,
                        const double *angles /* n */, const double *covs /* n, 5, 5 */, const double *p /* n, 3 */,
                        const double *normals /* n, 3 */, const double *camera /* CAMERA_NUMBERS */, double *out /* n, 5, 5 */);
/* Compute the cones of ellipses with `shapes`, without the glass. */
void cones(int64_t n, const double *centers /* n, 2 */, const double *shapes /* n, 3 */, const double *camera /* CAMERA_NUMBERS */,
           double *out /* n, 3, 3 */);
/* Compute both circles on each cone `Q`. Out: centers of the first and the second circle, then
   their normals. */
void circles_on_cones(int64_t n, const double *Q /* n, 3, 3 */, const double *radii /* n */, double *poses /* 4, n, 3 */);

/* Assign markers to n circles (sensing/pose/marker_matching.py). `found`, `expected`, `layout`:
   positions, m, of the circles and of m markers; NaN if unknown. `order`: nearest markers of each
   marker. `settings`: see marker_matching.c. Out: `ids` of the circles, -1 for none. */
int64_t match_markers(int64_t n, int64_t m, int64_t k, const double *found /* n, 2 */, const double *expected /* m, 2 */,
                      const double *layout /* m, 2 */, const int64_t *order /* m, k */, double pitch,
                      const double *settings /* 5 */, int64_t *ids /* n */);
/* Choose one of the two poses of each identified circle: the one whose normal fits the surface
   through the centers of all first poses. `circles`: identified circles among all. `factors`:
   actual radius over assumed radius. `origin`: position of the camera in S, m. `slopes`:
   derivatives of the surface's slopes by its heights. Out: positions `p` in S, `normals`,
   `cov_p`. */
int64_t name_circles(int64_t count, int64_t all, const int64_t *circles /* count */, const double *first /* all, 3 */,
                     const double *first_n /* all, 3 */, const double *second /* all, 3 */, const double *second_n /* all, 3 */,
                     const double *cov /* all, 3, 3 */, const double *factors /* count */, const double *camera /* CAMERA_NUMBERS */,
                     const double *origin /* 3 */, const double *slopes /* 2, count, count */, double *p /* count, 3 */,
                     double *normals /* count, 3 */, double *cov_p /* count, 3, 3 */);

/* Compute the `volume` between vertices `p` and the plane z = 0, and its `gradient`
   (sim/sensor/chamber.py). */
int64_t chamber_volume(int64_t n, const double *p /* n, 3 */, int64_t m, const int64_t *triangles /* m, 3 */,
                       double *gradient /* n, 3 */, double *volume /* 1 */);
/* Apply a gas of this pressure and stiffness to k vertices with displacements `moved`. Out: the
   tendon's `coefficients`, its `spring` and its length at `rest`; `forces`. The length is offset by
   `offset_fraction` of its absolute terms' sum plus `min_offset`. */
void apply_gas_load(int64_t k, const double *gradient /* k, 3 */, const double *moved /* k, 3 */, double offset_fraction,
                    double min_offset, double pressure, double stiffness, double *coefficients /* k */, double *spring /* 1 */,
                    double *rest /* 2 */, double *forces /* k, 3 */);
/* MuJoCo's `contacts`, here and below: their number, the address `list` of the first one's `dist`,
   and the byte `layout` of the list (sim/sensor/contact_list.py). `rows`: number of its constraint
   rows. */
/* Compute total forces `loads`, N, frame W, on n `membranes`, each given by its first and last
   sphere and its flex (sim/ground_truth.py). */
int64_t membrane_loads(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t rows,
                       const double *force /* rows */, int64_t n, const int64_t *membranes /* n, 3 */, double *loads /* n, 3 */);
/* Write MuJoCo's stiffness `rows`, six entries each, from the strain of m triangles
   (sim/sensor/rubber_flex.py). Each triangle has three `edges` between `ends` of n vertices
   `p`. `law`: mu, Poisson's ratio, lambda' without strain, and the minimum and maximum factor of
   lambda'. Out also: `thin`, the square of the thickness stretch over that of the area stretch. */
int64_t rubber_stiffness(int64_t m, const int64_t *edges /* m, 3 */, int64_t e, const int64_t *ends /* e, 2 */, int64_t n,
                         const double *p /* n, 3 */, const double *metric /* m, 3, 3 */, const double *law /* 5 */,
                         const double *by_mu /* m, 6 */, const double *by_lambda /* m, 6 */, double *thin /* m */,
                         double *rows /* m, 21 */);
/* Update the relaxed stress of m triangles of n vertices `p` (sim/sensor/rubber_flex.py).
   `inverse`, of the edges, and `section`, area times thickness, are those of the flat membrane.
   `law`: mu, Poisson's ratio, squared pre-stretch, softening and its energy. `thin`: from
   rubber_stiffness at the same `p`. Each term has a fraction in `fractions` and a decay factor in
   `kept`. In and out: `memory`, the previous stress and the relaxed part of each term; `max_energy`, the
   maximum energy; `rows`, scaled to the instantaneous rubber; `forces` on k `interior` vertices, to
   which those that subtract the relaxed stress are added. `work` is workspace. */
int64_t viscoelastic_forces(int64_t m, const int64_t *triangles /* m, 3 */, int64_t n, const double *p /* n, 3 */,
                         const double *inverse /* m, 2, 2 */, const double *section /* m */, const double *law /* 5 */,
                         const double *thin /* m or NULL */, int64_t terms, const double *fractions /* terms */,
                         const double *kept /* terms */, double *memory /* terms + 1, 3, m */, double *max_energy /* m */,
                         double *work /* 12 * m + 3 * n */, int64_t k, const int64_t *interior /* k */,
                         double *rows /* m, 21 or NULL */, double *forces /* 3 * k */);
/* Compute sums of the principal curvatures `out`, 1/m, of MuJoCo geoms of `kinds` and `sizes` where
   their surfaces have the `normals` in their frames (sim/sensor/curvature_standoff.py). `end`:
   minimum cosine of a normal to a cylinder's end. */
void curvatures(int64_t n, const int32_t *kinds /* n */, const double *sizes /* n, 3 */, const double *normals /* n, 3 */,
                double end, double *out /* n */);
/* Compute the curvature of the object at each of the spheres `first` to `first + count - 1`;
   spheres without contact get the mean. Returns the number of their contacts. `kinds`, `sizes`,
   `axes`: those of all `geoms`. */
int64_t touched_curvatures(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t first, int64_t count,
                           int64_t geoms, const int32_t *kinds /* geoms */, const double *sizes /* geoms, 3 */,
                           const double *axes /* geoms, 9 */, double end, double *out /* count */);
/* Update friction and margins from MuJoCo's contacts with the spheres `first` to
   `first + count - 1`; return the number of contacts (sim/sensor/stiction.py). In and out: advance
   `give` of the margins, `memory` of friction and shift in S, `states`, and of the `slide` mean speed,
   velocity, and the sum of all normal forces; unchanged without contact. Out: velocity of the `surface`. */
int64_t update_stiction(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t rows,
                        const double *force /* rows */, const double *kbip /* rows, 4 */, const double *softness /* rows */,
                        const double *velocity /* rows */, const double *travel /* rows */, const double *R_WS /* 9 */,
                        int64_t first, int64_t count, const double *settings /* 7 */, double *give /* count */,
                        double *memory /* count, 6 */, uint8_t *states /* count */, double *surface /* count, 3 */,
                        double *slide /* 5 */);

/* Quasi-static membrane (quasistatic/). `numbers`, `law`: see quasistatic.h. The nodes
   (columns, rows) include those on the frame. `body`: obstacles, whose planes, triangles and height
   fields are in `pool`.

   Compute the heights of the obstacles' lower sides over `places`; infinite where there is none. */
int64_t qs_obstacle_heights(const double *numbers /* 20 */, int64_t bodies, const double *body /* bodies, 20 */, int64_t pooled,
                     const double *pool /* pooled or NULL */, int64_t count, const double *places /* count, 2 */,
                     double *out /* count */);
/* Compute the band of the Cholesky `factor` of the stiffness at displacements `x`, over a gas with
   constant `pressure`. The unknowns x, y and height of a node are together. */
int64_t qs_stiffness(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                       const double *x /* 3, columns, rows */, double pressure, int64_t roomy, double *room /* roomy */,
                       double *factor /* 3 * (columns - 2) * (rows - 2), BAND_STRIDE(3 * rows - 1) */);
/* Compute the in-plane displacements due to in-plane unit forces with that factor: x and y of each
   inner node alternate. */
int64_t qs_compliance(int64_t columns, int64_t rows,
                        const double *factor /* 3 * (columns - 2) * (rows - 2), BAND_STRIDE(3 * rows - 1) */, int64_t roomy,
                        double *room /* roomy */,
                        double *compliance /* 2 * (columns - 2) * (rows - 2), 2 * (columns - 2) * (rows - 2) */);
int64_t qs_workspace_size(const double *numbers /* 20 */); /* number of doubles of `room` for a solution */
/* number of floats of `kept`, shared by all solutions of a membrane */
int64_t qs_factors_size(const double *numbers /* 20 */);
/* Compute `kept`: factors of the membrane's stiffness without contact, in the plane and of the
   heights, at displacements `x`. */
int64_t qs_factorize(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                  const double *x /* 3, columns, rows */, int64_t roomy, double *room /* roomy */, int64_t keeping,
                  float *kept /* keeping */);
/* Find the equilibria of environments `start` to `end` - 1, each with `settings`
   (see qs_workspace.h) and obstacles. In and out: displacements `x` and contact forces `force`
   along -z, from the start to the equilibrium; `trend`, the previous change of both, replaced by
   the present one. Out: `found`, see qs_workspace.h. */
int64_t qs_solve(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                   int64_t keeping, const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy, double *room /* roomy */, int64_t environments,
                   int64_t start, int64_t end, const double *settings /* environments, 9 */, int64_t bodies,
                   const double *body /* environments, bodies, 20 */, int64_t pooled, const double *pool /* pooled or NULL */,
                   double *x /* environments, 3, columns, rows */, double *force /* environments, columns, rows */,
                   double *trend /* environments, 4, columns, rows */, double *found /* environments, 14 */);
/* Find the equilibria of those `environments` that no thread has taken yet. `next` counts them for
   all threads; each thread has its own `room`. The start is `from_...`, or the state without
   contact if that is NULL or did not converge. */
int64_t qs_solve_batch(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                   const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy,
                   double *room /* roomy */, int64_t environments, int64_t *next /* 1 */,
                   const double *settings /* environments, 9 */, int64_t bodies, const double *body /* environments, bodies, 20 */,
                   int64_t pooled, const double *pool /* pooled or NULL */,
                   const double *from_x /* environments, 3, columns, rows or NULL */,
                   const double *from_force /* environments, columns, rows or NULL */,
                   const double *from_trend /* environments, 4, columns, rows or NULL */,
                   const double *from_found /* environments, 14 or NULL */, double *x /* environments, 3, columns, rows */,
                   double *force /* environments, columns, rows */, double *trend /* environments, 4, columns, rows */,
                   double *found /* environments, 14 */);
/* Update a quasi-static membrane in a moving scene (sim/sensor/quasistatic_sensor.py). `given`,
   `memory`, `patches`: see qs_friction.h. Inputs are the poses of MuJoCo's bodies and geoms. `slot`:
   patch of each geom; `body_of`: body of each patch. Out: obstacles `body` in the frame of the
   MuJoCo body `carrier`; the equilibrium as in qs_solve, or by linear springs after small motions;
   sticking stiffness `grip` and sliding of each patch. `touched`: patches (plus one) of the nodes at
   the last sticking stiffness and at the last solution, then workspace. `before`: x and y of that
   solution, workspace, loads and lags of the nodes, and loads by unit motions of the patches. */
int64_t qs_follow(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                    const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy,
                    double *room /* roomy */, const double *settings /* 9 */, int64_t geoms, double *body /* geoms, 20 */,
                    int64_t pooled, const double *pool /* pooled or NULL */, double *x /* 3, columns, rows */,
                    double *force /* columns, rows */, double *trend /* 4, columns, rows */, double *found /* 14 */,
                    const double *given /* 8 */, const double *compliance /* 2 * (columns - 2) * (rows - 2), 2 * (columns - 2) * (rows - 2) */,
                    int64_t carrier, int64_t nbody, const double *xpos /* nbody, 3 */, const double *xmat /* nbody, 9 */,
                    int64_t ngeom, const double *geom_xpos /* ngeom, 3 */, const double *geom_xmat /* ngeom, 9 */,
                    const int64_t *geom /* geoms */, const int64_t *slot /* geoms */, const double *bounds /* geoms, 6 */,
                    int64_t slots, const int64_t *body_of /* slots */, double *memory /* 26 */, double *patches /* slots, 57 */,
                    double *grip /* 3 * slots, 3 * slots */, int32_t *touched /* 3, columns, rows */,
                    double *before /* 10 + 6 * slots, columns, rows */);
/* Compute the generalized forces `push` of this membrane on MuJoCo's degrees of freedom, and the
   `holds` on free bodies (see qs_joint_forces.c). Returns 1 if there is contact. */
int64_t qs_push(const double *given /* 8 */, int64_t slots, const double *patches /* slots, 57 */, const int64_t *body_of /* slots */,
                  const double *grip /* 3 * slots, 3 * slots */, int64_t carrier, int64_t nbody,
                  const int32_t *parent /* nbody */, const int32_t *joints /* nbody */, const int32_t *first /* nbody */, int64_t njnt,
                  const int32_t *type /* njnt */, const int32_t *dof /* njnt */, const double *anchor /* njnt, 3 */,
                  const double *axis /* njnt, 3 */, const double *xpos /* nbody, 3 */, const double *xmat /* nbody, 9 */,
                  int64_t nv, double *push /* 2, nv */, double *holds /* slots, 43 */);
/* Add the `pushes` of all membranes to the forces `applied` by others, and the damping of `holds`
   to `undamped` (sim/sensor/quasistatic_forces.py). */
int64_t qs_add(int64_t nv, int64_t membranes, const double *pushes /* membranes, 2, nv */, int64_t held, const double *holds /* held, 43 */,
                 double step, const double *inertia /* nv */, const double *velocity /* nv */, double *base /* nv */,
                 double *left /* nv */, double *applied /* nv */, const double *undamped /* nv */, double *damping /* nv */);
/* Run up to `count` steps (sim/batched_quasistatic_step.py). `events`: number of steps done; number
   of steps in which the solver ran out of iterations; 1 if a degree of freedom is too fast; 1 if a
   membrane did not converge. The last two end the run. `mujoco`: addresses of mj_kinematics,
   mj_step, model and data. `follows`: arguments of qs_follow and the address of its flag for
   applied forces. `pushes`: arguments of qs_push and the addresses of its row in the arguments of
   qs_add. `adds`: arguments of qs_add. `goals`: current and requested opening, current and
   requested lift, m; maximum change of the opening goal per step, its maximum lead over the jaws,
   maximum change of the lift goal per step; opening at qpos 0. */
int64_t qs_steps(int64_t count, const int64_t *mujoco /* 4 */, double time, double step, int64_t membranes,
                   const int64_t *follows /* membranes, 38 */, const int64_t *pushes /* membranes, 22 */, const int64_t *adds /* 13 */,
                   double *goals /* 8 */, int64_t reads, const int64_t *read /* reads */, const double *per /* reads */, int64_t nq,
                   const double *qpos /* nq */, int64_t drives, const int64_t *control /* drives */,
                   const double *affine /* drives, 3 */, int64_t nu, double *ctrl /* nu */, int64_t nv, const double *qvel /* nv */,
                   int64_t movers, const int64_t *mover /* movers */, const double *hurry /* movers */, int64_t iterations,
                   const int32_t *solver_iterations /* 20 */, double *wrenches /* count, membranes, 6 */, int64_t *events /* 4 */);
/* Sample the wrench `estimated` that a sensing chain would estimate for a true `wrench`, and its
   covariance `cov` (sim/synthetic_touch.py). `table` at each `load`: mean, standard deviation, that
   of the independent part and the reported one (6 each); fractions of outliers and of unknown
   images; area and its standard deviation; standard deviation of the centroid; spread between
   grasps. `row`: the same at this load. `settings`: time constant of the persistent part, s;
   standard normal number of the grasp; its shear gain; time since the previous image, s; a uniform
   random number. In and out: `slow`, the persistent part. */
int64_t sample_errors(int64_t loads, const double *load /* loads */, const double *table /* loads, 30 */, const double *gain /* 6, 6 */,
                    const double *spread /* 6, 6 */, const double *reported_correlation /* 6, 6 */, const double *settings /* 5 */,
                    const double *outlier_size /* 6 */, const double *normals /* 12 */, const double *wrench /* 6 */, double *slow /* 6 */, double *row /* 30 */,
                    double *estimated /* 6 */, double *cov /* 6, 6 */);
int64_t qs_sensitivities_size(const double *numbers /* 20 */);
/* Compute the derivatives of an equilibrium `x`, `force` by `changes` of its obstacles. `body`: the
   present obstacles, then those after each change, by `steps`. Out: derivatives of displacements,
   forces and the results of qs_solve. Returns 1 if the membrane is not in equilibrium on these
   obstacles. */
int64_t qs_sensitivities(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t roomy,
                    double *room /* roomy */, const double *settings /* 9 */, int64_t bodies, int64_t changes,
                    const double *body /* 1 + changes, bodies, 20 */, int64_t pooled, const double *pool /* pooled or NULL */,
                    const double *steps /* changes */, const double *x /* 3, columns, rows */,
                    const double *force /* columns, rows */, double *by_x /* changes, 3, columns, rows */,
                    double *by_force /* changes, columns, rows */, double *by_detection /* changes, 14 */);
/* Approximate qs_sensitivities for heights and forces only, at a fifth of the cost: by a height step of
   the solver, without in-plane displacements. */
int64_t qs_approximate_sensitivities(const double *numbers /* 20 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                    const float *kept /* keeping */, int64_t roomy, double *room /* roomy */, const double *settings /* 9 */,
                    int64_t bodies, int64_t changes, const double *body /* 1 + changes, bodies, 20 */, int64_t pooled,
                    const double *pool /* pooled or NULL */, const double *steps /* changes */, const double *x /* 3, columns, rows */,
                    const double *force /* columns, rows */, double *by_z /* changes, columns, rows */,
                    double *by_force /* changes, columns, rows */);
/* Compute the `obstacles` (as above) of `count` parametric shapes `theta` of one `model`: smooth, ball,
   cylinder, disc, block. `guess`: position, height, half-extents of the frame, 1 for an ellipse, and
   rounding (sensing/contact_shape/primitives.py). Faces have `heights` at the nodes `x`, `y`. */
int64_t shape_obstacles(int64_t model, int64_t count, int64_t parameters, const double *theta /* count, parameters */,
                        const double *guess /* 7 */, int64_t columns, int64_t rows, const double *x /* columns */,
                        const double *y /* rows */, double *obstacles /* count, 20 */,
                        double *heights /* count, columns, rows or NULL */);

#endif
