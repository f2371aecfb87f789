/* Where a marker is of which a part may be hidden.
 *
 * Its outline r(t) about its middle is known beforehand, within a spread, from the frames before. The edges that are
 * seen on rays around it are its own, or those of what is in front, which lie inside of it (rarely beyond: something of
 * its colour) and go on from ray to ray as an edge does: a hidden Markov chain around the rim tells which. Middle and
 * outline are the mode of the posterior, their covariance its curvature there, and the evidence is Laplace's, so that
 * several ways to explain a frame can be weighed.
 */
#ifndef TAUTLINE_PARTLY_H
#define TAUTLINE_PARTLY_H

#include "marker.h"
#include "rays.h"

/* A way to explain a frame, or the mean over several. */
typedef struct {
    double x, y;                   /* px in the region: the outline's middle */
    double variance;               /* px2 of x or y, their mean */
    double shape[MARKER_SHAPE];    /* px, as in marker_expected_t */
    double of_shape[MARKER_SHAPE]; /* px2, its variances */
    double scatter;                /* px, rms of its own edges about it */
    double own;                    /* share of the rays on which the outline is seen */
    double evidence;               /* log, but for what all ways have in common */
    double another;                /* probability that it is another marker */
} partly_t;

enum { PARTLY_NOT, PARTLY_SEEN, PARTLY_WHOLE };

/* The mean over the ways to explain a frame. level, about (0, 0) of the region: the marker's own. before: what is known
 * of its outline. px in the region: expected, where it should be; last, where it was, or NULL; found, where its outline
 * is and, if not NULL, its terms, should all of it be seen. PARTLY_NOT: there is no way; PARTLY_WHOLE: all of it is. */
int partly_weigh(const field_t *field, const double level[PLANE], const marker_expected_t *before,
                 const double expected[2], const double last[2], const double found[2], const double *shape,
                 partly_t *out);

#endif
