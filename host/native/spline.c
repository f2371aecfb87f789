#include "spline.h"

// The derivatives of the four splines.
static void slopes(double t, double step, double *value) {
    const double s = 1.0 - t, by = 0.5 / step;
    value[0] = -s * s * by;
    value[1] = (3.0 * t - 4.0) * t * by;
    value[2] = (4.0 - 3.0 * s) * s * by;
    value[3] = t * t * by;
}

void spline_curve(const struct spline_basis *basis, const double *coefficients, size_t channels, const double *x,
                  size_t n, int slope, double *curve) {
    for (size_t i = 0; i < n; i++) {
        double t, value[SPLINE_CUBIC];
        const double *c = coefficients + channels * spline_span(basis, x[i], &t);
        if (slope) {
            slopes(t, basis->step, value);
        } else {
            spline_values(t, value);
        }
        for (size_t k = 0; k < channels; k++) {
            double sum = 0.0;
            for (size_t j = 0; j < SPLINE_CUBIC; j++) {
                sum += value[j] * c[j * channels + k];
            }
            curve[i * channels + k] = sum;
        }
    }
}
