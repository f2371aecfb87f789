// Uniform cubic B-splines: `size` of them over [low, low + (size - 3) step]; arguments beyond are moved to the nearer
// end.
#ifndef TAUTLINE_SPLINE_H
#define TAUTLINE_SPLINE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { SPLINE_CUBIC = 4 };

struct spline_basis {
    double low, step;
    size_t size; // 4 or more
};

// Where x is: the first of the four splines that are not zero there, and in *t how far it is within its span, 0 to 1;
// NaN of x that is none.
static inline size_t spline_span(const struct spline_basis *basis, double x, double *t) {
    const size_t spans = basis->size - 3;
    double u = (x - basis->low) / basis->step;
    u = u < 0.0 ? 0.0 : u;
    u = u > (double)spans ? (double)spans : u;
    const size_t span = u >= 1.0 ? (size_t)u - (u == (double)spans ? 1 : 0) : 0;
    *t = u - (double)span;
    return span;
}

// The values of the four splines.
static inline void spline_values(double t, double value[SPLINE_CUBIC]) {
    const double s = 1.0 - t, sixth = 1.0 / 6.0;
    value[0] = s * s * s * sixth;
    value[1] = ((3.0 * t - 6.0) * t * t + 4.0) * sixth;
    value[2] = ((3.0 * s - 6.0) * s * s + 4.0) * sixth;
    value[3] = t * t * t * sixth;
}

// Their derivatives by t.
static inline void spline_slopes(double t, double slope[SPLINE_CUBIC]) {
    const double s = 1.0 - t;
    slope[0] = -0.5 * s * s;
    slope[1] = (1.5 * t - 2.0) * t;
    slope[2] = (2.0 - 1.5 * s) * s;
    slope[3] = 0.5 * t * t;
}

#ifdef __cplusplus
}
#endif

#endif
