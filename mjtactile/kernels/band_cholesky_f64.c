#include "band_cholesky_f64.h"

#include <math.h>
#include <string.h>

/* Loops run over whole vectors. Behind the last entry of a column, the stride leaves room for seven
   more entries, which are zero. */
typedef double Quad __attribute__((vector_size(32), aligned(8)));
#define QUAD(p) (*(Quad *)(p))
#define CONST_QUAD(p) (*(const Quad *)(p))

/* Factor columns j to j + 3 (fewer at the end) among themselves. The contributions of all columns
   before them are already subtracted. */
static int factor_panel(long columns, long stride, long length, double *panel) {
    for (long p = 0; p < columns; p++) {
        double *own = panel + p * stride;
        if (!(own[0] > 0)) return 1;
        const double over = 1 / sqrt(own[0]);
        for (long i = 0; i < length; i += 4) QUAD(own + i) *= over;
        for (long q = p + 1; q < columns; q++) {
            double *other = panel + q * stride - (q - p);
            const double factor = own[q - p];
            if (factor == 0) continue;
            for (long i = q - p; i < length; i += 4) QUAD(other + i) -= factor * QUAD(own + i);
        }
    }
    return 0;
}

int band_cholesky(long n, long width, double *a) {
    const long stride = BAND_STRIDE(width);
    for (long j = 0; j < n; j += 4) {
        double *panel = a + j * stride;
        if (factor_panel(n - j < 4 ? n - j : 4, stride, width + 1, panel)) return 1;
        for (long t = j + 4; t < n && t <= j + 3 + width; t++) {
            const double *l0 = panel + (t - j), *l1 = l0 + stride - 1, *l2 = l1 + stride - 1, *l3 = l2 + stride - 1;
            const double f0 = l0[0], f1 = l1[0], f2 = l2[0], f3 = l3[0];
            double *column = a + t * stride;
            for (long i = 0; i <= j + 3 + width - t; i += 4)
                QUAD(column + i) -= f0 * CONST_QUAD(l0 + i) + f1 * CONST_QUAD(l1 + i) + f2 * CONST_QUAD(l2 + i) + f3 * CONST_QUAD(l3 + i);
        }
    }
    return 0;
}

/* Solve L x = b in place. Four columns are processed together while all of their rows are within
   n. */
void band_forward(long n, long width, const double *L, double *x) {
    const long stride = BAND_STRIDE(width);
    long j = 0;
    for (; j + 4 + width + 3 < n; j += 4) {
        const double *l0 = L + j * stride, *l1 = l0 + stride - 1, *l2 = l1 + stride - 1, *l3 = l2 + stride - 1;
        double *own = x + j;
        const double x0 = own[0] / l0[0], x1 = (own[1] - x0 * l0[1]) / l1[1], x2 = (own[2] - x0 * l0[2] - x1 * l1[2]) / l2[2];
        const double x3 = (own[3] - x0 * l0[3] - x1 * l1[3] - x2 * l2[3]) / l3[3];
        own[0] = x0, own[1] = x1, own[2] = x2, own[3] = x3;
        for (long i = 4; i <= width + 3; i += 4)
            QUAD(own + i) -= x0 * CONST_QUAD(l0 + i) + x1 * CONST_QUAD(l1 + i) + x2 * CONST_QUAD(l2 + i) + x3 * CONST_QUAD(l3 + i);
    }
    for (; j < n; j++) {
        const double *column = L + j * stride;
        const double value = x[j] /= column[0];
        const long last = j + width < n ? width : n - 1 - j;
        for (long i = 1; i <= last; i++) x[j + i] -= value * column[i];
    }
}

static double sum_of(Quad q) { return (q[0] + q[1]) + (q[2] + q[3]); }

void band_backward(long n, long width, const double *L, double *x) {
    const long stride = BAND_STRIDE(width), grouped = n - 4 - width - 3 > 0 ? (n - 4 - width - 3 + 3) / 4 * 4 : 0;
    long j = n - 1;
    for (; j >= grouped; j--) {
        const double *column = L + j * stride;
        const long last = j + width < n ? width : n - 1 - j;
        double sum = x[j];
        for (long i = 1; i <= last; i++) sum -= x[j + i] * column[i];
        x[j] = sum / column[0];
    }
    for (j = grouped - 4; j >= 0; j -= 4) {
        const double *l0 = L + j * stride, *l1 = l0 + stride - 1, *l2 = l1 + stride - 1, *l3 = l2 + stride - 1;
        double *own = x + j;
        Quad s0 = {0}, s1 = {0}, s2 = {0}, s3 = {0};
        for (long i = 4; i <= width + 3; i += 4) {
            const Quad at = QUAD(own + i);
            s0 += CONST_QUAD(l0 + i) * at, s1 += CONST_QUAD(l1 + i) * at, s2 += CONST_QUAD(l2 + i) * at, s3 += CONST_QUAD(l3 + i) * at;
        }
        own[3] = (own[3] - sum_of(s3)) / l3[3];
        own[2] = (own[2] - sum_of(s2) - l2[3] * own[3]) / l2[2];
        own[1] = (own[1] - sum_of(s1) - l1[3] * own[3] - l1[2] * own[2]) / l1[1];
        own[0] = (own[0] - sum_of(s0) - l0[3] * own[3] - l0[2] * own[2] - l0[1] * own[1]) / l0[0];
    }
}

/* Compute column j of the inverse Z, Z L = L^-T, below the diagonal, from the columns behind it
   (Takahashi; Erisman & Tinney, Comm. ACM 18(3), 1975). */
void band_inverse(long n, long width, const double *L, double *Z) {
    const long stride = BAND_STRIDE(width);
    memset(Z, 0, n * stride * sizeof *Z);
    for (long j = n - 1; j >= 0; j--) {
        const double *l = L + j * stride;
        double *restrict z = Z + j * stride, over = 1 / l[0], sum = over;
        long last = j + width < n ? width : n - 1 - j;
        for (long k = 1; k <= last; k++) {
            const double *restrict other = Z + (j + k) * stride;  /* Z(j + k .., j + k) */
            double own = other[0] * l[k];
            for (long i = k + 1; i <= last; i++) {
                own += other[i - k] * l[i];
                z[i] -= other[i - k] * l[k];
            }
            z[k] -= own;
        }
        for (long k = 1; k <= last; k++) z[k] *= over, sum -= z[k] * l[k];
        z[0] = sum * over;
    }
}

/* Solve rows j to j + count - 1 with the diagonal block alone. The contributions of all other rows
   are already subtracted. */
static void solve_block(long count, long stride, const double *panel, Lanes *x) {
    for (long p = 0; p < count; p++) {
        x[p] /= panel[p * stride];
        for (long q = p + 1; q < count; q++) x[q] -= panel[p * stride + q - p] * x[p];
    }
}

static void solve_block_transposed(long count, long stride, const double *panel, Lanes *x) {
    for (long p = count - 1; p >= 0; p--) {
        for (long q = p + 1; q < count; q++) x[p] -= panel[p * stride + q - p] * x[q];
        x[p] /= panel[p * stride];
    }
}

static int all_zero(const Lanes *x) {
    for (int l = 0; l < LANES; l++)
        if ((*x)[l] != 0) return 0;
    return 1;
}

void band_solve_lanes(long n, long width, const double *L, Lanes *x, long requested) {
    const long stride = BAND_STRIDE(width);
    long first = 0;
    while (first < n && all_zero(x + first)) first++; /* leading zeros remain zero */
    for (long j = first / 4 * 4; j < n; j += 4) {
        const long end = j + 4 + width < n ? j + 4 + width : n;
        const double *l0 = L + j * stride, *l1 = l0 + stride - 1, *l2 = l1 + stride - 1, *l3 = l2 + stride - 1;
        solve_block(n - j < 4 ? n - j : 4, stride, l0, x + j);
        if (end <= j + 4) break;
        const Lanes x0 = x[j], x1 = x[j + 1], x2 = x[j + 2], x3 = x[j + 3];
        for (long i = j + 4; i < end; i++) x[i] -= l0[i - j] * x0 + l1[i - j] * x1 + l2[i - j] * x2 + l3[i - j] * x3;
    }
    for (long j = (n - 1) / 4 * 4; j >= requested / 4 * 4; j -= 4) {
        const long end = j + 4 + width < n ? j + 4 + width : n;
        const double *l0 = L + j * stride, *l1 = l0 + stride - 1, *l2 = l1 + stride - 1, *l3 = l2 + stride - 1;
        if (end > j + 4) {
            Lanes s0 = x[j], s1 = x[j + 1], s2 = x[j + 2], s3 = x[j + 3];
            for (long i = j + 4; i < end; i++) {
                const Lanes at = x[i];
                s0 -= l0[i - j] * at, s1 -= l1[i - j] * at, s2 -= l2[i - j] * at, s3 -= l3[i - j] * at;
            }
            x[j] = s0, x[j + 1] = s1, x[j + 2] = s2, x[j + 3] = s3;
        }
        solve_block_transposed(n - j < 4 ? n - j : 4, stride, l0, x + j);
    }
}
