/* The membrane as a spline finite element: sensing/force/spline_fem.py has the equations. Displacements and forces are (3, n),
   component by component, n = nx * ny splines with y fastest; inside, for narrow bands, the three components of a spline stand
   together. */
#ifndef MJTACTILE_SHEET_H
#define MJTACTILE_SHEET_H

typedef struct { double length_x, length_y, lambda2, neo_hookean, modulus, poisson, table_first, table_per_unit; } SheetNumbers;

/* `transmission` (2, entries): q and q' */
typedef struct { long nx, ny, n, width, entries; SheetNumbers numbers; const double *law; } Sheet;

/* A factorised stiffness K0 + s g g^T: the band's factor, and its inverse's change by the gas, -share w w^T. */
typedef struct { const double *factor, *softened; double share; } Stiffness;

Sheet membrane_of(long nx, long ny, const double *numbers); /* NULL: only its shape */
int is_sheet(long nx, long ny);                          /* else it has too few splines */
void together(const Sheet *sheet, const double *parts, double *x); /* (3, n) to (n, 3) */
void apart(const Sheet *sheet, const double *x, double *parts);
void solve_stiffness(const Sheet *sheet, const Stiffness *K, double *x); /* x (n, 3) becomes K^-1 x */

#endif
