#include "small_linalg.h"

double upper_median(double *values, long n) {
    /* Hoare's selection of rank n / 2; NaN may end up at any position */
    long low = 0, high = n - 1, rank = n / 2;
    if (n <= 0) return NAN;
    while (low < high) {
        double pivot = values[(low + high) / 2];
        long i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot) i++;
            while (values[j] > pivot) j--;
            if (i <= j) {
                double held = values[i];
                values[i++] = values[j];
                values[j--] = held;
            }
        }
        if (rank <= j) high = j;
        else if (rank >= i) low = i;
        else break;
    }
    return values[rank];
}

int invert_spd5(const double A[5][5], double out[5][5]) {
    double L[5][5] = {{0}}, M[5][5] = {{0}};  /* A = L L^T, M = L^-1 */
    int bad = 0;
    for (int j = 0; j < 5; j++) {
        double d = A[j][j];
        for (int k = 0; k < j; k++) d -= L[j][k] * L[j][k];
        bad |= !(d > 0);
        L[j][j] = sqrt(d);
        for (int i = j + 1; i < 5; i++) {
            double s = A[i][j];
            for (int k = 0; k < j; k++) s -= L[i][k] * L[j][k];
            L[i][j] = s / L[j][j];
        }
    }
    for (int j = 0; j < 5; j++) {
        M[j][j] = 1 / L[j][j];
        for (int i = j + 1; i < 5; i++) {
            double s = 0;
            for (int k = j; k < i; k++) s -= L[i][k] * M[k][j];
            M[i][j] = s / L[i][i];
        }
    }
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++) {
            double s = bad ? NAN : 0.0;
            for (int k = i > j ? i : j; k < 5; k++) s += M[k][i] * M[k][j];
            out[i][j] = s;
        }
    return bad;
}

void sandwich5(double G[5][5], const double *cov, int parts, double *out) {
    for (int i = 0; i < parts; i++) {
        double half[5] = {0};
        for (int k = 0; k < 5; k++)
            for (int l = 0; l < 5; l++) half[l] += G[i][k] * cov[5 * k + l];
        for (int j = 0; j < parts; j++) {
            double sum = 0;
            for (int l = 0; l < 5; l++) sum += half[l] * G[j][l];
            out[parts * i + j] = sum;
        }
    }
}
