// Level, then a knot or a jump, then a path: the fit of each of many knots under each of many priors of the path's
// bend; the posterior of the knot, and where a jump may be.
#ifndef TAUTLINE_HINGE_H
#define TAUTLINE_HINGE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { HINGE_PIECES = 12, HINGE_BENDS = 8, HINGE_SEEN = 2 }; // at most
enum { HINGE_KNOTS = 33 };                                   // tolerance: candidates at once

enum { HINGE_POWERS = 3 }; // of the travel, in which every column is a parabola

// Frames: sums of the powers of their travel, and of those times what was seen.
typedef struct {
    double power[2 * HINGE_POWERS - 1], seen[HINGE_POWERS][HINGE_SEEN];
} hinge_sums_t;

// Unknowns: a level, the slope at the knot over the whole window, second derivatives in `pieces` equal parts of the
// window, each over the root of its length; with `jump` one that is 1 beyond the knot.
typedef struct {
    size_t frames, seen, pieces, bends;
    int jump;
    const double *x;           // (frames) rising, from -1/2 to 1/2 the window, which is `reach` long and begins at 0
    const hinge_sums_t *upto;  // (frames + 1) of all frames before: hinge_sum's
    double reach, all;         // above 0; squares of all that was seen
    double flat, steep;        // precisions, above 0: of level and jump; of the slope
    const double *bend;        // (bends) of the second derivatives
    double spread, least_rise; // prior of the first slope over the mean one: of its logarithm; what less counts as
} hinge_t;

// Fills upto (frames + 1), by x (frames) as above and y (frames, seen) of unit variance. Returns `all`.
double hinge_sum(const double *x, const double *y, size_t frames, size_t seen, hinge_sums_t *upto);

// What is left, for each knot and each bend.
typedef struct {
    double *deviance; // (knots, bends), below
    double *residual; // (knots, bends) sums of squares
    double *used;     // (knots, bends) effective number of unknowns; NULL: not asked for
    double *slope;    // (knots, bends, seen) at the knot, over the window
    double *jump;     // (knots, bends, seen); not touched without `jump`
} hinge_fit_t;

// deviance = N log s^2 + squares / s^2 + seen log det + that of the first slope: squares of the residual and of the
// unknowns under their prior, N = (frames - 2) seen, s^2 the larger of 1 and squares / N, det that of level and path,
// posterior over prior precision; the first slope log-normal about the mean one, from the knot to the furthest frame.
// knot (knots) 0 or more. Returns 0, as all below, where a system is not positive definite: then nothing of it is to be
// used. About 1 us a knot with all its bends.
int hinge_fit(const hinge_t *hinge, const double *knot, size_t knots, const hinge_fit_t *fit);

typedef struct {
    double knot, sigma;              // its posterior's mean and standard deviation, summed over the bends
    double deviance, residual, used; // at the best knot and bend
    double slope[HINGE_SEEN];        // the first one there
} hinge_knot_t;

// The posterior of a knot within [0, high]: candidates that come closer together until they resolve it.
int hinge_knot(const hinge_t *hinge, double high, hinge_knot_t *found);

// Jumps between neighbouring `edges` (n + 1), rising, tried at their middles: some evenly, two from `first` on, and all
// around those within `credible` of the least deviance. left (n): the deviance of each, INFINITY where it was not
// tried; size (n): of its jump.
int hinge_jumps(const hinge_t *hinge, const double *edges, size_t n, size_t first, double credible, double *left,
                double *size);

#ifdef __cplusplus
}
#endif

#endif
