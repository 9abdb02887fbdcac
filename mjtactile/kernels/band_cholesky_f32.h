/* Cholesky factorization of symmetric positive definite band matrices in single precision. The
   matrix is stored in panels of eight columns. All columns of a panel begin at the row of its first
   column and have `height` rows, a multiple of eight and at least width + 8. Entries beyond the
   matrix are zero. A factor stores the inverse of each panel's diagonal block in place of that
   block. */
#ifndef MJTACTILE_PANELS_H
#define MJTACTILE_PANELS_H

#define PANEL 8
typedef float Eight __attribute__((vector_size(32), aligned(4)));
#define EIGHT(p) (*(Eight *)(p))
#define CONST_EIGHT(p) (*(const Eight *)(p))

static inline long panels_height(long width) { return (width + 2 * PANEL - 1) / PANEL * PANEL; }

/* Factor `count` panels in place and subtract their contribution from the panels behind them.
   `room` is the number of panels behind, so that nothing is written past the last one. Returns 1 if
   the matrix is not positive definite. */
int panels_factor(long count, long room, long height, float *panels);
/* Solve for `many` (1 or 3) right-hand sides, `stride` numbers from each other. Forward: x becomes
   L^-1 x, and the contribution of these rows is subtracted from the rows behind the last panel.
   Backward: x becomes L^-T x; the rows behind the last panel are known. */
void panels_forward(long count, long height, const float *panels, int many, long stride, float *x);
void panels_backward(long count, long height, const float *panels, int many, long stride, float *x);

/* Solve for eight right-hand sides: x becomes (L L^T)^-1 x. A row of `x` has one entry of each of
   them. Behind the last panel's rows, `x` has room for `height` rows, which are zero. */
void panels_solve_eight(long count, long height, const float *panels, Eight *x);

#endif
