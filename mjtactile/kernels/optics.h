/* Lens and glass as in core/lens.py and core/optics.py. Equations: their docstrings. */
#ifndef MJTACTILE_OPTICS_H
#define MJTACTILE_OPTICS_H

typedef struct {
    /* `k`: coefficients of the lens `model`; thickness and distance of the glass in m; thickness 0:
       no glass */
    double fx, fy, cx, cy, model, k[8], thickness, index, distance;
} Camera;

/* distorted coordinates, and their derivatives by the ideal ones */
typedef struct { double x, y, xx, xy, yy; } Lens;

int has_lens(const Camera *camera);
Lens distort(const Camera *camera, double x, double y);
/* NaN where the lens folds over */
void undistort(const Camera *camera, double x_d, double y_d, double *x, double *y);
double glass_displacement(const Camera *camera, double tan2);
/* NaN for a point that is not beyond the glass */
void refract(const Camera *camera, const double *p, double *x, double *y);
void project(const Camera *camera, const double *p, double *uv);

#endif
