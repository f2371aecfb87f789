#include "tautline/tl_onset.h"

#include "tautline/tl_fast.h"

#include <string.h>

#include "tl_confirm.h"

#define LEVEL_MIN    2      ///< fewest frames on the level
#define OUTLIER      8      ///< see is_outlier()
#define POLL_LAG_US  60000U ///< frames this late still find their turn unscanned
#define JITTER_TURNS 8      ///< hardly seen strokes shorter than this many turn thresholds are no reversals

enum { FOLLOWING, CROSSING }; // phase: no reversal under way, or one
enum { DOUBTED = 3 };         // known: `believed` holds a frame that may be an outlier

tl_onset_config_t tl_onset_defaults(void) {
    return (tl_onset_config_t){
        .delay_us = 80000,
        .guard_us = 20000,
        .lost_us = 400000,
        .timeout_us = 30000000,
        .turn = 4 * TL_COUNT_ONE,
        .sigma_wanted = 3 * TL_COUNT_ONE / 2,
        .sigma_usable = 25 * TL_COUNT_ONE,
        .noise_px = TL_PX_ONE / 10,
        .curvature = 400,
        .threshold = 24 * 16,
        .frames_min = 4,
        .frames_max = 32,
    };
}

bool tl_onset_init(tl_onset_detector_t *detector, const tl_onset_config_t *config) {
    memset(detector, 0, sizeof *detector);
    const bool valid = config->delay_us <= 400000 && config->guard_us <= 400000 && config->timeout_us > 0 &&
                       config->timeout_us <= 600000000 && config->lost_us > 0 && config->lost_us <= 10000000 &&
                       config->turn > 0 && config->sigma_wanted > 0 && config->sigma_usable >= config->sigma_wanted &&
                       config->noise_px > 0 && config->noise_px <= 8 * TL_PX_ONE && config->curvature < 1U << 20 &&
                       config->threshold > 0 && config->frames_min >= 3 && config->frames_max >= config->frames_min &&
                       config->frames_max < TL_ONSET_WINDOW - 1;
    if (!valid) {
        return false;
    }
    detector->config = *config;
    tl_confirm_begin(detector);
    return true;
}

static TL_FAST void drop_oldest(tl_onset_detector_t *d, int32_t n) {
    d->oldest = (uint8_t)(((uint32_t)d->oldest + (uint32_t)n) % TL_ONSET_WINDOW);
    d->held = (uint8_t)(d->held - n);
}

/// |a - b|, saturated. Out of line: it is asked for in many places.
static __attribute__((noinline)) TL_FAST tl_count_q8_t distance(tl_count_q8_t a, tl_count_q8_t b) {
    return tl_abs_sat(tl_sub_sat(a, b));
}

/// Q8 counts/s over samples i to k.
static TL_FAST int32_t speed_between(tl_onset_detector_t *d, int32_t i, int32_t k) {
    const uint32_t us = tl_hinge_sample(d, k)->t_us - tl_hinge_sample(d, i)->t_us;
    const tl_count_q8_t way = distance(tl_hinge_sample(d, k)->q, tl_hinge_sample(d, i)->q);
    return us == 0 ? 0 : tl_real_to_q(tl_real_div(tl_real((int64_t)way * 1000000, 0), tl_real(us, 0)), 0);
}

static TL_FAST void measure_stop(tl_onset_detector_t *d, const tl_onset_sums_t *level, tl_real_t unit) {
    tl_hinge_meeting_t meeting;
    if (!d->entered || d->approach.n < 3 || level->n < LEVEL_MIN ||
        !tl_hinge_meet(&d->approach, level, d->approach_scale, &meeting)) {
        return;
    }
    const tl_real_t variance =
        tl_confirm_knot_variance(&d->config, meeting.variance, unit, tl_real(d->approach_span, 0));
    d->reversal.stop = tl_real_to_q(tl_real_sub(0, meeting.x), 0);
    d->reversal.sigma_stop = tl_confirm_sigma(variance);
}

/// The reversal under way is over, and told if it is worth it; the tip follows the motor or not, as far as is
/// known.
static TL_FAST void end_reversal(tl_onset_detector_t *d, tl_onset_reason_t reason, bool worth, tl_onset_t *onset) {
    d->phase = FOLLOWING;
    d->on_envelope = d->reversal.started;
    d->reversal.reason = (uint8_t)reason;
    if (worth && !d->told) {
        *onset = d->reversal;
        d->told = true;
    } else {
        d->missed++;
    }
}

static TL_FAST void clear_window(tl_onset_detector_t *d) {
    d->held = 0;
    d->known = 0;
}

/// The image has started: writes the onset and goes on following with the samples beyond the knot.
static TL_FAST void finish_started(tl_onset_detector_t *d, const tl_confirm_t *e, tl_onset_t *onset) {
    const tl_onset_config_t *config = &d->config;
    tl_onset_t *r = &d->reversal;
    const int32_t first = d->held - e->hinge.beyond; // a knot has a sample before it
    const int32_t knot = tl_real_to_q(e->hinge.knot, 0);
    const int32_t sigma = tl_confirm_sigma(tl_confirm_variance(d, e));
    const tl_count_q8_t q2 = r->direction > 0 ? tl_add_sat(r->q1, knot) : tl_sub_sat(r->q1, knot);

    // Time of the knot, linear between the frames around it.
    const tl_onset_sample_t *after = tl_hinge_sample(d, first);
    const tl_onset_sample_t *before = tl_hinge_sample(d, first - 1);
    const int64_t gap = distance(after->q, before->q);
    const int64_t way = gap - distance(after->q, q2);
    const uint32_t gap_us = after->t_us - before->t_us;
    const uint32_t way_us = gap > 0 && way > 0 ? (uint32_t)((int64_t)gap_us * way / gap) : 0;
    r->start_us = d->seen_us - ((uint32_t)d->seen_us - before->t_us - way_us);
    r->started = true;

    r->noise = tl_confirm_noise(e->unit);
    r->slope = tl_real_to_q(e->hinge.slope, 12);
    r->speed_start = speed_between(d, first - 1, d->held - 1);
    measure_stop(d, &e->hinge.level, e->unit);

    tl_onset_reason_t reason = TL_ONSET_USED;
    if (!d->entered) {
        reason = TL_ONSET_NOT_ON_ENVELOPE;
    } else if ((e->hinge.beyond < config->frames_min && !e->jumped) || e->hinge.level.n < LEVEL_MIN) {
        reason = TL_ONSET_TOO_FEW_SAMPLES;
    } else {
        reason = sigma > config->sigma_usable ? TL_ONSET_SLOPE_TOO_SMALL : TL_ONSET_USED;
        r->width = knot > 0 ? knot : 0;
        r->sigma = sigma;
        r->q2 = q2;
    }
    tl_confirm_remember(d, tl_hinge_scatter(&e->hinge.level), 2 * (e->hinge.level.n - 1));
    drop_oldest(d, first);
    end_reversal(d, reason, true, onset);
}

/// The stroke ended and the image had not (yet) moved.
static TL_FAST void finish_unstarted(tl_onset_detector_t *d, const tl_confirm_t *e, tl_onset_t *onset) {
    tl_onset_reason_t reason = TL_ONSET_TOO_FEW_SAMPLES;
    tl_hinge_meeting_t approach;
    if (!d->entered) {
        reason = TL_ONSET_NOT_ON_ENVELOPE;
    } else if (e != NULL && d->reversal.frames >= 2U * d->config.frames_min && d->approach.n >= 3) {
        reason = TL_ONSET_SLOPE_TOO_SMALL;
        if (tl_hinge_meet(&d->approach, &d->all, d->approach_scale, &approach)) {
            // Twice the gain that confirms is confirmed with a probability of 0.98.
            const tl_real_t seen = tl_hinge_blind(d, approach.slope, tl_real_shift(e->required, 1));
            if (seen > 0) {
                reason = TL_ONSET_NO_START;
                d->reversal.width = tl_real_to_q(seen, 0);
                measure_stop(d, &d->all, e->unit);
            }
        }
        d->reversal.noise = tl_confirm_noise(e->unit);
        tl_confirm_remember(d, e->hinge.residual, e->dof);
    }
    const tl_count_q8_t stroke = distance(d->extreme, d->reversal.q1);
    const bool worth = d->reversal.frames >= d->config.frames_min || stroke / JITTER_TURNS >= d->config.turn;
    end_reversal(d, reason, worth, onset);
}

/// Decides what the frames so far prove, and must if the stroke has ended.
static TL_FAST void decide(tl_onset_detector_t *d, bool ended, tl_onset_t *onset) {
    tl_confirm_t e;
    const bool fitted = (ended || tl_confirm_glance(d)) && tl_confirm_evaluate(d, &e);
    const bool confirmed = fitted && e.confirmed;
    if (ended && !confirmed) {
        finish_unstarted(d, fitted ? &e : NULL, onset);
        return;
    }
    // Twice in a row: a finish on the first chance would prefer those whose knot noise has moved forward.
    const bool before = d->settled;
    d->settled = confirmed && !tl_confirm_may_improve(d, &e);
    if (ended || (before && d->settled)) {
        finish_started(d, &e, onset);
    }
}

/// Whether the motor lost an eighth of its speed at sample i; the turn follows on the last one before it.
static TL_FAST bool slows_down(tl_onset_detector_t *d, int32_t i, int32_t before) {
    const bool last = i + 1 == before;
    const tl_count_q8_t q = last ? d->reversal.q1 : tl_hinge_sample(d, i + 1)->q;
    const uint32_t us =
        (last ? (uint32_t)d->reversal.turn_us : tl_hinge_sample(d, i + 1)->t_us) - tl_hinge_sample(d, i)->t_us;
    const int64_t way = distance(q, tl_hinge_sample(d, i)->q);
    return us <= d->config.lost_us && way * 8000000 < (int64_t)speed_between(d, i - 1, i) * us * 7;
}

/// The line of the approach, from the samples up to the turn: as many as curvature allows, without those that
/// saw the motor slow down (a wrong t_delay shifts them less than the others).
static TL_FAST void measure_approach(tl_onset_detector_t *d, int32_t before) {
    const tl_onset_config_t *config = &d->config;
    const tl_count_q8_t q1 = d->reversal.q1;
    memset(&d->approach, 0, sizeof d->approach);
    int32_t end = before; // one past the newest sample that is taken
    while (end > 4 && slows_down(d, end - 1, before)) {
        end--;
    }
    int32_t begin = end;
    const tl_real_t wanted2 = tl_real_square(tl_real(config->sigma_wanted, -1));
    while (begin > 0 && end - begin < TL_ONSET_APPROACH) {
        const tl_onset_sample_t *s = tl_hinge_sample(d, begin - 1);
        const tl_real_t span = tl_real((int64_t)distance(s->q, q1), 0);
        const bool apart = begin < before && tl_hinge_sample(d, begin)->t_us - s->t_us > config->lost_us;
        if (apart || (end - begin >= 4 && tl_real_less(wanted2, tl_confirm_curvature_bias2(config, span)))) {
            break;
        }
        begin--;
    }
    if (begin == end) {
        return;
    }
    d->approach_scale = tl_hinge_scale(d, begin, q1);
    for (int32_t i = begin; i < end; i++) {
        const tl_hinge_point_t point = tl_hinge_point(d, i, q1, d->approach_scale);
        tl_hinge_add(&d->approach, &point);
    }
    d->approach_span = distance(tl_hinge_sample(d, begin)->q, q1);
    d->reversal.speed_stop = speed_between(d, begin, end - 1);
}

/// Whether the image moved on the approach beyond noise.
static TL_FAST bool approach_moves(const tl_onset_detector_t *d) {
    tl_hinge_meeting_t meeting;
    const tl_onset_sums_t any_level = {.w = 1, .n = 1};
    if (d->approach.n < 3 || !tl_hinge_meet(&d->approach, &any_level, d->approach_scale, &meeting)) {
        return false;
    }
    const int32_t dof = 2 * d->approach.n - 4;
    tl_real_t residual = tl_real_sub(tl_hinge_scatter(&d->approach), meeting.gain);
    residual = residual > 0 ? residual : tl_real(0, 0);
    const tl_real_t unit = tl_confirm_unit_variance(d, residual, dof);
    return tl_real_less(tl_confirm_required(d, unit, dof), meeting.gain);
}

/// Samples from the i-th on.
static TL_FAST void add_images(tl_onset_detector_t *d, int32_t i) {
    for (; i < d->held; i++) {
        const tl_hinge_point_t point = tl_hinge_image(d, i);
        tl_hinge_add(&d->all, &point);
    }
}

static TL_FAST void begin_reversal(tl_onset_detector_t *d, int8_t direction) {
    const uint32_t turn_us = (uint32_t)d->extreme_us;
    d->direction = direction;
    d->phase = CROSSING;
    d->settled = false;
    d->reversal = (tl_onset_t){
        .turn_us = d->extreme_us,
        .start_us = d->extreme_us,
        .q1 = d->extreme,
        .q2 = TL_ONSET_UNKNOWN,
        .width = TL_ONSET_UNKNOWN,
        .sigma = TL_ONSET_UNKNOWN,
        .stop = TL_ONSET_UNKNOWN,
        .sigma_stop = TL_ONSET_UNKNOWN,
        .direction = direction,
    };
    int32_t before = d->held;
    while (before > 0 && (int32_t)(tl_hinge_sample(d, before - 1)->t_us - turn_us) > 0) {
        before--;
    }
    int32_t after = before;
    while (after < d->held && (int32_t)(tl_hinge_sample(d, after)->t_us - turn_us) < (int32_t)d->config.guard_us) {
        after++;
    }
    if (d->held > 0) {
        const tl_onset_sample_t *s = tl_hinge_sample(d, before > 0 ? before - 1 : 0);
        d->reference_u = s->u;
        d->reference_v = s->v;
    }
    measure_approach(d, before);
    d->entered = d->on_envelope || approach_moves(d);
    d->on_envelope = false;
    drop_oldest(d, after);
    d->reversal.frames = d->held;
    memset(&d->all, 0, sizeof d->all);
    add_images(d, 0);
}

/// Follows the motor to `q`.
static TL_FAST void follow_motor(tl_onset_detector_t *d, tl_us_t t_us, tl_count_q8_t q, tl_onset_t *onset) {
    const tl_count_q8_t turn = d->config.turn;
    if (d->direction == 0) {
        if (!d->placed) {
            d->extreme = q;
            d->opposite = q;
            d->placed = true;
        }
        d->extreme = q > d->extreme ? q : d->extreme;
        d->opposite = q < d->opposite ? q : d->opposite;
        if (tl_sub_sat(d->extreme, d->opposite) >= turn) {
            d->direction = q == d->extreme ? 1 : -1;
            d->extreme = q;
            d->extreme_us = t_us;
        }
        return;
    }
    const tl_count_q8_t retreat = d->direction > 0 ? tl_sub_sat(d->extreme, q) : tl_sub_sat(q, d->extreme);
    if (retreat <= 0) {
        d->extreme = q;
        d->extreme_us = t_us;
        return;
    }
    if (retreat < turn) {
        return;
    }
    if (d->phase == CROSSING) {
        decide(d, true, onset);
    }
    begin_reversal(d, (int8_t)-d->direction);
    d->extreme = q;
    d->extreme_us = t_us;
}

/// Follows the motor through the history up to `until_us`.
static TL_FAST void scan(tl_onset_detector_t *d, const tl_history_t *history, tl_us_t until_us, tl_onset_t *onset) {
    const tl_us_t span_us = TL_HISTORY_SPAN_MS * 1000U;
    if (until_us > d->scanned_us + span_us) {
        d->scanned_us = until_us - span_us;
    }
    while (d->scanned_us + TL_HISTORY_STEP_US <= until_us) {
        const tl_us_t t_us = d->scanned_us + TL_HISTORY_STEP_US;
        tl_count_q8_t q;
        const tl_history_status_t status = tl_history_at(history, t_us, &q);
        if (status == TL_HISTORY_NOT_YET) {
            break;
        }
        if (status == TL_HISTORY_OK) {
            follow_motor(d, t_us, q, onset);
        }
        d->scanned_us = t_us;
    }
}

/// The marker was away, or the crossing lasts, for too long.
static TL_FAST void check_time(tl_onset_detector_t *d, tl_us_t scene_us, tl_onset_t *onset) {
    if (d->phase != CROSSING) {
        return;
    }
    const tl_us_t known_us = d->seen_us > d->reversal.turn_us ? d->seen_us : d->reversal.turn_us;
    if (scene_us > known_us + d->config.lost_us) {
        clear_window(d);
        end_reversal(d, TL_ONSET_MARKER_LOST, true, onset);
    } else if (scene_us > d->reversal.turn_us + d->config.timeout_us) {
        end_reversal(d, TL_ONSET_TIMED_OUT, true, onset);
    }
}

static TL_FAST int32_t weight_of(const tl_onset_config_t *config, tl_px_q12_t sigma) {
    if (sigma <= 0) {
        return TL_CONFIRM_WEIGHT;
    }
    const int64_t noise2 = (int64_t)config->noise_px * config->noise_px;
    const int64_t sigma2 = (int64_t)sigma * sigma;
    const int64_t weight = (TL_CONFIRM_WEIGHT * noise2 + sigma2 / 2) / sigma2;
    return weight < 1 ? 1 : (weight > 64 ? 64 : (int32_t)weight);
}

/// Halves what has left the window, all - window: all becomes (all + window) / 2. The sums of a long level
/// stay within their range, and a level that creeps is followed.
static TL_FAST void fade(tl_onset_detector_t *d) {
    add_images(d, 0);
    d->all.w >>= 1;
    d->all.u >>= 1;
    d->all.v >>= 1;
    d->all.yy >>= 1;
    d->all.n >>= 1;
}

static TL_FAST void take(tl_onset_detector_t *d, const tl_onset_sample_t *sample) {
    if (d->held == TL_ONSET_WINDOW) {
        drop_oldest(d, 1);
    }
    d->window[((uint32_t)d->oldest + d->held) % TL_ONSET_WINDOW] = *sample;
    d->held++;
}

/// A sample that its neighbours vouch for.
static TL_FAST void take_sample(tl_onset_detector_t *d, const tl_onset_sample_t *sample, tl_us_t scene_us,
                                tl_onset_t *onset) {
    if (d->phase == FOLLOWING) {
        take(d, sample);
        return;
    }
    if (scene_us < d->reversal.turn_us + d->config.guard_us) {
        return;
    }
    if (d->approach.n == 0 && d->all.n == 0) {
        d->reference_u = sample->u;
        d->reference_v = sample->v;
    }
    take(d, sample);
    add_images(d, d->held - 1);
    if (d->all.n >= 2 * TL_ONSET_WINDOW) {
        fade(d);
    }
    if (d->reversal.frames < UINT16_MAX) {
        d->reversal.frames++;
    }
    decide(d, false, onset);
}

/// Of a from the middle between b and c, Q16 px^2. Out of line: its 64-bit products are a lot of code.
static __attribute__((noinline)) TL_FAST int64_t squared_distance(const tl_onset_sample_t *a,
                                                                  const tl_onset_sample_t *b,
                                                                  const tl_onset_sample_t *c) {
    const int64_t u = (2 * (int64_t)a->u - b->u - c->u) / 32, v = (2 * (int64_t)a->v - b->v - c->v) / 32;
    return u * u + v * v;
}

/// Whether the image was elsewhere for one frame: off the middle of its neighbours by more than OUTLIER sigma, and
/// by more than 0.7 of what lies between them: a start or a jump between them puts it off by half at most, whenever
/// the frames came. All within +-4096 px.
static TL_FAST bool is_outlier(const tl_onset_detector_t *d, const tl_onset_sample_t *before,
                               const tl_onset_sample_t *sample, const tl_onset_sample_t *after) {
    const int64_t off = squared_distance(sample, before, after), apart = squared_distance(after, before, before);
    const int64_t variance = d->noise_sum / ((int64_t)d->noise_dof * sample->weight);
    return off > OUTLIER * OUTLIER * variance && 2 * off > apart;
}

/// A frame with its marker waits for the next one, which tells whether to believe it. A frame that the next one makes
/// an outlier may be right and that one wrong: it stands in `believed` until a third came. Right is then what lies
/// nearer to the middle of the third and the last that was believed (the window's newest, dropped or not) by half.
static TL_FAST void take_frame(tl_onset_detector_t *d, const tl_onset_sample_t *sample, tl_us_t scene_us,
                               tl_onset_t *onset) {
    tl_onset_sample_t waiting = d->waiting;
    tl_us_t waiting_us = d->seen_us;
    bool cleared = false;
    d->waiting = *sample;
    d->seen_us = scene_us;
    if (d->known == DOUBTED) {
        const tl_onset_sample_t *before = tl_hinge_sample(d, d->held - 1);
        cleared = 4 * squared_distance(&d->believed, before, sample) < squared_distance(&waiting, before, sample);
        if (cleared) {
            waiting = d->believed;
            waiting_us -= (uint32_t)waiting_us - waiting.t_us;
        } else {
            d->believed = *before;
        }
        d->known = 2;
        d->lost++;
    }
    if (d->known > 1 && !cleared && is_outlier(d, &d->believed, &waiting, sample)) {
        d->believed = waiting;
        d->known = DOUBTED;
        return;
    }
    if (d->known > 0) {
        d->believed = waiting;
        take_sample(d, &waiting, waiting_us, onset);
    }
    d->known = d->known == 0 ? 1 : 2;
}

TL_FAST bool tl_onset_sample(tl_onset_detector_t *detector, const tl_history_t *history, const tl_marker_t *marker,
                             tl_onset_t *onset) {
    tl_onset_detector_t *d = detector;
    d->told = false;
    if (marker->arrival_us <= d->arrival_us) {
        d->ignored++;
        return false;
    }
    d->arrival_us = marker->arrival_us;
    if (marker->arrival_us < d->config.delay_us) {
        d->lost++;
        return false;
    }
    const tl_us_t scene_us = marker->arrival_us - d->config.delay_us;
    scan(d, history, scene_us, onset);
    check_time(d, scene_us, onset);
    if (marker->other_motion) {
        clear_window(d);
        d->on_envelope = false;
        if (d->phase == CROSSING) {
            end_reversal(d, TL_ONSET_OTHER_MOTION, true, onset);
        }
        return d->told;
    }
    tl_onset_sample_t sample = {0, marker->u, marker->v, (uint32_t)scene_us, weight_of(&d->config, marker->sigma)};
    if (marker->valid && tl_history_at(history, scene_us, &sample.q) == TL_HISTORY_OK) {
        take_frame(d, &sample, scene_us, onset);
    } else {
        d->lost++;
    }
    return d->told;
}

TL_FAST bool tl_onset_poll(tl_onset_detector_t *detector, const tl_history_t *history, tl_us_t now_us,
                           tl_onset_t *onset) {
    tl_onset_detector_t *d = detector;
    d->told = false;
    if (now_us < (tl_us_t)d->config.delay_us + POLL_LAG_US) {
        return false;
    }
    const tl_us_t scene_us = now_us - d->config.delay_us - POLL_LAG_US;
    scan(d, history, scene_us, onset);
    check_time(d, scene_us, onset);
    return d->told;
}
