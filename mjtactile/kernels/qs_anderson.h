/* Anderson's mixing of a film's steps (Walker & Ni, SIAM J. Numer. Anal. 49, 2011). */
#ifndef MJTACTILE_FILM_LEARN_H
#define MJTACTILE_FILM_LEARN_H

#define MEMORY 4 /* steps that the next one learns from */

/* Steps are of `all` numbers, of which the first `places` say how alike two are. `known` of `MEMORY` are kept. */
typedef struct {
    long all, places, known, newest;
    float *steps, *changes, *last, *now;
} Learnt;

long film_learn_room(long all);
Learnt film_learn_in(long all, long places, float **room);
static inline void film_forget(Learnt *l) { l->known = l->newest = 0; }
/* `now`, the step that was made, becomes the one that would have ended at rest had the last steps changed in proportion, and is kept
   as such; `last` is what it was. `fresh`: nothing before it counts. Returns whether they differ. */
int film_learn(Learnt *l, int fresh);

#endif
