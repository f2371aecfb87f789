/// Least squares of one reversal: a level, a line, and the hinge that joins them. Private to the onset
/// detector.
///
/// Model (weights known up to a common factor): image = level for x <= knot, level + slope (x - knot) beyond,
/// image and slope two-vectors, x the motor's travel. For a given knot it is linear, and its gain over the
/// level alone is
///   T(knot) = |C_xy|^2 / (W C_xx),  C_xy = W S_xy - S_x S_y,  C_xx = W S_xx - S_x^2,
/// S the sums over the samples beyond the knot of x - knot, W and S_y over all. Samples' own positions are
/// tried as knots with sums that are shifted from one to the next; the best is refined between its
/// neighbours, where the optimum is where the line through the samples beyond meets the level (Hudson 1966).
/// All sums are exact: |x| < 2^17 units, |image| < 2^18 Q8 px, weights <= 64, at most 128 samples' worth.
/// Knots farther back than config.frames_max samples are not tried: by then a reversal has ended.
#ifndef TAUTLINE_TL_HINGE_H
#define TAUTLINE_TL_HINGE_H

#include "tautline/tl_onset.h"
#include "tl_real.h"

typedef struct {
    int32_t x;    ///< units of 2^scale Q8 counts, from the origin
    int32_t u, v; ///< Q8 px from the reference
    int32_t w;
} tl_hinge_point_t;

/// Sample i of those that are held, the oldest first.
const tl_onset_sample_t *tl_hinge_sample(const tl_onset_detector_t *d, int32_t i);

/// Straight line and level brought together; variance for unit residual variance.
typedef struct {
    tl_real_t x;        ///< where they meet, Q8 counts from the line's origin
    tl_real_t variance; ///< of x, Q8 counts squared
    tl_real_t slope;    ///< |slope|, Q8 px for a Q8 count
    tl_real_t gain;     ///< of the line over its own mean, weight x Q16 px^2
} tl_hinge_meeting_t;

typedef struct {
    tl_real_t gain;        ///< T of the best knot, weight x Q16 px^2
    tl_real_t residual;    ///< weighted squared residuals left by the hinge, same unit
    tl_real_t knot;        ///< Q8 counts of travel from the turn
    tl_real_t variance;    ///< of the knot for unit residual variance, Q8 counts squared
    tl_real_t slope;       ///< |slope|, Q8 px for a Q8 count
    tl_real_t span;        ///< travel from the knot to the last sample, Q8 counts
    tl_onset_sums_t level; ///< of the samples on the level
    int32_t beyond;        ///< samples beyond the knot: the window's last ones
} tl_hinge_t;

/// The window's i-th sample, oldest first; travel along the direction of the reversal under way from
/// `origin`.
tl_hinge_point_t tl_hinge_point(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin, int32_t scale);

/// The same at x = 0: its image alone counts.
tl_hinge_point_t tl_hinge_image(const tl_onset_detector_t *d, int32_t i);

/// Smallest scale at which the travel from `origin` to each of the window's samples from the i-th on fits 17
/// bits.
int32_t tl_hinge_scale(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin);

void tl_hinge_add(tl_onset_sums_t *sums, const tl_hinge_point_t *point);

/// sums - part, the image alone.
tl_onset_sums_t tl_hinge_without(const tl_onset_sums_t *sums, const tl_onset_sums_t *part);

/// False if line or level is not determined.
bool tl_hinge_meet(const tl_onset_sums_t *line, const tl_onset_sums_t *level, int32_t scale,
                   tl_hinge_meeting_t *meeting);

/// A lower bound of the largest gain, from the knots with 2, 4, 8 .. samples beyond: 0.9 of it where a hinge
/// is clear.
tl_real_t tl_hinge_glance(const tl_onset_detector_t *d);

/// The hinge with the largest gain; false where none is determined.
bool tl_hinge_fit(const tl_onset_detector_t *d, tl_hinge_t *fit);

/// A level, and a line that need not meet it: the image jumps at the onset (registration that depends on the
/// direction of motion). Nothing between the two frames around the jump is known then.
typedef struct {
    tl_real_t gain;     ///< over the level alone, weight x Q16 px^2
    tl_count_q8_t low;  ///< travel of the last sample on the level
    tl_count_q8_t high; ///< travel of the first sample beyond
    tl_onset_sums_t level;
    int32_t beyond;
} tl_hinge_break_t;

/// The break with the largest gain; false where none is determined.
bool tl_hinge_break(const tl_onset_detector_t *d, tl_hinge_break_t *fit);

/// How far from the best knot, Q8 counts, a sample still is that would give nearly as good a knot: its gain
/// is within `loss` of the best. 0 where no sample does. Wider than the variance says where the slope is lost
/// in noise.
tl_real_t tl_hinge_spread(const tl_onset_detector_t *d, const tl_hinge_t *fit, tl_real_t loss);

/// Travel from the turn beyond which motion at `slope` (as above) would have gained less than `gain`: what
/// happened there may have stayed unseen. Q8 counts; 0 if it would have stayed unseen within the whole
/// window.
tl_real_t tl_hinge_blind(const tl_onset_detector_t *d, tl_real_t slope, tl_real_t gain);

/// Weighted squared deviations from the mean, weight x Q16 px^2.
tl_real_t tl_hinge_scatter(const tl_onset_sums_t *sums);

#endif
