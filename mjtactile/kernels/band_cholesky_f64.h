/* Symmetric positive definite matrices of order n whose entries vanish beyond `width` from the diagonal: lower triangles by
   columns, A(i, j) at a[j * BAND_STRIDE(width) + i - j]; what lies beyond width or n is zero. */
#ifndef MJTACTILE_BAND_H
#define MJTACTILE_BAND_H

#include "kernels.h"

/* Eight right-hand sides that are solved together. */
#define LANES 8
typedef double Lanes __attribute__((vector_size(64), aligned(8)));

int band_cholesky(long n, long width, double *a);                       /* in place; 1: not positive definite */
void band_forward(long n, long width, const double *L, double *x);      /* x becomes L^-1 x */
void band_backward(long n, long width, const double *L, double *x);     /* x becomes L^-T x */
void band_solve_lanes(long n, long width, const double *L, Lanes *x, long wanted); /* x becomes (L L^T)^-1 x, from row `wanted` on */
void band_inverse(long n, long width, const double *L, double *Z);      /* Z: the inverse of L L^T within the band */

#endif
