#include "band_cholesky_f32.h"

#include <math.h>

#define INLINE static inline __attribute__((always_inline))

/* Factor the diagonal block of a panel and replace it by the inverse of its factor, by columns. The
   rows below become rows of the factor. Returns 1 if it is not positive definite. */
static int factor_one(long height, float *panel) {
    float inverse[PANEL][PANEL] = {{0}}; /* rows of the inverse */
    for (int c = 0; c < PANEL; c++) inverse[c][c] = 1;
    for (int c = 0; c < PANEL; c++) {
        float *own = panel + c * height;
        if (!(own[c] > 0)) return 1;
        const float over = 1 / sqrtf(own[c]);
        EIGHT(own) *= over;
        EIGHT(inverse[c]) *= over;
        for (int q = c + 1; q < PANEL; q++) {
            EIGHT(panel + q * height) -= own[q] * CONST_EIGHT(own);
            EIGHT(inverse[q]) -= own[q] * CONST_EIGHT(inverse[c]);
        }
    }
    for (long i = PANEL; i < height; i += PANEL) {
        Eight below[PANEL];
        for (int c = 0; c < PANEL; c++) below[c] = CONST_EIGHT(panel + c * height + i);
        for (int c = PANEL - 1; c >= 0; c--) {
            Eight sum = inverse[c][c] * below[c];
            for (int k = 0; k < c; k++) sum += inverse[c][k] * below[k];
            EIGHT(panel + c * height + i) = sum;
        }
    }
    for (int c = 0; c < PANEL; c++)
        for (int r = 0; r < PANEL; r++) panel[c * height + r] = inverse[r][c];
    return 0;
}

/* Subtract the contribution of rows `i` to `i` + 8 `blocks` - 1 of a panel from four columns of
   another panel. Each value read is used in several sums. */
INLINE void take_off_four(long height, const float *panel, long down, long i, int blocks, int first, float *other) {
    Eight left[2][4];
    float *to = other + first * height + i - down;
    for (int b = 0; b < blocks; b++)
        for (int q = 0; q < 4; q++) left[b][q] = CONST_EIGHT(to + q * height + b * PANEL);
    for (int c = 0; c < PANEL; c++) {
        const float *own = panel + c * height;
        for (int q = 0; q < 4; q++)
            for (int b = 0; b < blocks; b++) left[b][q] -= own[down + first + q] * CONST_EIGHT(own + i + b * PANEL);
    }
    for (int b = 0; b < blocks; b++)
        for (int q = 0; q < 4; q++) EIGHT(to + q * height + b * PANEL) = left[b][q];
}

/* Subtract a panel's contribution from the panel that begins `down` rows below. */
static void take_off(long height, const float *panel, long down, float *other) {
    long i = down;
    for (; i + PANEL < height; i += 2 * PANEL)
        for (int first = 0; first < PANEL; first += 4) take_off_four(height, panel, down, i, 2, first, other);
    for (; i < height; i += PANEL)
        for (int first = 0; first < PANEL; first += 4) take_off_four(height, panel, down, i, 1, first, other);
}

int panels_factor(long count, long room, long height, float *panels) {
    for (long p = 0; p < count; p++) {
        float *panel = panels + p * PANEL * height;
        if (factor_one(height, panel)) return 1;
        for (long down = PANEL, other = p + 1; down < height && other < count + room; down += PANEL, other++)
            take_off(height, panel, down, panels + other * PANEL * height);
    }
    return 0;
}

/* Return the sum of the entries of each of eight vectors. */
INLINE Eight sums_of(const Eight *v) {
#if defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
    Eight pair[4], four[2];
    for (int k = 0; k < 4; k++)
        pair[k] = __builtin_shufflevector(v[2 * k], v[2 * k + 1], 0, 8, 2, 10, 4, 12, 6, 14) +
                  __builtin_shufflevector(v[2 * k], v[2 * k + 1], 1, 9, 3, 11, 5, 13, 7, 15);
    for (int k = 0; k < 2; k++)
        four[k] = __builtin_shufflevector(pair[2 * k], pair[2 * k + 1], 0, 1, 8, 9, 4, 5, 12, 13) +
                  __builtin_shufflevector(pair[2 * k], pair[2 * k + 1], 2, 3, 10, 11, 6, 7, 14, 15);
    return __builtin_shufflevector(four[0], four[1], 0, 1, 2, 3, 8, 9, 10, 11) +
           __builtin_shufflevector(four[0], four[1], 4, 5, 6, 7, 12, 13, 14, 15);
#endif
#endif
    Eight sums = {0};
    for (int c = 0; c < PANEL; c++)
        for (int r = 0; r < PANEL; r++) sums[c] += v[c][r];
    return sums;
}

INLINE void forward(long count, long height, const float *panels, int many, long stride, float *x) {
    for (long p = 0; p < count; p++) {
        const float *panel = panels + p * PANEL * height;
        for (int m = 0; m < many; m++) {
            float *own = x + m * stride + p * PANEL;
            Eight found = own[0] * CONST_EIGHT(panel), rest = own[1] * CONST_EIGHT(panel + height);
            for (int c = 2; c < PANEL; c += 2) {
                found += own[c] * CONST_EIGHT(panel + c * height);
                rest += own[c + 1] * CONST_EIGHT(panel + (c + 1) * height);
            }
            EIGHT(own) = found + rest;
        }
        for (long i = PANEL; i < height; i += PANEL)
            for (int m = 0; m < many; m++) {
                float *own = x + m * stride + p * PANEL;
                Eight left = CONST_EIGHT(own + i), more = {0};
                for (int c = 0; c < PANEL; c += 2) {
                    left -= own[c] * CONST_EIGHT(panel + c * height + i);
                    more -= own[c + 1] * CONST_EIGHT(panel + (c + 1) * height + i);
                }
                EIGHT(own + i) = left + more;
            }
    }
}

INLINE void backward(long count, long height, const float *panels, int many, long stride, float *x) {
    for (long p = count - 1; p >= 0; p--) {
        const float *panel = panels + p * PANEL * height;
        for (int m = 0; m < many; m++) {
            float *own = x + m * stride + p * PANEL;
            Eight below[PANEL];
            const Eight first = CONST_EIGHT(own + PANEL);
            for (int c = 0; c < PANEL; c++) below[c] = CONST_EIGHT(panel + c * height + PANEL) * first;
            for (long i = 2 * PANEL; i < height; i += PANEL) {
                const Eight at = CONST_EIGHT(own + i);
                for (int c = 0; c < PANEL; c++) below[c] += CONST_EIGHT(panel + c * height + i) * at;
            }
            const Eight left = CONST_EIGHT(own) - sums_of(below);
            for (int c = 0; c < PANEL; c++) below[c] = CONST_EIGHT(panel + c * height) * left;
            EIGHT(own) = sums_of(below);
        }
    }
}

void panels_forward(long count, long height, const float *panels, int many, long stride, float *x) {
    if (many == 3) forward(count, height, panels, 3, stride, x);
    else forward(count, height, panels, 1, stride, x);
}

void panels_backward(long count, long height, const float *panels, int many, long stride, float *x) {
    if (many == 3) backward(count, height, panels, 3, stride, x);
    else backward(count, height, panels, 1, stride, x);
}

void panels_solve_eight(long count, long height, const float *panels, Eight *x) {
    for (long p = 0; p < count; p++) {
        const float *panel = panels + p * PANEL * height;
        Eight *own = x + p * PANEL, found[PANEL];
        for (int r = 0; r < PANEL; r++) {
            found[r] = panel[r] * own[0];
            for (int c = 1; c <= r; c++) found[r] += panel[c * height + r] * own[c];
        }
        for (int r = 0; r < PANEL; r++) own[r] = found[r];
        for (long i = PANEL; i < height; i++) {
            Eight left = own[i];
            for (int c = 0; c < PANEL; c++) left -= panel[c * height + i] * found[c];
            own[i] = left;
        }
    }
    for (long p = count - 1; p >= 0; p--) {
        const float *panel = panels + p * PANEL * height;
        Eight *own = x + p * PANEL, left[PANEL];
        for (int c = 0; c < PANEL; c++) left[c] = own[c];
        for (long i = PANEL; i < height; i++)
            for (int c = 0; c < PANEL; c++) left[c] -= panel[c * height + i] * own[i];
        for (int c = 0; c < PANEL; c++) {
            own[c] = panel[c * height + c] * left[c];
            for (int r = c + 1; r < PANEL; r++) own[c] += panel[c * height + r] * left[r];
        }
    }
}
