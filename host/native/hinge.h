// Level, then a knot or a jump, then a path: the fit of each of many knots under each of many priors of the path's
// bend.
#ifndef TAUTLINE_HINGE_H
#define TAUTLINE_HINGE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { HINGE_COLUMNS = 16, HINGE_SEEN = 2 }; // at most

// Columns: a level, the slope at the knot over the whole window, second derivatives in `pieces` equal parts of the
// window, each over the root of its length; with `jump` one that is 1 beyond the knot.
typedef struct {
    size_t frames, seen, knots, bends, pieces;
    int jump;
    const double *x;         // (frames) 0 or more
    const double *y;         // (frames, seen) of unit variance
    const double *knot;      // (knots) 0 or more
    const double *precision; // (bends, columns) of the coefficients, above 0
    double spread, least;    // prior of the first slope over the mean one: of its logarithm; what less counts as
} hinge_t;

// What is left, for each knot and each bend.
typedef struct {
    double *deviance; // (knots, bends), below
    double *residual; // (knots, bends) sums of squares
    double *used;     // (knots, bends) effective number of columns; NULL: not asked for
    double *slope;    // (knots, bends, seen) at the knot, over the window
    double *jump;     // (knots, bends, seen); not touched without `jump`
} hinge_fit_t;

static inline size_t hinge_columns(const hinge_t *hinge) {
    return 2 + hinge->pieces + (hinge->jump ? 1 : 0);
}

// deviance = N log s^2 + squares / s^2 + seen log det + that of the first slope: squares of the residual and of the
// coefficients under their prior, N = (frames - 2) seen, s^2 the larger of 1 and squares / N, det that of level and
// path, posterior over prior precision; the first slope log-normal about the mean one, from the knot to the furthest
// frame. Returns 0 where a value is not finite or a system not positive definite: then nothing of it is to be used.
// About 1 us a knot and bend.
int hinge_fit(const hinge_t *hinge, const hinge_fit_t *fit);

#ifdef __cplusplus
}
#endif

#endif
