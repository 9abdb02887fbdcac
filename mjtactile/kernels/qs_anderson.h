/* Anderson mixing of the solver's steps (Walker & Ni, SIAM J. Numer. Anal. 49, 2011). */
#ifndef MJTACTILE_QS_ANDERSON_H
#define MJTACTILE_QS_ANDERSON_H

#define MEMORY 4 /* previous steps that determine the next one */

/* History of steps of `all` numbers, of which the first `places` enter the least squares. `known`
   of `MEMORY` steps are stored. */
typedef struct {
    long all, places, known, newest;
    float *steps, *changes, *last, *now;
} Anderson;

long qs_anderson_size(long all);
Anderson qs_anderson_in(long all, long places, float **room);
static inline void qs_anderson_reset(Anderson *l) { l->known = l->newest = 0; }
/* Replace the present step `now` by the step that would have ended in equilibrium if the last steps
   had changed in proportion. It is stored as such; `last` keeps the original. `fresh`: ignore
   previous steps. Returns 1 if both differ. */
int qs_anderson_update(Anderson *l, int fresh);

#endif
