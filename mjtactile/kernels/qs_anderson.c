#include "qs_anderson.h"

#include <math.h>
#include <string.h>

#define NEAR_SINGULAR 1e-7
#define MAX_LEARNT 10 /* maximum coefficient of a previous step; above it, steps are not mixed */

long qs_anderson_size(long all) { return (2 * MEMORY + 2) * all; }

Anderson qs_anderson_in(long all, long places, float **room) {
    Anderson l = {.all = all, .places = places};
    l.steps = *room, l.changes = l.steps + MEMORY * all, l.last = l.changes + MEMORY * all, l.now = l.last + all;
    *room = l.now + all;
    return l;
}

static double dot(const float *a, const float *b, long n) {
    float sum = 0;
    for (long i = 0; i < n; i++) sum += a[i] * b[i];
    return (double)sum;
}

/* Solve A y = b in place for a symmetric positive definite A of order n <= MEMORY. */
static void solve_small(long n, double A[MEMORY][MEMORY], double *b) {
    double trace = 0;
    for (long k = 0; k < n; k++) trace += A[k][k];
    for (long k = 0; k < n; k++) A[k][k] += NEAR_SINGULAR * trace;
    for (long k = 0; k < n; k++) {
        for (long i = k + 1; i < n; i++) {
            const double by = A[i][k] / A[k][k];
            for (long j = k; j < n; j++) A[i][j] -= by * A[k][j];
            b[i] -= by * b[k];
        }
    }
    for (long k = n - 1; k >= 0; k--) {
        for (long j = k + 1; j < n; j++) b[k] -= A[k][j] * b[j];
        b[k] /= A[k][k];
    }
}

static int mix(Anderson *l) {
    double A[MEMORY][MEMORY], fraction[MEMORY];
    for (long a = 0; a < l->known; a++) {
        fraction[a] = dot(l->changes + a * l->all, l->now, l->places);
        for (long b = 0; b <= a; b++) A[a][b] = A[b][a] = dot(l->changes + a * l->all, l->changes + b * l->all, l->places);
    }
    solve_small(l->known, A, fraction);
    for (long a = 0; a < l->known; a++)
        if (!(fabs(fraction[a]) < MAX_LEARNT)) return 0;
    for (long a = 0; a < l->known; a++) {
        const float by = (float)fraction[a], *step = l->steps + a * l->all, *change = l->changes + a * l->all;
        for (long k = 0; k < l->all; k++) l->now[k] -= by * (step[k] + change[k]);
    }
    return 1;
}

int qs_anderson_update(Anderson *l, int fresh) {
    if (fresh) {
        qs_anderson_reset(l);
    } else {
        float *change = l->changes + l->newest * l->all;
        for (long k = 0; k < l->all; k++) change[k] = l->now[k] - l->last[k];
        l->known = l->known < MEMORY ? l->known + 1 : MEMORY;
    }
    memcpy(l->last, l->now, l->all * sizeof *l->now);
    const int mixed = l->known && mix(l);
    l->newest = fresh ? 0 : (l->newest + 1) % MEMORY;
    memcpy(l->steps + l->newest * l->all, l->now, l->all * sizeof *l->now);
    return mixed;
}
