/* What the frames before say of a marker's outline, and whether the one that is seen is that. */
#ifndef TAUTLINE_EXPECTED_H
#define TAUTLINE_EXPECTED_H

#include "marker.h"

/* Priors. */
#define HIDDEN 0.02 /* that a part is hidden in a frame */
#define STRAY                                                                                                          \
    0.03 /* share of the edges that stray, of a whole marker; of one that is hidden in part any is as likely */

#define AS_MANY 8.0 /* prior: edges that the scatter of the frames before counts for */

/* px2: variance of an edge, of `count` independent ones (less than none: no more than the frames before say) whose
 * squares are `square`. */
double expected_scatter(const marker_noise_t *noise, double square, double count);

/* By which neighbouring edges say less than independent ones. */
double expected_together(const marker_noise_t *noise);

/* Correlation of neighbouring edges' noise. */
double expected_alike(const marker_noise_t *noise);

/* `before`, of a frame in which the marker is at (u, v) px. */
void expected_at(const marker_expected_t *before, double u, double v, marker_expected_t *out);

/* px2: variance of a term in this frame. */
double expected_variance(const marker_expected_t *expected, int term);

/* Log of the odds that a part of the marker is hidden, by the shape of the outline that was fitted to `kept` of `count`
 * edges, which scatter by `scatter` px about it. */
double expected_hidden(const marker_expected_t *expected, const double shape[MARKER_SHAPE], double scatter, int kept,
                       int count);

/* Takes in a whole outline that was seen. hidden: log odds that it is not whole, by `expected_hidden`. */
void expected_learn(marker_expected_t *expected, const double shape[MARKER_SHAPE], double scatter, int kept,
                    double hidden);

/* Takes in what a frame's edges scatter by; known: of how much of it, 1: of all. */
void expected_learn_noise(marker_expected_t *expected, const marker_noise_t *seen, double known);

/* Takes in what is known after a frame in which the share `hidden` of the outline is not seen: means and variances,
 * which what is expected is a part of. */
void expected_take(marker_expected_t *expected, const double shape[MARKER_SHAPE], const double variance[MARKER_SHAPE],
                   double hidden);

#endif
