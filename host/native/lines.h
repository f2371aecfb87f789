// Straight lines between knots, held beyond the ends: where a motor was. To the last bit what numpy's interp gives,
// which looks for the span anew of every x that is not near the one before: of a quick sensor a fifth of its
// calibration.
#ifndef TAUTLINE_LINES_H
#define TAUTLINE_LINES_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct lines {
    const double *x, *y; // (knots) x rising
    size_t knots;        // 1 or more
    double a_unit;       // how many there are in the mean
};

static inline struct lines lines_of(const double *x, const double *y, size_t knots) {
    const struct lines lines = {x, y, knots, (double)(knots - 1) / (x[knots - 1] - x[0])};
    return lines;
}

// y at x; NaN at x that is none. *from: the span to look from (0 at first), left at the one found, with others
// as close as they are in the mean: O(log of how many spans that is off).
double lines_at(const struct lines *lines, double x, size_t *from);

#ifdef __cplusplus
}
#endif

#endif
