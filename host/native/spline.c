#include "spline.h"

// The values at x of the splines that are not zero in the span that begins at knots[at] (Cox and de Boor).
static inline void de_boor(const double *knots, double x, int degree, size_t at, double *value) {
    double before[SPLINE_CUBIC + 1];
    value[0] = 1.0;
    for (int j = 1; j <= degree; j++) {
        for (int n = 0; n < j; n++) {
            before[n] = value[n];
        }
        value[0] = 0.0;
        for (int n = 1; n <= j; n++) {
            const double right = knots[at + (size_t)n], left = knots[at + (size_t)n - (size_t)j];
            const double share = before[n - 1] / (right - left);
            value[n - 1] += share * (right - x);
            value[n] = share * (x - left);
        }
    }
}

static inline void of_degree(const struct spline *spline, int degree, const double *x, size_t count, double *value) {
    const double *knots = spline->knots;
    const size_t channels = spline->channels;
    size_t at = (size_t)degree;
    for (size_t i = 0; i < count; i++) {
        while (x[i] < knots[at] && at > (size_t)degree) {
            at--;
        }
        while (x[i] >= knots[at + 1] && at < spline->size - 1) {
            at++;
        }
        double share[SPLINE_CUBIC + 1];
        de_boor(knots, x[i], degree, at, share);
        const double *first = spline->coefficients + (at - (size_t)degree) * channels;
        for (size_t k = 0; k < channels; k++) {
            double sum = 0.0;
            for (size_t j = 0; j <= (size_t)degree; j++) {
                sum += first[j * channels + k] * share[j];
            }
            value[i * channels + k] = sum;
        }
    }
}

void spline_at(const struct spline *spline, const double *x, size_t count, double *value) {
    if (spline->degree == SPLINE_CUBIC) { // a degree that the compiler knows takes half the time
        of_degree(spline, SPLINE_CUBIC, x, count, value);
    } else {
        of_degree(spline, SPLINE_CUBIC - 1, x, count, value);
    }
}
