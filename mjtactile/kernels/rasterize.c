/* Triangles painted where they are the nearest: report/software_renderer.py. */
#include "kernels.h"
#include "small_linalg.h"

static int64_t clamped_index(double x, int64_t count) {
    return x < 0 ? 0 : x > (double)count ? count : (int64_t)x;
}

void paint_triangles(int64_t n, const double *corners, const double *rgb, int64_t height, int64_t width, double *depth,
                     double *image) {
    for (int64_t t = 0; t < n; t++) {
        double u[3], v[3], near[3];
        for (int k = 0; k < 3; k++) {  /* pixels, down from the top; the width is from -1 to 1 */
            const double *p = corners + 9 * t + 3 * k;
            u[k] = p[0] * width / 2 + (width - 1) / 2.0, v[k] = -p[1] * width / 2 + (height - 1) / 2.0, near[k] = p[2];
        }
        double area = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0]);
        if (!(fabs(area) >= 1e-9)) continue;
        int64_t c0 = clamped_index(ceil(min_of(u[0], min_of(u[1], u[2]))), width);
        int64_t r0 = clamped_index(ceil(min_of(v[0], min_of(v[1], v[2]))), height);
        int64_t c1 = clamped_index(floor(max_of(u[0], max_of(u[1], u[2]))) + 1, width);
        int64_t r1 = clamped_index(floor(max_of(v[0], max_of(v[1], v[2]))) + 1, height);
        for (int64_t r = r0; r < r1; r++)
            for (int64_t c = c0; c < c1; c++) {
                double x = c - u[0], y = r - v[0];
                double second = (x * (v[2] - v[0]) - y * (u[2] - u[0])) / area;
                double third = (y * (u[1] - u[0]) - x * (v[1] - v[0])) / area;
                double here = (1 - second - third) * near[0] + second * near[1] + third * near[2];
                if (second < 0 || third < 0 || second + third > 1 || here <= depth[r * width + c]) continue;
                depth[r * width + c] = here;
                for (int k = 0; k < 3; k++) image[3 * (r * width + c) + k] = rgb[3 * t + k];
            }
    }
}
