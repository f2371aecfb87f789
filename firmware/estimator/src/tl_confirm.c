#include "tl_confirm.h"

#include "tautline/tl_fast.h"

#define PRIOR_DOF   8   ///< degrees of freedom that the stated noise is worth
#define DOF_MAX     512 ///< of remembered noise: about four reversals
#define NOISE_FLOOR 26  ///< (0.005 px)^2, Q16, weight 16: below it the image's own resolution
#define DOUBT       12  ///< see fits_badly()

void tl_confirm_begin(tl_onset_detector_t *d) {
    const int64_t noise_q8 = (d->config.noise_px + 8) / 16;
    d->noise_sum = PRIOR_DOF * TL_CONFIRM_WEIGHT * noise_q8 * noise_q8;
    d->noise_dof = PRIOR_DOF;
    d->noise_measured = false;
}

TL_FAST tl_real_t tl_confirm_required(const tl_onset_detector_t *d, tl_real_t unit, int32_t dof) {
    const tl_real_t nu = tl_real(d->noise_dof + dof, 0);
    // e^x = (1 + x / 256)^256; x is at most 4095 / 8
    tl_real_t power = tl_real_add(tl_real(1, 0), tl_real_div(tl_real(d->config.threshold, -12), nu));
    for (int32_t i = 0; i < 8; i++) {
        power = tl_real_square(power);
    }
    return tl_real_mul(tl_real_mul(tl_real_add(power, tl_real(-1, 0)), nu), unit);
}

TL_FAST tl_real_t tl_confirm_unit_variance(const tl_onset_detector_t *d, tl_real_t residual, int32_t dof) {
    const tl_real_t sum = tl_real_add(tl_real(d->noise_sum, 0), residual);
    const tl_real_t variance = tl_real_div(sum, tl_real(d->noise_dof + dof, 0));
    return tl_real_less(variance, tl_real(NOISE_FLOOR, 0)) ? tl_real(NOISE_FLOOR, 0) : variance;
}

TL_FAST void tl_confirm_remember(tl_onset_detector_t *d, tl_real_t residual, int32_t dof) {
    if (!d->noise_measured && dof >= 2 * PRIOR_DOF) { // what was stated has served
        d->noise_measured = true;
        d->noise_sum = 0;
        d->noise_dof = 0;
    }
    if (dof > 0) {
        d->noise_sum += (int64_t)tl_real_to_q(residual, -4) * 16;
        d->noise_dof += dof;
    }
    while (d->noise_dof > DOF_MAX) {
        d->noise_sum /= 2;
        d->noise_dof /= 2;
    }
}

TL_FAST tl_real_t tl_confirm_curvature_bias2(const tl_onset_config_t *config, tl_real_t span) {
    // curvature in 1/2^20 a count, span in Q8 counts
    const tl_real_t twelfth = tl_real(((int64_t)1 << 34) / 12, -34 - 28);
    return tl_real_square(tl_real_mul(tl_real_mul(tl_real(config->curvature, 0), tl_real_square(span)), twelfth));
}

/// Of the difference of two encoder positions: 1/12 count^2 each, Q8 counts squared.
static TL_FAST tl_real_t encoder_variance(void) {
    return tl_real(((int64_t)TL_COUNT_ONE * TL_COUNT_ONE << 17) / 6, -17);
}

TL_FAST tl_real_t tl_confirm_knot_variance(const tl_onset_config_t *config, tl_real_t variance, tl_real_t unit,
                                           tl_real_t span) {
    return tl_real_add(tl_real_add(tl_real_mul(variance, unit), encoder_variance()),
                       tl_confirm_curvature_bias2(config, span));
}

/// Replaces the hinge by a break where the image jumped at the onset, beyond doubt.
static TL_FAST void allow_for_jump(const tl_onset_detector_t *d, tl_confirm_t *e) {
    tl_hinge_break_t jump;
    if (!tl_hinge_break(d, &jump)) {
        return;
    }
    const tl_real_t gained = tl_real_sub(jump.gain, e->hinge.gain);
    const tl_real_t unit = tl_confirm_unit_variance(d, tl_real_sub(e->hinge.residual, gained), e->dof);
    const tl_real_t required = tl_confirm_required(d, unit, e->dof);
    if (!tl_real_less(required, gained)) {
        return;
    }
    const tl_real_t gap = tl_real((int64_t)jump.high - jump.low, 0);
    e->hinge.knot = tl_real((int64_t)jump.low + jump.high, -1);
    e->hinge.level = jump.level;
    e->hinge.beyond = jump.beyond;
    e->unit = unit;
    e->variance = tl_real_add(tl_real_div(tl_real_square(gap), tl_real(12, 0)), encoder_variance());
    e->jumped = true;
}

/// Whether what the hinge leaves is more than the noise known so far explains; DOUBT in units of its variance
/// is half of what a jump must gain.
static TL_FAST bool fits_badly(const tl_onset_detector_t *d, const tl_confirm_t *e) {
    const tl_real_t known = tl_real_div(tl_real(d->noise_sum, 0), tl_real(d->noise_dof, 0));
    return tl_real_less(tl_real_mul(known, tl_real(e->dof + DOUBT, 0)), e->hinge.residual);
}

TL_FAST bool tl_confirm_evaluate(const tl_onset_detector_t *d, tl_confirm_t *e) {
    if (!tl_hinge_fit(d, &e->hinge)) {
        return false;
    }
    e->jumped = false;
    e->dof = 2 * d->all.n - 5;
    e->unit = tl_confirm_unit_variance(d, e->hinge.residual, e->dof);
    e->required = tl_confirm_required(d, e->unit, e->dof);
    e->variance = tl_confirm_knot_variance(&d->config, e->hinge.variance, e->unit, e->hinge.span);
    e->confirmed = e->hinge.beyond >= 2 && tl_real_less(e->required, e->hinge.gain);
    if (e->confirmed && e->hinge.beyond >= d->config.frames_min && fits_badly(d, e)) {
        allow_for_jump(d, e);
    }
    return true;
}

TL_FAST bool tl_confirm_glance(const tl_onset_detector_t *d) {
    const int32_t dof = 2 * d->all.n - 5;
    if (d->held < d->config.frames_min || dof < 1) {
        return false;
    }
    const tl_real_t gain = tl_hinge_glance(d);
    const tl_real_t unit = tl_confirm_unit_variance(d, tl_real_sub(tl_hinge_scatter(&d->all), gain), dof);
    const tl_real_t required = tl_confirm_required(d, unit, dof);
    return tl_real_less(required, tl_real_shift(gain, 1));
}

TL_FAST bool tl_confirm_may_improve(const tl_onset_detector_t *d, const tl_confirm_t *e) {
    const tl_onset_config_t *config = &d->config;
    if (e->jumped) {
        return false;
    }
    const tl_real_t statistical = tl_real_mul(e->hinge.variance, e->unit);
    const tl_real_t bias2 = tl_confirm_curvature_bias2(config, e->hinge.span);
    return e->hinge.beyond < config->frames_min ||
           (e->hinge.beyond < config->frames_max &&
            tl_real_less(tl_real_square(tl_real(config->sigma_wanted, 0)), e->variance) &&
            tl_real_less(tl_real_shift(bias2, 2), statistical));
}

TL_FAST tl_real_t tl_confirm_variance(const tl_onset_detector_t *d, const tl_confirm_t *e) {
    if (e->jumped) {
        return e->variance;
    }
    const tl_real_t frame = tl_real_div(e->hinge.span, tl_real(e->hinge.beyond, 0));
    if (tl_real_less(tl_real_shift(e->variance, 2), tl_real_square(frame))) {
        return e->variance;
    }
    const tl_real_t two_sigma = tl_hinge_spread(d, &e->hinge, tl_real_shift(e->unit, 2));
    const tl_real_t wide = tl_real_shift(tl_real_square(two_sigma), -2);
    return tl_real_less(e->variance, wide) ? wide : e->variance;
}

TL_FAST int32_t tl_confirm_sigma(tl_real_t variance) {
    return tl_real_to_q(tl_real_sqrt(variance), 0);
}

TL_FAST tl_px_q12_t tl_confirm_noise(tl_real_t unit) {
    _Static_assert(TL_CONFIRM_WEIGHT == 16, "unit / 16 is the variance in Q16: sixteen times itself in Q24");
    return tl_confirm_sigma(tl_real_shift(unit, 4));
}
