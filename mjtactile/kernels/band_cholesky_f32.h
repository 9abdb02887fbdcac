/* Symmetric positive definite band matrices in single precision, in panels of eight columns: a panel's columns all begin at the row
   of its first and go on for `height` rows, a multiple of eight, of which there are at least width + 8; what lies beyond the matrix
   is zero. A factor keeps the inverse of each panel's triangle in its place. */
#ifndef MJTACTILE_PANELS_H
#define MJTACTILE_PANELS_H

#define PANEL 8
typedef float Eight __attribute__((vector_size(32), aligned(4)));
#define EIGHT(p) (*(Eight *)(p))
#define CONST_EIGHT(p) (*(const Eight *)(p))

static inline long panels_height(long width) { return (width + 2 * PANEL - 1) / PANEL * PANEL; }

/* Factors `count` panels in place, and takes what they leave off the panels behind them (`room` says of how many of those, so that
   nothing is written behind the last). 1: not positive definite. */
int panels_factor(long count, long room, long height, float *panels);
/* Of `many` (1 or 3) right-hand sides, `apart` numbers from each other: x becomes L^-1 x, and rows behind the last panel's lose
   what those above have of them; or x becomes L^-T x, where rows behind are known. */
void panels_forward(long count, long height, const float *panels, int many, long apart, float *x);
void panels_backward(long count, long height, const float *panels, int many, long apart, float *x);

/* Eight right-hand sides, a row of `x` each of them: x becomes (L L^T)^-1 x. There is room for `height` rows behind the last panel's,
   which are zero. */
void panels_solve_eight(long count, long height, const float *panels, Eight *x);

#endif
