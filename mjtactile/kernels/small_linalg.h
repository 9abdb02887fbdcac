/* Small functions that several kernels need. */
#ifndef MJTACTILE_SMALL_H
#define MJTACTILE_SMALL_H
#include <math.h>

#define PI 3.14159265358979323846

static inline double min_of(double a, double b) { return a < b ? a : b; }
static inline double max_of(double a, double b) { return a > b ? a : b; }
static inline float min_float(float a, float b) { return a < b ? a : b; }
static inline float max_float(float a, float b) { return a > b ? a : b; }
static inline double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }
static inline double square(double x) { return x * x; }
static inline double cube(double x) { return x * x * x; }

double upper_median(double *values, long n);  /* reorders the values */
/* 1: not positive definite, and `out` is NaN */
int invert_spd5(const double A[5][5], double out[5][5]);
/* out (parts, parts) = G cov G^T */
void sandwich5(double G[5][5], const double *cov, int parts, double *out);

#endif
