/* Wrench that a sensing chain would estimate. Model: sim/sensing_error_model.py. */
#include <math.h>

#include "kernels.h"
#include "small_linalg.h"

enum { SLOW_TIME, GRASP, SHEAR_GAIN, ELAPSED, UNIFORM };
enum { MEAN, SD = 6, FRESH = 12, REPORTED = 18, OUTLIERS = 24, BETWEEN = 29, COLUMNS = 30 };

static void interpolate_row(int64_t loads, const double *load, const double *table, double here, double *row) {
    int64_t right = 1;
    while (right < loads - 1 && load[right] < here) right++;
    const double *low = table + COLUMNS * (right - 1), *high = low + COLUMNS;
    const double fraction = clip((here - load[right - 1]) / (load[right] - load[right - 1]), 0, 1);
    for (int k = 0; k < COLUMNS; k++) row[k] = low[k] + fraction * (high[k] - low[k]);
}

/* lower triangle */
static void correlate(const double *spread, const double *normals, double *out) {
    for (int i = 0; i < 6; i++) {
        out[i] = 0;
        for (int k = 0; k <= i; k++) out[i] += spread[6 * i + k] * normals[k];
    }
}

static double persistent_variance(const double *row, int part) { /* variance of the persistent part */
    return max_of(square(row[SD + part]) - square(row[FRESH + part]), 0);
}

int64_t sample_errors(int64_t loads, const double *load, const double *table, const double *gain, const double *spread,
                    const double *reported_correlation, const double *settings, const double *outlier_size, const double *normals, const double *wrench, double *slow,
                    double *row, double *estimated, double *cov) {
    if (loads < 2) return REFUSED;
    interpolate_row(loads, load, table, max_of(-wrench[2], 0), row);
    double fresh[6], fast[6];
    correlate(spread, normals, fresh), correlate(spread, normals + 6, fast);
    const double kept = exp(-settings[ELAPSED] / settings[SLOW_TIME]), new = sqrt(max_of(1 - kept * kept, 0));
    /* the mean of its square is one */
    const double factor = exp(row[BETWEEN] * (settings[GRASP] - row[BETWEEN]));
    const int out = settings[UNIFORM] < row[OUTLIERS];
    for (int i = 0; i < 6; i++) {
        slow[i] = kept * slow[i] + new *fresh[i];
        const double lasts = persistent_variance(row, i), untouched = min_of(lasts, persistent_variance(table, i));
        const double sd = sqrt(untouched + square(factor) * (lasts - untouched));
        const double new_sd = row[FRESH + i] * (out ? outlier_size[i] : 1);
        estimated[i] = wrench[i] + row[MEAN + i] + sd * slow[i] + new_sd * fast[i];
        if (i < 2) estimated[i] += settings[SHEAR_GAIN] * wrench[i];
        for (int k = 0; k < 6; k++) {
            estimated[i] += gain[6 * i + k] * wrench[k];
            cov[6 * i + k] = row[REPORTED + i] * row[REPORTED + k] * reported_correlation[6 * i + k];
        }
    }
    return 0;
}
