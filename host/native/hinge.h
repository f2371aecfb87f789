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
} hinge_t;

// What is left, for each knot and each bend.
typedef struct {
    double *squares;      // (knots, bends) of the residual and of the coefficients under their prior
    double *residual;     // (knots, bends) squares of the residual alone
    double *volume;       // (knots, bends) log of the determinant of level and path, posterior over prior precision
    double *used;         // (knots, bends) effective number of columns; NULL: not asked for
    double *way;          // (knots, bends, seen) of the path from the knot to the furthest frame
    double *coefficients; // (knots, bends, columns, seen)
} hinge_fit_t;

static inline size_t hinge_columns(const hinge_t *hinge) {
    return 2 + hinge->pieces + (hinge->jump ? 1 : 0);
}

// Returns 0 where a value is not finite or a system not positive definite: then nothing of it is to be used. About 1 us
// a knot and bend.
int hinge_fit(const hinge_t *hinge, const hinge_fit_t *fit);

#ifdef __cplusplus
}
#endif

#endif
