/* Lens and pane, as in core/optics.py: its docstrings have the equations. */
#ifndef MJTACTILE_OPTICS_H
#define MJTACTILE_OPTICS_H

typedef struct {
    double fx, fy, cx, cy, k1, k2, p1, p2, k3, thickness, index, distance; /* m; no pane where its thickness is 0 */
} Camera;

typedef struct { double x, y, xx, xy, yy; } Lens;  /* distorted coordinates, and their derivatives by the ideal ones */

int has_lens(const Camera *camera);
Lens distort(const Camera *camera, double x, double y);
void undistort(const Camera *camera, double x_d, double y_d, double *x, double *y);  /* NaN where the lens folds over */
double glass_displacement(const Camera *camera, double tan2);
void refract(const Camera *camera, const double *p, double *x, double *y);  /* NaN for a point that is not beyond the pane */
void project(const Camera *camera, const double *p, double *uv);

#endif
