/* All kernels: library.py reads this file. One declaration a line or wrapped. Behind each array stands the shape that it must
   have, made of the call's whole numbers and of the macros below; NULL only where that is said. A function that returns
   int64_t returns a negative code where it fails, else 0 or what is said of it. */
#ifndef MJTACTILE_KERNELS_H
#define MJTACTILE_KERNELS_H
#include <stdint.h>

enum { NO_MEMORY = -1, REFUSED = -2, NOT_DEFINITE = -3 };

#define BAND_STRIDE(width) (((width) + 11) / 4 * 4) /* panels of four columns and vectors of four need seven rows more */
#define SHEET_WIDTH(ny) (9 * (ny) + 11) /* of the band of a sheet's stiffness */
#define SURFACE_WIDTH(nx) (3 * (nx) + 3) /* of that of a surface's normal equations */

/* sim/rendering/renderer.py: blurred discs and a closed curve added to an image `coverage`. `across` and `down`: see discs.c;
   `per_px` nodes to a pixel of a rim. `nodes` px, `weights` dx. */
int64_t render_discs(int64_t n, const double *p_CM /* n, 3 */, const double *n_C /* n, 3 */, const double *radii /* n */,
                   const double *camera /* 12 */, double per_px, int64_t bins, int64_t taps,
                   const float *across /* bins, taps */, const float *down /* bins, taps + 1 */, int64_t height, int64_t width,
                   float *coverage /* height, width */);
int64_t fill_curve(int64_t count, const double *nodes /* count, 2 */, const double *weights /* count */, int64_t bins,
                   int64_t taps, const float *across /* bins, taps */, const float *down /* bins, taps + 1 */, int64_t height,
                   int64_t width, float *coverage /* height, width */);
/* In place: grey levels of what is covered by markers, from the membrane's `contrast` to them and the relative `light`. */
void shade(int64_t count, double marker, double gain, const float *contrast /* count */, const float *light /* count */,
           float *coverage /* count */);
/* Out: `pixels`, noise added and rounded. */
void expose(int64_t count, const float *gray /* count */, const float *noise /* count */, double noise_dn,
            uint8_t *pixels /* count */);

/* sim/rendering/shadows.py: `out` of `grid` at `places`, fractional columns and rows, cut to the grid. */
int64_t bilinear(int64_t rows, int64_t columns, int64_t channels, const double *grid /* rows, columns, channels */,
                 int64_t count, const double *places /* count, 2 */, double *out /* count, channels */);

/* run/scene_picture.py: triangles `corners`, right, up, towards the viewer, in their colours `rgb`, painted into `image`, whose
   width goes from -1 to 1, where they are nearer than `depth`. */
void paint_triangles(int64_t n, const double *corners /* n, 3, 3 */, const double *rgb /* n, 3 */, int64_t height,
                     int64_t width, double *depth /* height, width */, double *image /* height, width, 3 */);

/* shape/surface.py: the spline through markers `p_SM` with `variance` of their heights and normals `n_S`; `settings`: see
   surface.c. Bands, here and below, as in band.h. Out: `c`, the band of the Cholesky `factor` of its inverse covariance,
   `found`: misfit, markers used. */
int64_t fit_surface(int64_t n, const double *p_SM /* n, 3 */, const double *variance /* n */,
                    const double *n_S /* n, 3 or NULL */, int64_t nx, int64_t ny, const double *settings /* 9 */,
                    const double *prior /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *c /* ny, nx */,
                    double *factor /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *found /* 2 */);
/* Tables: `grid_x`, `grid_y`, and values and slopes `quad_x`, `quad_y`. Out: heights `z`, `found`: area, volume, their sd. */
int64_t measure_surface(int64_t nx, int64_t ny, const double *c /* ny, nx */,
                        const double *factor /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double misfit, int64_t grid_nx,
                        int64_t grid_ny, const double *grid_x /* nx, grid_nx */, const double *grid_y /* grid_ny, ny */,
                        int64_t qx, int64_t qy, const double *quad_x /* 2, nx, qx */, const double *quad_y /* 2, qy, ny */,
                        const double *weights /* qy, qx */, const double *volume_c /* ny, nx */,
                        const double *stiffness /* ny * nx, BAND_STRIDE(SURFACE_WIDTH(nx)) */, double *z /* grid_ny, grid_nx */,
                        double *found /* 4 */);

/* force/sheet.py: a sheet of nx, ny splines, four at least, with its `numbers` and its `transmission` as in sheet.h, at `c`, and how its
   own coordinates turn into places at its Gauss points, `turns`, as in sheet.c; NULL: they are the places. Out: `elastic` forces, the bulge's `gradient` and `volume`, m^3. */
int64_t sheet_state(int64_t nx, int64_t ny, const double *numbers /* 8 */, int64_t entries, const double *law /* 2, entries */,
                    const double *turns /* 2 * (nx - 1), 2 * (ny - 1), 5 or NULL */, const double *c /* 3, nx, ny */,
                    double scale, double *elastic /* 3, nx, ny */, double *gradient /* 3, nx, ny */, double *volume /* 1 */);
/* Out: the band of the stiffness at constant pressure, components of a spline together. */
int64_t sheet_tangent(int64_t nx, int64_t ny, const double *numbers /* 8 */, int64_t entries,
                      const double *law /* 2, entries */,
                      const double *turns /* 2 * (nx - 1), 2 * (ny - 1), 5 or NULL */, const double *c /* 3, nx, ny */,
                      double scale, double pressure, double *band /* 3 * nx * ny, BAND_STRIDE(SHEET_WIDTH(ny)) */);
/* In place: a band's Cholesky factor, pushed towards the identity until it is definite. */
int64_t factor_definite(int64_t n, int64_t width, double *band /* n, BAND_STRIDE(width) */);
/* Out: `softened`, what a factorised stiffness makes of the gas's `gradient`; returns the share of it in inverses. */
double soften(int64_t nx, int64_t ny, const double *factor /* 3 * nx * ny, BAND_STRIDE(SHEET_WIDTH(ny)) */,
              const double *gradient /* 3, nx, ny */, double gas_stiffness, double *softened /* 3, nx, ny */);
/* Out: displacements `out` by `forces`. */
int64_t sheet_solve(int64_t nx, int64_t ny, const double *factor /* 3 * nx * ny, BAND_STRIDE(SHEET_WIDTH(ny)) */,
                    const double *softened /* 3, nx, ny */, double share, const double *forces /* 3, nx, ny */,
                    double *out /* 3, nx, ny */);

/* force/inverse.py: r rows, the whitened positions of `markers` at `material` by `weights` and, where there are `tilts`, two
   slopes each. Out: `half` and what they see of a `bulge`. */
int64_t inverse_gain(int64_t nx, int64_t ny, const double *numbers /* 8 */,
                     const double *factor /* 3 * nx * ny, BAND_STRIDE(SHEET_WIDTH(ny)) */, const double *softened /* 3, nx, ny */,
                     double share, int64_t r, int64_t markers, const double *material /* markers, 2 */,
                     const double *weights /* markers, 3, 3 */, const double *tilts /* 2, markers, 2, 3 or NULL */, int64_t jx,
                     int64_t jy, const double *load_x /* nx, jx */, const double *load_y /* ny, jy */,
                     const double *root_x /* jx, jx */, const double *root_y /* jy, jy */, const double *prior /* 3, jx, jy */,
                     const double *bulge /* 3, nx, ny */, double *half /* r, 3, jx, jy */, double *bulge_seen /* r */);
/* `innovation`: its lower factor; `data`: displacements, and `slopes_off` where there are tilts. Out: `change` of c, `traction`,
   `misfit` and `noise`, `drift_found` in sd. */
int64_t inverse_step(int64_t nx, int64_t ny, const double *numbers /* 8 */,
                     const double *factor /* 3 * nx * ny, BAND_STRIDE(SHEET_WIDTH(ny)) */, const double *softened /* 3, nx, ny */,
                     double share, int64_t r, int64_t markers, const double *material /* markers, 2 */,
                     const double *weights /* markers, 3, 3 */, const double *tilts /* 2, markers, 2, 3 or NULL */, int64_t jx,
                     int64_t jy, const double *load_x /* nx, jx */, const double *load_y /* ny, jy */,
                     const double *root_x /* jx, jx */, const double *root_y /* jy, jy */, const double *prior /* 3, jx, jy */,
                     const double *innovation /* r, r */, int64_t modes, const double *drift /* r, modes */,
                     const double *gas_load /* 3, nx, ny */,
                     const double *c /* 3, nx, ny */, const double *residual /* 3, nx, ny */, const double *data /* markers, 3 */,
                     const double *slopes_off /* markers, 2 or NULL */, double *change /* 3, nx, ny */,
                     double *traction /* 3, jx, jy */, double *misfit /* r */, double *noise /* r */,
                     double *drift_found /* modes */);

/* L x = b by the lower factor L, for k columns b. In `x`: b; out: x. */
int64_t solve_lower(int64_t n, int64_t k, const double *factor /* n, n */, double *x /* n, k */);

/* Out: covariance `cov` of the net wrench of tractions on nodes at `positions` with `areas`, given what r rows saw. */
int64_t wrench_posterior(int64_t r, int64_t jx, int64_t jy, const double *root_x /* jx, jx */, const double *root_y /* jy, jy */,
                         const double *prior /* 3, jx, jy */, const double *positions /* jx * jy, 3 */,
                         const double *areas /* jx, jy */, const double *half /* r, 3, jx, jy */,
                         const double *innovation /* r, r */, double *cov /* 6, 6 */);

/* touch/patches.py: a patch on nodes (nx, ny), of which the inner ones carry `traction` Pa on `node_area` and have `sunk` m, and
   on a grid (na, nb) `refine` times as fine, of `position` m, with the pressure `fine`. `owner`: the `number` of each point's patch, or
   NULL for one alone; `settings`: see patches.c. Returns 1, or 0 where it carries too little to be one. Out: its cells `inside`,
   zero before, its nodes `mask`, `found`: force, centroid, depth, area, semi-axes, angle. */
int64_t measure_patch(int64_t nx, int64_t ny, int64_t refine, int64_t na, int64_t nb, const double *fine /* na, nb */,
                      const double *position /* 3, na, nb */,
                      const int32_t *owner /* na, nb or NULL */, int64_t number,
                      const double *traction /* 3, nx - 2, ny - 2 */, const double *node_area /* nx - 2, ny - 2 */,
                      const double *sunk /* nx - 2, ny - 2 */, double gauge, double node_variance, const double *settings /* 8 */,
                      uint8_t *inside /* na, nb */, uint8_t *mask /* ny, nx */, double *found /* 10 */);

/* image/candidates.py: area moments of n borders, `counts` points each in `points` (x, y) of an image (height, width); out:
   `misfit` px, the largest distance of the border from the ellipse with these moments, and whether the image cuts it. */
int64_t border_moments(int64_t n, const int64_t *counts /* n */, int64_t all, const int32_t *points /* all, 2 */, int64_t height,
                       int64_t width, double *centers /* n, 2 */, double *shapes /* n, 3 */, double *misfit /* n */,
                       int64_t *cut /* n */);
/* image/judge.py: out: `status` of borders, of fits, and whether a fit is likely a marker at all; `settings`: see
   candidates.c; `levels` and `found` as below; `sign`: 1 for dark markers, -1 for bright ones. */
int64_t judge_borders(int64_t n, const double *shapes /* n, 3 */, const double *misfit /* n */, const int64_t *cut /* n */,
                      double min_radius, const double *settings /* 29 */, int64_t *status /* n */);
int64_t judge_fits(int64_t n, const double *centers /* n, 2 */, const double *shapes /* n, 3 */, const double *cov /* n, 5, 5 */,
                   const double *levels /* 2, n */, const double *found /* 5, n */, const double *starts /* n, 2 */,
                   const double *start_shapes /* n, 3 */, const double *misfit /* n */, const int64_t *cut /* n */, double sign,
                   int64_t height, int64_t width, double min_radius, const double *settings /* 29 */, int64_t *status /* n */,
                   int64_t *keep /* n */);
/* image/ellipse.py: semi-axes, angles and the covariance of (u, v, a, b, angle) from those of (u, v, p, q, s). */
void ellipse_axes(int64_t n, const double *shapes /* n, 3 */, const double *cov /* n, 5, 5 */, double *semi_axes /* n, 2 */,
                  double *angles /* n */, double *out /* n, 5, 5 */);

/* image/profiles.py: ellipses from profiles across their edges in a softened image. `centers` and `shapes` are moved;
   `settings`: see profiles.c; out: `cov` of (u, v, p, q, s), `levels` inside and outside, `found`: blur, residual, number of
   profiles, share lost, motion. */
int64_t fit_profiles(const float *image /* height, width */, int64_t height, int64_t width, int64_t n, double *centers /* n, 2 */,
                     double *shapes /* n, 3 */, const double *settings /* 10 */, double *cov /* n, 5, 5 */,
                     double *levels /* 2, n */, double *found /* 5, n */);

/* pose/circles.py; `camera`: see optics.h; `covs` of (u, v, a, b, angle). Out: `uv` px of the centre, `poses`: centre and normal
   of the pose preferred, and of the other; `cov_p`. */
void circle_poses(int64_t n, const double *centers /* n, 2 */, const double *semi_axes /* n, 2 */, const double *angles /* n */,
                  const double *covs /* n, 5, 5 */, const double *radii /* n */, const double *camera /* 12 */,
                  double *uv /* n, 2 */, double *poses /* 4, n, 3 */, double *cov_p /* n, 3, 3 */);
/* Out: covariances of centre and (n_x, n_y) at fixed n_z of poses that were found for the ellipses. */
void circle_covariances(int64_t n, const double *centers /* n, 2 */, const double *semi_axes /* n, 2 */,
                        const double *angles /* n */, const double *covs /* n, 5, 5 */, const double *p /* n, 3 */,
                        const double *normals /* n, 3 */, const double *camera /* 12 */, double *out /* n, 5, 5 */);
/* Out: cones of ellipses with `shapes`, without the pane. */
void cones(int64_t n, const double *centers /* n, 2 */, const double *shapes /* n, 3 */, const double *camera /* 12 */,
           double *out /* n, 3, 3 */);
/* Out: centres of the first and the second circle on each cone `Q`, then their normals. */
void circles_on_cones(int64_t n, const double *Q /* n, 3, 3 */, const double *radii /* n */, double *poses /* 4, n, 3 */);

/* pose/identity.py: `ids` of n circles `found` m among m markers, -1 for none; `expected`, `layout` m, `order` each one's nearest
   markers; `settings`: see identity.c. NaN: not known. */
int64_t match_markers(int64_t n, int64_t m, int64_t k, const double *found /* n, 2 */, const double *expected /* m, 2 */,
                      const double *layout /* m, 2 */, const int64_t *order /* m, k */, double pitch,
                      const double *settings /* 5 */, int64_t *ids /* n */);
/* Circles that were found to be markers, `circles` of all, `factors` times as large as assumed, seen from the `origin`: the one
   of their two poses whose normal fits the surface through all of the first, of which the `slopes` are by its heights. Out:
   places `p` in S, `normals`, `cov_p`. */
int64_t name_circles(int64_t count, int64_t all, const int64_t *circles /* count */, const double *first /* all, 3 */,
                     const double *first_n /* all, 3 */, const double *second /* all, 3 */, const double *second_n /* all, 3 */,
                     const double *cov /* all, 3, 3 */, const double *factors /* count */, const double *camera /* 12 */,
                     const double *origin /* 3 */, const double *slopes /* 2, count, count */, double *p /* count, 3 */,
                     double *normals /* count, 3 */, double *cov_p /* count, 3, 3 */);

/* sim/sensor/chamber.py: out: `volume` between vertices `p` and the plane z = 0, and its `gradient`. */
int64_t chamber_volume(int64_t n, const double *p /* n, 3 */, int64_t m, const int64_t *triangles /* m, 3 */,
                       double *gradient /* n, 3 */, double *volume /* 1 */);
/* What a gas of this pressure and stiffness does to k vertices that have `moved`: the tendon's `coefficients`, its `spring` and
   length at `rest`, off by `offset_fraction` of what adds up to it; and `forces`. */
void apply_gas_load(int64_t k, const double *gradient /* k, 3 */, const double *moved /* k, 3 */, double offset_fraction,
                    double least, double pressure, double stiffness, double *coefficients /* k */, double *spring /* 1 */,
                    double *rest /* 2 */, double *forces /* k, 3 */);
/* Here and below, MuJoCo's `contacts`: how many, the address of the first one's `dist`, and the `layout` of the `list`, see
   sim/sensor/contact_list.py; `rows` of its constraints. */
/* sim/ground_truth.py: out: total forces `loads` N, frame W, on n `membranes`: first and last sphere, flex. */
int64_t membrane_loads(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t rows,
                       const double *force /* rows */, int64_t n, const int64_t *membranes /* n, 3 */, double *loads /* n, 3 */);
/* sim/sensor/neo_hookean_flex.py: MuJoCo's stiffness `rows`, of which six are written, from the strain of m triangles of `edges` between
   `ends` of n vertices `p`. `transmission`: mu, Poisson's ratio, lambda', its least and most. Out, too: `thin`, the square of the
   thickness's stretch over that of the area. */
int64_t rubber_stiffness(int64_t m, const int64_t *edges /* m, 3 */, int64_t e, const int64_t *ends /* e, 2 */, int64_t n,
                         const double *p /* n, 3 */, const double *metric /* m, 3, 3 */, const double *law /* 5 */,
                         const double *by_mu /* m, 6 */, const double *by_lambda /* m, 6 */, double *thin /* m */,
                         double *rows /* m, 21 */);
/* sim/sensor/stress_relaxation.py: m triangles of n vertices `p`, whose edges' `inverse` and area times thickness, `section`, are those of
   the flat sheet. `transmission`: mu, Poisson's ratio, the pre-stretch squared, softening and its energy; `thin`: of rubber_stiffness at
   the same `p`; each term has a share and what is `kept` of it. In and out: `memory`, the stress before and what each term has
   faded by, `most` energy, `rows`, which become as stiff as the quick rubber, and `forces` on k `interior` vertices, to which
   those are added that take the faded stress away. `work` is room for it. */
int64_t rubber_remembers(int64_t m, const int64_t *triangles /* m, 3 */, int64_t n, const double *p /* n, 3 */,
                         const double *inverse /* m, 2, 2 */, const double *section /* m */, const double *law /* 5 */,
                         const double *thin /* m or NULL */, int64_t terms, const double *shares /* terms */,
                         const double *kept /* terms */, double *memory /* terms + 1, 3, m */, double *most /* m */,
                         double *work /* 12 * m + 3 * n */, int64_t k, const int64_t *interior /* k */,
                         double *rows /* m, 21 or NULL */, double *forces /* 3 * k */);
/* sim/sensor/curvature_standoff.py: sums of the principal curvatures `out` 1/m of MuJoCo's geoms of `kinds` and `sizes` where their surfaces
   have the `normals` in their frames; `end`: the least cosine of a normal to a cylinder's end. */
void curvatures(int64_t n, const int32_t *kinds /* n */, const double *sizes /* n, 3 */, const double *normals /* n, 3 */,
                double end, double *out /* n */);
/* Returns the number of contacts with the spheres `first` to `first + count - 1`; out: curvatures of what each of them touches,
   the mean where it touches nothing. `kinds`, `sizes` and `axes` of all `geoms`. */
int64_t touched_curvatures(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t first, int64_t count,
                           int64_t geoms, const int32_t *kinds /* geoms */, const double *sizes /* geoms, 3 */,
                           const double *axes /* geoms, 9 */, double end, double *out /* count */);
/* sim/sensor/stiction.py: returns the number of MuJoCo's contacts with the spheres `first` to `first + count - 1`. `memory` of
   friction and shift in S and `slides` become those after this step; out: `goal` of the margins, velocity of the `surface`. None
   touched: all stay. */
int64_t update_stiction(int64_t contacts, int64_t list, const int64_t *layout /* 9 */, int64_t rows,
                        const double *force /* rows */, const double *kbip /* rows, 4 */, const double *softness /* rows */,
                        const double *velocity /* rows */, const double *travel /* rows */, const double *R_WS /* 9 */,
                        int64_t first, int64_t count, const double *settings /* 5 */, double *goal /* count */,
                        double *memory /* count, 6 */, uint8_t *slides /* count */, double *surface /* count, 3 */);

/* film/: the sheet of `numbers` and `transmission` as film.h has them, on nodes (columns, rows) of which the frame's are part. Out: heights
   over `places` of `bodies`, whose planes, triangles and fields are in `pool`; infinite where there are none. */
int64_t film_heights(const double *numbers /* 19 */, int64_t bodies, const double *body /* bodies, 20 */, int64_t pooled,
                     const double *pool /* pooled or NULL */, int64_t count, const double *places /* count, 2 */,
                     double *out /* count */);
/* Out: the band's Cholesky `factor` of the stiffness at displacements `x`, over a gas that stays at `pressure`; x, y and height of a
   node together. */
int64_t film_stiffness(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                       const double *x /* 3, columns, rows */, double pressure, int64_t roomy, double *room /* roomy */,
                       double *factor /* 3 * (columns - 2) * (rows - 2), BAND_STRIDE(3 * rows - 1) */);
/* Out: displacements in the plane by forces in the plane, x and y of each inner node in turn, with that factor. */
int64_t film_compliance(int64_t columns, int64_t rows,
                        const double *factor /* 3 * (columns - 2) * (rows - 2), BAND_STRIDE(3 * rows - 1) */, int64_t roomy,
                        double *room /* roomy */,
                        double *compliance /* 2 * (columns - 2) * (rows - 2), 2 * (columns - 2) * (rows - 2) */);
int64_t film_room(const double *numbers /* 19 */); /* doubles of `room` that a solution wants */
int64_t film_kept(const double *numbers /* 19 */); /* floats of `kept`: what all solutions of a film share */
/* Out: `kept`, factors of the sheet's stiffness at rest, in the plane and of heights, at displacements `x`. */
int64_t film_keep(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                  const double *x /* 3, columns, rows */, int64_t roomy, double *room /* roomy */, int64_t keeping,
                  float *kept /* keeping */);
/* Of environments `begin` to `end` - 1, each with `settings` (see film_work.h) and `bodies`: displacements `x` and the contact's
   forces `force` along -z, from where they are to where the film rests; `trend`, the change of both that led to where they are,
   becomes this one. Out: `found`, see film_work.h. */
int64_t film_solve(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows,
                   int64_t keeping, const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy, double *room /* roomy */, int64_t environments,
                   int64_t begin, int64_t end, const double *settings /* environments, 6 */, int64_t bodies,
                   const double *body /* environments, bodies, 20 */, int64_t pooled, const double *pool /* pooled or NULL */,
                   double *x /* environments, 3, columns, rows */, double *force /* environments, columns, rows */,
                   double *trend /* environments, 4, columns, rows */, double *found /* environments, 14 */);
/* The same of as many `environments` as nobody has taken yet, whose number `next` counts for all threads, each with a room of its own:
   where they begin is `from_...`, or at rest where that is none, or has found no rest. */
int64_t film_share(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                   const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy,
                   double *room /* roomy */, int64_t environments, int64_t *next /* 1 */,
                   const double *settings /* environments, 6 */, int64_t bodies, const double *body /* environments, bodies, 20 */,
                   int64_t pooled, const double *pool /* pooled or NULL */,
                   const double *from_x /* environments, 3, columns, rows or NULL */,
                   const double *from_force /* environments, columns, rows or NULL */,
                   const double *from_trend /* environments, 4, columns, rows or NULL */,
                   const double *from_found /* environments, 14 or NULL */, double *x /* environments, 3, columns, rows */,
                   double *force /* environments, columns, rows */, double *trend /* environments, 4, columns, rows */,
                   double *found /* environments, 14 */);
/* sim/sensor/quasistatic_sensor.py: a film in a scene that moves. `given` and `memory`: see film_hold.h. From the poses of MuJoCo's bodies and
   geoms: `body` in the frame of the body `carrier`, the film at rest on them as film_solve has it (or, where they hardly went, as
   a spring), what sticks and slides. `touched`: nodes in the grip, and at the last solution; `before`: x and y then, and room. */
int64_t film_follow(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                    const float *kept /* keeping */, const double *rest /* 3, columns, rows */, int64_t roomy,
                    double *room /* roomy */, const double *settings /* 6 */, int64_t geoms, double *body /* geoms, 20 */,
                    int64_t pooled, const double *pool /* pooled or NULL */, double *x /* 3, columns, rows */,
                    double *force /* columns, rows */, double *trend /* 4, columns, rows */, double *found /* 14 */,
                    const double *given /* 8 */, const double *compliance /* 2 * (columns - 2) * (rows - 2), 2 * (columns - 2) * (rows - 2) */,
                    int64_t carrier, int64_t nbody, const double *xpos /* nbody, 3 */, const double *xmat /* nbody, 9 */,
                    int64_t ngeom, const double *geom_xpos /* ngeom, 3 */, const double *geom_xmat /* ngeom, 9 */,
                    const int64_t *geom /* geoms */, const int64_t *body_of /* geoms */, const double *bounds /* geoms, 7 */,
                    double *memory /* 69 */, uint8_t *touched /* 2, columns, rows */, double *before /* 6, columns, rows */);
/* Out: what that pushes by MuJoCo's degrees of freedom, and how a free body is held (see film_push.c); returns whether it does. */
int64_t film_push(const double *given /* 8 */, const double *memory /* 69 */, int64_t carrier, int64_t nbody,
                  const int32_t *parent /* nbody */, const int32_t *joints /* nbody */, const int32_t *first /* nbody */, int64_t njnt,
                  const int32_t *type /* njnt */, const int32_t *dof /* njnt */, const double *anchor /* njnt, 3 */,
                  const double *axis /* njnt, 3 */, const double *xpos /* nbody, 3 */, const double *xmat /* nbody, 9 */,
                  int64_t nv, double *push /* nv */, double *hold /* 43 */);
/* sim/sensor/quasistatic_forces.py: adds `pushes` of all films to what somebody else has `applied`, and to `undamped` what `holds` damp. */
int64_t film_add(int64_t nv, int64_t films, const double *pushes /* films, nv */, const double *holds /* films, 43 */, double step,
                 const double *inertia /* nv */, const double *velocity /* nv */, double *base /* nv */, double *left /* nv */,
                 double *applied /* nv */, const double *undamped /* nv */, double *damping /* nv */);
/* sim/batched_quasistatic_step.py: `count` steps, or fewer: `told` says how many were done, in how many the solver ran out of iterations, and
   whether something hurries or a film found no rest, which end it. `mujoco`: addresses of mj_kinematics, mj_step, model and data;
   `follows`, `pushes`, `adds`: arguments of film_follow (and where it says whether it pushed), film_push (and where that goes) and film_add.
   `goals`: of opening and lift now and wanted, m; most that they go in a step, and that the jaws' is ahead; opening at qpos 0. */
int64_t film_steps(int64_t count, const int64_t *mujoco /* 4 */, double time, double step, int64_t films,
                   const int64_t *follows /* films, 34 */, const int64_t *pushes /* films, 19 */, const int64_t *adds /* 12 */,
                   double *goals /* 8 */, int64_t reads, const int64_t *read /* reads */, const double *per /* reads */, int64_t nq,
                   const double *qpos /* nq */, int64_t drives, const int64_t *control /* drives */,
                   const double *affine /* drives, 3 */, int64_t nu, double *ctrl /* nu */, int64_t nv, const double *qvel /* nv */,
                   int64_t movers, const int64_t *mover /* movers */, const double *hurry /* movers */, int64_t iterations,
                   const int32_t *solver_iterations /* 20 */, double *wrenches /* count, films, 6 */, int64_t *told /* 4 */);
/* sim/synthetic_touch.py: the wrench that a chain would say, and its covariance, for a true one. `table`: mean, sd, sd of what is new and said sd (6 each), shares
   of outliers and of unknown images, area and its sd, centroid's sd, spread between grasps, at each `load`; `row`: the same at this load. `settings`: time s
   of what lasts, normal number of the grasp, its gain of shear, s since the image before, a uniform number. In place: `slow`. */
int64_t draw_errors(int64_t loads, const double *load /* loads */, const double *table /* loads, 30 */, const double *gain /* 6, 6 */,
                    const double *spread /* 6, 6 */, const double *reported_correlation /* 6, 6 */, const double *settings /* 5 */,
                    const double *outlier_size /* 6 */, const double *normals /* 12 */, const double *wrench /* 6 */, double *slow /* 6 */, double *row /* 30 */,
                    double *felt /* 6 */, double *cov /* 6, 6 */);
int64_t film_derive_room(const double *numbers /* 19 */);
/* Of a film at rest with `x` and `force`, derivatives by `changes` of its bodies: `body` as they are, then for each change those
   that are `steps` of it farther. Out: of displacements, forces and what film_solve finds.
   Returns 1 where the film does not rest on these bodies. */
int64_t film_derive(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t roomy,
                    double *room /* roomy */, const double *settings /* 6 */, int64_t bodies, int64_t changes,
                    const double *body /* 1 + changes, bodies, 20 */, int64_t pooled, const double *pool /* pooled or NULL */,
                    const double *steps /* changes */, const double *x /* 3, columns, rows */,
                    const double *force /* columns, rows */, double *by_x /* changes, 3, columns, rows */,
                    double *by_force /* changes, columns, rows */, double *by_detection /* changes, 14 */);
/* Nearly the same for a fifth of the time, of heights and forces alone: as a film's step has it, without what moves in the plane. */
int64_t film_answer(const double *numbers /* 19 */, const double *law /* 11 */, int64_t columns, int64_t rows, int64_t keeping,
                    const float *kept /* keeping */, int64_t roomy, double *room /* roomy */, const double *settings /* 6 */,
                    int64_t bodies, int64_t changes, const double *body /* 1 + changes, bodies, 20 */, int64_t pooled,
                    const double *pool /* pooled or NULL */, const double *steps /* changes */, const double *x /* 3, columns, rows */,
                    const double *force /* columns, rows */, double *by_z /* changes, columns, rows */,
                    double *by_force /* changes, columns, rows */);

#endif
