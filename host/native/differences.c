#include "differences.h"

#include <math.h>

enum { OF = 4 };

// The divided difference times the product of its six intervals, so that no gap is divided by.
static inline void factors_at(const double *t, double *f) {
    const double a = t[1] - t[0], b = t[2] - t[1], c = t[3] - t[2];
    const double first = a + b, last = b + c, all = first + c;
    f[0] = b * c * -last;
    f[1] = c * first * all;
    f[2] = -a * last * all;
    f[3] = a * b * first;
    const double size = sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2] + f[3] * f[3]), by = size > 1e-300 ? size : 1e-300;
    for (size_t k = 0; k < OF; k++) {
        f[k] /= by;
    }
}

void third_differences(const double *t, const double *q, size_t n, double *factors, double *values) {
    for (size_t i = 0; i + OF <= n; i++) {
        double f[OF];
        factors_at(t + i, f);
        values[i] = f[0] * q[i] + f[1] * q[i + 1] + f[2] * q[i + 2] + f[3] * q[i + 3];
        for (size_t k = 0; factors && k < OF; k++) {
            factors[i * OF + k] = f[k];
        }
    }
}
