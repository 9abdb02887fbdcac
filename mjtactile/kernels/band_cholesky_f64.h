/* Symmetric positive definite band matrices of order n in double precision. Entries farther than
   `width` from the diagonal are zero. Lower triangles are stored by columns: A(i, j) is a[j *
   BAND_STRIDE(width) + i - j]. Stored entries beyond width or n are zero. */
#ifndef MJTACTILE_BAND_H
#define MJTACTILE_BAND_H

#include "kernels.h"

/* Number of right-hand sides that are solved together. */
#define LANES 8
typedef double Lanes __attribute__((vector_size(64), aligned(8)));

int band_cholesky(long n, long width, double *a); /* factors in place; 1: not positive definite */
void band_forward(long n, long width, const double *L, double *x);      /* x becomes L^-1 x */
void band_backward(long n, long width, const double *L, double *x);     /* x becomes L^-T x */
/* x becomes (L L^T)^-1 x, from row `requested` on */
void band_solve_lanes(long n, long width, const double *L, Lanes *x, long requested);
/* Z: the inverse of L L^T within the band */
void band_inverse(long n, long width, const double *L, double *Z);

#endif
