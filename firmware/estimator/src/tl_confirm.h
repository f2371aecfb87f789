/// What the frames of one reversal prove: whether the image has started, where, and how surely. Private to
/// the onset detector.
#ifndef TAUTLINE_TL_CONFIRM_H
#define TAUTLINE_TL_CONFIRM_H

#include "tl_hinge.h"

#define TL_CONFIRM_WEIGHT 16 ///< of a sample whose sigma is config.noise_px

typedef struct {
    tl_hinge_t hinge;
    tl_real_t unit;     ///< variance of a sample of unit weight, Q16 px^2
    tl_real_t required; ///< gain that confirms
    tl_real_t variance; ///< of the knot, Q8 counts squared
    int32_t dof;        ///< degrees of freedom that the hinge leaves
    bool confirmed;
    bool jumped; ///< the image jumped at the onset: the knot is half-way between two frames, no more is known
} tl_confirm_t;

/// Noise memory as the configuration states it.
void tl_confirm_begin(tl_onset_detector_t *d);

/// Adds squared residuals of `dof` degrees of freedom to the noise memory.
void tl_confirm_remember(tl_onset_detector_t *d, tl_real_t residual, int32_t dof);

/// Variance of a sample of unit weight, from memory and `residual` with `dof` degrees of freedom.
tl_real_t tl_confirm_unit_variance(const tl_onset_detector_t *d, tl_real_t residual, int32_t dof);

/// Gain that confirms, where the residual had `dof` degrees of freedom besides the memory's: with unknown
/// noise the likelihood ratio is nu ln(1 + F / nu) > threshold, so F > nu (e^(threshold / nu) - 1).
tl_real_t tl_confirm_required(const tl_onset_detector_t *d, tl_real_t unit, int32_t dof);

/// Whether a confirmation is near enough for the whole fit.
bool tl_confirm_glance(const tl_onset_detector_t *d);

/// The whole fit; false where none is determined.
bool tl_confirm_evaluate(const tl_onset_detector_t *d, tl_confirm_t *e);

/// Whether more frames are worth waiting for.
bool tl_confirm_may_improve(const tl_onset_detector_t *d, const tl_confirm_t *e);

/// Variance of the knot to be told, Q8 counts squared. Where two sigma reach over a frame the likelihood is
/// no longer a parabola: there two sigma are where it has fallen by a factor of e^2, if that is wider.
tl_real_t tl_confirm_variance(const tl_onset_detector_t *d, const tl_confirm_t *e);

/// Squared bias of the end of a line of length `span` by curvature: (curvature span^2 / 12)^2, Q8 counts
/// squared.
tl_real_t tl_confirm_curvature_bias2(const tl_onset_config_t *config, tl_real_t span);

/// Statistical variance (for unit residual variance), encoder steps and curvature together, Q8 counts
/// squared.
tl_real_t tl_confirm_knot_variance(const tl_onset_config_t *config, tl_real_t variance, tl_real_t unit, tl_real_t span);

/// Its square root, rounded.
int32_t tl_confirm_sigma(tl_real_t variance);

/// Noise of a coordinate of a sample with config.noise_px.
tl_px_q12_t tl_confirm_noise(tl_real_t unit);

#endif
