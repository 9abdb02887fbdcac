/* Membrane as a spline finite element model. Equations: sensing/force/spline_fem.py. Displacements
   and forces are (3, n), component by component, n = nx * ny splines with y fastest. Internally,
   for narrow bands, the three components of a spline are together. */
#ifndef MJTACTILE_SPLINE_FEM_H
#define MJTACTILE_SPLINE_FEM_H

typedef struct { double length_x, length_y, lambda2, neo_hookean, modulus, poisson, table_first, table_per_unit; } SplineNumbers;

/* Membrane; `law` (2, entries): q and q'. */
typedef struct { long nx, ny, n, width, entries; SplineNumbers numbers; const double *law; } SplineMembrane;

/* Factored stiffness K0 + s g g^T: the factor of the band, and the gas's change of the inverse,
   -share w w^T. */
typedef struct { const double *factor, *softened; double fraction; } Stiffness;

SplineMembrane membrane_of(long nx, long ny, const double *numbers); /* NULL: shape only */
int has_enough_splines(long nx, long ny);                          /* 0: too few splines */
void interleave_components(const SplineMembrane *membrane, const double *parts, double *x); /* (3, n) to (n, 3) */
void separate_components(const SplineMembrane *membrane, const double *x, double *parts);
/* x (n, 3) becomes K^-1 x */
void solve_stiffness(const SplineMembrane *membrane, const Stiffness *K, double *x);

#endif
