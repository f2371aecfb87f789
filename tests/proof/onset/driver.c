#include "__fc_builtin.h"

#include "../reals.h"
#include "../sums.h"
#include "tl_hinge.h"

/*@ predicate of_samples(tl_onset_sums_t *s) = 0 <= s->w <= 0x3000 && 0 <= s->n <= 192; */

/*@ requires \valid(sums) && \valid_read(point); assigns *sums \from *sums, *point; ensures of_samples(sums); */
void tl_hinge_add(tl_onset_sums_t *sums,
                  const tl_hinge_point_t *point); // this and what follows: proof hinge, tl_hinge.h

/*@ requires \valid_read(d); assigns \result \from *d; */
tl_real_t tl_hinge_glance(const tl_onset_detector_t *d);

/*@ requires \valid_read(d) && \valid_read(fit); assigns \result \from *d, *fit, loss; */
tl_real_t tl_hinge_spread(const tl_onset_detector_t *d, const tl_hinge_t *fit, tl_real_t loss);

/*@ requires \valid_read(d); assigns \result \from *d, slope, gain; */
tl_real_t tl_hinge_blind(const tl_onset_detector_t *d, tl_real_t slope, tl_real_t gain);

/*@ requires \valid_read(sums); assigns \result \from *sums; */
tl_real_t tl_hinge_scatter(const tl_onset_sums_t *sums);

/*@ requires \valid_read(history) && \valid(q); assigns *q, \result \from *history, t_us;
    ensures TL_HISTORY_OK <= \result <= TL_HISTORY_TOO_OLD; */
tl_history_status_t tl_history_at(const tl_history_t *history, tl_us_t t_us, tl_count_q8_t *q); // proof history

#define tl_hinge_meet  hinge_meet
#define tl_hinge_fit   hinge_fit
#define tl_hinge_break hinge_break
#include "../../../firmware/estimator/src/tl_hinge.c"
#undef tl_hinge_meet
#undef tl_hinge_fit
#undef tl_hinge_break

#include "../../../firmware/estimator/src/tl_confirm.c"
#include "../../../firmware/estimator/src/tl_onset.c"

#define UNSIGNED() Frama_C_unsigned_int_interval(0, UINT32_MAX)
#define FLAG()     ((bool)Frama_C_unsigned_int_interval(0, 1))
#define TIME()     Frama_C_unsigned_long_long_interval(0, UINT64_MAX)

static tl_onset_detector_t d;
static tl_history_t history;
static tl_onset_t onset;

static tl_onset_sample_t any_sample(void) {
    return (tl_onset_sample_t){
        .q = ANY(), .u = ANY(), .v = ANY(), .t_us = UNSIGNED(), .weight = Frama_C_int_interval(1, 64)};
}

// What proof hinge is about: nothing is written where the answer is no, and a knot has samples on both sides.
bool tl_hinge_meet(const tl_onset_sums_t *line, const tl_onset_sums_t *level, int32_t scale,
                   tl_hinge_meeting_t *meeting) {
    if (level->n < 1 || line->n < 2 || Frama_C_nondet(0, 1)) {
        return false;
    }
    *meeting = (tl_hinge_meeting_t){NUMBER(), NUMBER(), NUMBER(), NUMBER()};
    return true;
}

bool tl_hinge_fit(const tl_onset_detector_t *of, tl_hinge_t *fit) {
    if (of->held < 2 || of->all.n < 3 || Frama_C_nondet(0, 1)) {
        return false;
    }
    *fit = (tl_hinge_t){NUMBER(), NUMBER(), NUMBER(), NUMBER(), NUMBER(), NUMBER(), any_sums(), 0};
    fit->beyond = Frama_C_int_interval(1, of->held - 1);
    return true;
}

bool tl_hinge_break(const tl_onset_detector_t *of, tl_hinge_break_t *fit) {
    if (of->held < 2 || Frama_C_nondet(0, 1)) {
        return false;
    }
    *fit = (tl_hinge_break_t){NUMBER(), ANY(), ANY(), any_sums(), 0};
    fit->beyond = Frama_C_int_interval(1, of->held - 1);
    return true;
}

static void begin(void) {
    tl_onset_config_t config;
    config.delay_us = UNSIGNED();
    config.guard_us = UNSIGNED();
    config.lost_us = UNSIGNED();
    config.timeout_us = UNSIGNED();
    config.turn = ANY();
    config.sigma_wanted = ANY();
    config.sigma_usable = ANY();
    config.noise_px = ANY();
    config.curvature = UNSIGNED();
    config.threshold = (uint16_t)Frama_C_unsigned_int_interval(0, UINT16_MAX);
    config.frames_min = (uint8_t)Frama_C_unsigned_int_interval(0, UINT8_MAX);
    config.frames_max = (uint8_t)Frama_C_unsigned_int_interval(0, UINT8_MAX);
    tl_onset_init(&d, &config);
}

// Any that a start and frames can leave.
static void any_detector(void) {
    d.config.delay_us = Frama_C_unsigned_int_interval(0, 400000);
    d.config.guard_us = Frama_C_unsigned_int_interval(0, 400000);
    d.config.lost_us = Frama_C_unsigned_int_interval(1, 10000000);
    d.config.timeout_us = Frama_C_unsigned_int_interval(1, 600000000);
    d.config.turn = Frama_C_int_interval(1, INT32_MAX);
    d.config.sigma_wanted = Frama_C_int_interval(1, INT32_MAX);
    d.config.sigma_usable = Frama_C_int_interval(1, INT32_MAX);
    d.config.noise_px = Frama_C_int_interval(1, 8 * TL_PX_ONE);
    d.config.curvature = Frama_C_unsigned_int_interval(0, (1U << 20) - 1U);
    d.config.threshold = (uint16_t)Frama_C_unsigned_int_interval(1, UINT16_MAX);
    d.config.frames_min = (uint8_t)Frama_C_unsigned_int_interval(3, TL_ONSET_WINDOW - 2U);
    d.config.frames_max = (uint8_t)Frama_C_unsigned_int_interval(3, TL_ONSET_WINDOW - 2U);
    d.direction = (int8_t)Frama_C_int_interval(-1, 1);
    d.phase = (uint8_t)Frama_C_nondet(FOLLOWING, CROSSING);
    d.oldest = (uint8_t)Frama_C_unsigned_int_interval(0, TL_ONSET_WINDOW - 1U);
    d.held = (uint8_t)Frama_C_unsigned_int_interval(0, TL_ONSET_WINDOW);
    d.known = (uint8_t)Frama_C_unsigned_int_interval(0, DOUBTED);
    d.placed = FLAG();
    d.on_envelope = FLAG();
    d.entered = FLAG();
    d.settled = FLAG();
    d.told = FLAG();
    d.noise_measured = FLAG();
    d.noise_dof = Frama_C_int_interval(1, DOF_MAX);
    d.noise_sum = LONG(50);
    d.arrival_us = TIME();
    d.scanned_us = TIME();
    d.seen_us = TIME();
    d.extreme_us = TIME();
    d.extreme = ANY();
    d.opposite = ANY();
    d.reference_u = ANY();
    d.reference_v = ANY();
    d.approach_scale = Frama_C_int_interval(0, 15);
    d.approach_span = Frama_C_int_interval(0, INT32_MAX);
    d.ignored = UNSIGNED();
    d.lost = UNSIGNED();
    d.missed = UNSIGNED();
    d.all = any_sums();
    d.approach = any_sums();
    Frama_C_make_unknown((char *)&d.reversal, sizeof d.reversal);
    d.reversal.started = FLAG();
    d.waiting = any_sample();
    d.believed = any_sample();
    for (unsigned i = 0; i < TL_ONSET_WINDOW; i++) {
        d.window[i] = any_sample();
    }
}

int main(void) {
    tl_onset_defaults();
    begin();
    any_detector();
    const tl_marker_t marker = {
        .arrival_us = TIME(), .u = ANY(), .v = ANY(), .sigma = ANY(), .valid = FLAG(), .other_motion = FLAG()};
    tl_onset_sample(&d, &history, &marker, &onset);
    any_detector();
    tl_onset_poll(&d, &history, TIME(), &onset);
    return 0;
}
