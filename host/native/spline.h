// B-splines at many places, to the last bit as scipy.interpolate.BSpline has them. Places that go on from one another
// are found from the one before.
#ifndef TAUTLINE_SPLINE_H
#define TAUTLINE_SPLINE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { SPLINE_CUBIC = 3 };

// A spline of `degree` (2 or 3), or several (channels) over the same knots.
struct spline {
    int degree;
    const double *knots;        // (size + degree + 1) rising
    const double *coefficients; // (size, channels)
    size_t size, channels;
};

// value: (count, channels) at x (count); NaN at a NaN. x within knots[degree] and knots[size], else the nearest piece
// goes on. About 20 ns each.
void spline_at(const struct spline *spline, const double *x, size_t count, double *value);

#ifdef __cplusplus
}
#endif
#endif
