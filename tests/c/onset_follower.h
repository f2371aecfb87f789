/// The rest of the model of the detector: the motor's turns, which frames count, and what is told of a reversal.
#ifndef ONSET_FOLLOWER_H
#define ONSET_FOLLOWER_H

#include "onset_model.h"

static void model_begins(model_t *m, const tl_onset_config_t *config) {
    memset(m, 0, sizeof *m);
    m->config = *config;
    const int64_t noise = (config->noise_px + 8) / 16; // Q8 px
    m->noise_dof = 8;
    m->noise_sum = m->noise_dof * 16 * noise * noise;
}

static int32_t whole(real_t x) { // rounded, saturated
    return x >= 2147483647.0L ? INT32_MAX : (x <= -2147483648.0L ? INT32_MIN : (int32_t)roundl(x));
}

static real_t speed(const model_t *m, int i, int k) { // Q8 counts/s
    const frame_t *a = &m->window[i], *b = &m->window[k];
    return a->t == b->t ? 0 : fabsl((real_t)(b->q - a->q)) * 1e6L / (real_t)(b->t - a->t);
}

static void drop(model_t *m, int n) {
    m->held -= n;
    memmove(m->window, m->window + n, (size_t)m->held * sizeof(frame_t));
}

static void ends(model_t *m, tl_onset_reason_t reason, bool worth, tl_onset_t *out) {
    m->crossing = false;
    m->on_envelope = m->reversal.started;
    m->reversal.reason = (uint8_t)reason;
    if (worth && !m->told) {
        *out = m->reversal;
        m->told = true;
    } else {
        m->missed++;
    }
}

/// How far beyond the turn, along the approach, the image stood.
static void stops(model_t *m, const sums_t *level, real_t unit) {
    meeting_t meeting;
    if (m->entered && m->approach.n >= 3 && level->n >= 2 && meet(&m->approach, level, &meeting)) {
        const real_t of_x = ldexpl(1, m->approach_scale);
        m->reversal.stop = whole(-meeting.x * of_x);
        m->reversal.sigma_stop =
            whole(sqrtl(meeting.variance * square(of_x) * unit + encoder_variance() + bias2(m, m->approach_span)));
    }
}

static void starts(model_t *m, const proof_t *p, tl_onset_t *out) {
    const int first = m->held - p->beyond;
    const int64_t knot = whole(p->knot), q2 = m->reversal.q1 + m->direction * knot;
    const int32_t sigma = whole(sigma_of(m, p));
    const frame_t *after = &m->window[first], *before = &m->window[first > 0 ? first - 1 : 0];
    const real_t gap = fabsl((real_t)(after->q - before->q)), way = gap - fabsl((real_t)(after->q - q2));
    const real_t share = gap > 0 && way > 0 ? way / gap : 0;
    m->slack_us = 1 + (gap > 0 ? (real_t)(after->t - before->t) / gap : 0);
    m->reversal.start_us = (tl_us_t)(before->t + (int64_t)(share * (real_t)(after->t - before->t)));
    m->reversal.started = true;
    m->reversal.noise = whole(sqrtl(p->unit * 16));
    m->reversal.slope = whole(p->slope * 4096);
    m->reversal.speed_start = whole(speed(m, first > 0 ? first - 1 : 0, m->held - 1));
    stops(m, &p->level, p->unit);
    tl_onset_reason_t reason = TL_ONSET_USED;
    if (!m->entered) {
        reason = TL_ONSET_NOT_ON_ENVELOPE;
    } else if ((p->beyond < m->config.frames_min && !p->jumped) || p->level.n < 2) {
        reason = TL_ONSET_TOO_FEW_SAMPLES;
    } else {
        reason = sigma > m->config.sigma_usable ? TL_ONSET_SLOPE_TOO_SMALL : TL_ONSET_USED;
        m->reversal.width = knot > 0 ? (int32_t)knot : 0;
        m->reversal.sigma = sigma;
        m->reversal.q2 = (int32_t)q2;
    }
    remember(m, scatter(&p->level), 2 * (p->level.n - 1), &p->level);
    drop(m, first);
    ends(m, reason, true, out);
}

/// Travel beyond which motion at `slope` would have gained less than `gain`.
static int64_t blind(const model_t *m, real_t slope, real_t gain) {
    const walk_t walk = walk_of(m);
    for (int k = m->held - 2; k >= walk.first; k--) {
        const sums_t b = beyond(m, &walk, k + 1, place(m, &walk, k));
        real_t cxx;
        (void)gain_of(m, &b, &cxx);
        if (square(ldexpl(slope, walk.scale)) * cxx / (real_t)m->all.w >= gain) {
            const int64_t seen = travel(m, k, m->reversal.q1);
            return seen > 0 ? seen : 0;
        }
    }
    return 0;
}

/// The stroke ended without a start; `p` is NULL where no hinge could be fitted.
static void stays(model_t *m, const proof_t *p, tl_onset_t *out) {
    tl_onset_reason_t reason = TL_ONSET_TOO_FEW_SAMPLES;
    if (!m->entered) {
        reason = TL_ONSET_NOT_ON_ENVELOPE;
    } else if (p != NULL && m->reversal.frames >= 2 * m->config.frames_min && m->approach.n >= 3) {
        reason = TL_ONSET_SLOPE_TOO_SMALL;
        meeting_t approach;
        if (meet(&m->approach, &m->all, &approach)) {
            const int64_t seen = blind(m, ldexpl(approach.slope, -m->approach_scale), 2 * p->required);
            if (seen > 0) {
                reason = TL_ONSET_NO_START;
                m->reversal.width = (int32_t)seen;
                stops(m, &m->all, p->unit);
            }
        }
        m->reversal.noise = whole(sqrtl(p->unit * 16));
        remember(m, p->residual, p->dof, &m->all);
    }
    const int64_t stroke = m->direction * (m->extreme - m->reversal.q1);
    ends(m, reason, m->reversal.frames >= m->config.frames_min || stroke / 8 >= m->config.turn, out);
}

static void decides(model_t *m, bool ended, tl_onset_t *out) {
    proof_t p;
    const bool fitted = (ended || near_enough(m)) && evaluate(m, &p);
    if (ended) {
        if (fitted && p.confirmed) {
            starts(m, &p, out);
        } else {
            stays(m, fitted ? &p : NULL, out);
        }
        return;
    }
    const bool before = m->settled;
    m->settled = fitted && p.confirmed && !may_improve(m, &p);
    if (before && m->settled) {
        starts(m, &p, out);
    }
}

/// Whether the motor was slower after frame i, or the turn, than 7/8 of what it was before.
static bool slows(const model_t *m, int i, int before) {
    const frame_t turn = {.t = (int64_t)m->reversal.turn_us, .q = m->reversal.q1};
    const frame_t *next = i + 1 == before ? &turn : &m->window[i + 1], *here = &m->window[i];
    const int64_t us = next->t - here->t;
    return us <= m->config.lost_us &&
           8e6L * fabsl((real_t)(next->q - here->q)) < 7 * roundl(speed(m, i - 1, i)) * (real_t)us;
}

static void approaches(model_t *m, int before) {
    const int64_t q1 = m->reversal.q1;
    m->approach = (sums_t){0};
    int end = before;
    while (end > 4 && slows(m, end - 1, before)) {
        end--;
    }
    int begin = end;
    for (; begin > 0 && end - begin < TL_ONSET_APPROACH; begin--) {
        const frame_t *f = &m->window[begin - 1];
        const bool apart = begin < before && m->window[begin].t - f->t > m->config.lost_us;
        const real_t bias = sqrtl(bias2(m, (real_t)(f->q - q1)));
        if (apart || (end - begin >= 4 && 2 * bias > m->config.sigma_wanted)) {
            break;
        }
    }
    if (begin == end) {
        return;
    }
    m->approach_scale = scale_of(m, begin, q1);
    for (int i = begin; i < end; i++) {
        add(m, &m->approach, i, travel(m, i, q1) / ((int64_t)1 << m->approach_scale));
    }
    m->approach_span = fabsl((real_t)(m->window[begin].q - q1));
    m->reversal.speed_stop = whole(speed(m, begin, end - 1));
}

static bool approach_moved(const model_t *m) {
    const sums_t still = {.n = 1, .w = 1};
    meeting_t line;
    if (m->approach.n < 3 || !meet(&m->approach, &still, &line)) {
        return false;
    }
    const int64_t dof = 2 * m->approach.n - 4;
    const real_t unit = unit_variance(m, fmaxl(scatter(&m->approach) - line.gain, 0), dof);
    return line.gain > required(m, unit, dof);
}

static void turns(model_t *m) {
    m->direction = -m->direction;
    m->crossing = true;
    m->settled = false;
    m->reversal = (tl_onset_t){.turn_us = (tl_us_t)m->extreme_us,
                               .start_us = (tl_us_t)m->extreme_us,
                               .q1 = (int32_t)m->extreme,
                               .q2 = TL_ONSET_UNKNOWN,
                               .width = TL_ONSET_UNKNOWN,
                               .sigma = TL_ONSET_UNKNOWN,
                               .stop = TL_ONSET_UNKNOWN,
                               .sigma_stop = TL_ONSET_UNKNOWN,
                               .direction = (int8_t)m->direction};
    m->slack_us = 0;
    int before = 0, after = 0; // frames up to the turn, and up to when it is surely over
    for (int i = 0; i < m->held; i++) {
        before += m->window[i].t <= m->extreme_us ? 1 : 0;
    }
    after = before;
    while (after < m->held && m->window[after].t < m->extreme_us + m->config.guard_us) {
        after++;
    }
    if (m->held > 0) {
        m->reference_u = m->window[before > 0 ? before - 1 : 0].u;
        m->reference_v = m->window[before > 0 ? before - 1 : 0].v;
    }
    approaches(m, before);
    m->entered = m->on_envelope || approach_moved(m);
    m->on_envelope = false;
    drop(m, after);
    m->reversal.frames = (uint16_t)m->held;
    m->all = (sums_t){0};
    for (int i = 0; i < m->held; i++) {
        add(m, &m->all, i, 0);
    }
}

static void motor_at(model_t *m, int64_t t, int64_t q, tl_onset_t *out) {
    if (m->direction == 0) {
        m->high = !m->placed || q > m->high ? q : m->high;
        m->low = !m->placed || q < m->low ? q : m->low;
        m->placed = true;
        if (m->high - m->low >= m->config.turn) {
            m->direction = q == m->high ? 1 : -1;
            m->extreme = q;
            m->extreme_us = t;
        }
        return;
    }
    const int64_t on = m->direction * (q - m->extreme);
    if (on < 0 && -on < m->config.turn) {
        return;
    }
    if (on < 0) {
        if (m->crossing) {
            decides(m, true, out);
        }
        turns(m);
    }
    m->extreme = q;
    m->extreme_us = t;
}

static void time_is(model_t *m, const tl_history_t *history, int64_t scene_us, tl_onset_t *out) {
    const int64_t span_us = (int64_t)TL_HISTORY_SPAN_MS * 1000;
    m->scanned_us = scene_us - m->scanned_us > span_us ? scene_us - span_us : m->scanned_us;
    for (; m->scanned_us + 1000 <= scene_us; m->scanned_us += 1000) {
        tl_count_q8_t q;
        const tl_history_status_t status = tl_history_at(history, (tl_us_t)m->scanned_us + 1000, &q);
        if (status == TL_HISTORY_NOT_YET) {
            break;
        }
        if (status == TL_HISTORY_OK) {
            motor_at(m, m->scanned_us + 1000, q, out);
        }
    }
    if (!m->crossing) {
        return;
    }
    const int64_t turn_us = (int64_t)m->reversal.turn_us, known_us = m->seen_us > turn_us ? m->seen_us : turn_us;
    if (scene_us > known_us + m->config.lost_us) {
        m->held = m->known = 0;
        ends(m, TL_ONSET_MARKER_LOST, true, out);
    } else if (scene_us > turn_us + m->config.timeout_us) {
        ends(m, TL_ONSET_TIMED_OUT, true, out);
    }
}

/// A frame that counts.
static void counts(model_t *m, const frame_t *f, tl_onset_t *out) {
    if (m->crossing && f->t < (int64_t)m->reversal.turn_us + m->config.guard_us) {
        return;
    }
    if (m->crossing && m->approach.n == 0 && m->all.n == 0) {
        m->reference_u = f->u;
        m->reference_v = f->v;
    }
    if (m->held == TL_ONSET_WINDOW) {
        drop(m, 1);
    }
    m->window[m->held++] = *f;
    m->newest = *f;
    if (!m->crossing) {
        return;
    }
    add(m, &m->all, m->held - 1, 0);
    if (m->all.n >= 2 * TL_ONSET_WINDOW) { // all = (all + window) / 2, rounded down
        for (int i = 0; i < m->held; i++) {
            add(m, &m->all, i, 0);
        }
        m->all = (sums_t){
            .n = m->all.n >> 1, .w = m->all.w >> 1, .u = m->all.u >> 1, .v = m->all.v >> 1, .yy = m->all.yy >> 1};
    }
    m->reversal.frames++;
    decides(m, false, out);
}

/// Squared way from a to the middle of b and c, Q16 px^2.
static int64_t off_middle(const frame_t *a, const frame_t *b, const frame_t *c) {
    const int64_t u = (2 * a->u - b->u - c->u) / 32, v = (2 * a->v - b->v - c->v) / 32;
    return u * u + v * v;
}

static bool elsewhere(const model_t *m, const frame_t *before, const frame_t *f, const frame_t *after) {
    const int64_t off = off_middle(f, before, after), variance = m->noise_sum / (m->noise_dof * f->w);
    return off > 64 * variance && 2 * off > off_middle(after, before, before);
}

static void frame_comes(model_t *m, const frame_t *f, tl_onset_t *out) {
    frame_t judged = m->waiting;
    m->waiting = *f;
    m->seen_us = f->t;
    if (m->known == 0) {
        m->known = 1;
        return;
    }
    bool sure = m->known == 1;
    if (m->known == 3) { // of the doubted one and the one after it the nearer by half is right
        m->lost++;
        sure = 4 * off_middle(&m->believed, &m->newest, f) < off_middle(&judged, &m->newest, f);
        judged = sure ? m->believed : judged;
        m->believed = m->newest;
    }
    const bool doubted = !sure && elsewhere(m, &m->believed, &judged, f);
    m->believed = judged;
    m->known = doubted ? 3 : 2;
    if (!doubted) {
        counts(m, &judged, out);
    }
}

static bool model_sees(model_t *m, const tl_history_t *history, const tl_marker_t *marker, tl_onset_t *out) {
    m->told = false;
    if ((int64_t)marker->arrival_us <= m->arrival_us) {
        m->ignored++;
        return false;
    }
    m->arrival_us = (int64_t)marker->arrival_us;
    const int64_t scene_us = m->arrival_us - m->config.delay_us;
    if (scene_us < 0) {
        m->lost++;
        return false;
    }
    time_is(m, history, scene_us, out);
    if (marker->other_motion) {
        m->held = m->known = 0;
        m->on_envelope = false;
        if (m->crossing) {
            ends(m, TL_ONSET_OTHER_MOTION, true, out);
        }
        return m->told;
    }
    tl_count_q8_t q;
    if (!marker->valid || tl_history_at(history, (tl_us_t)scene_us, &q) != TL_HISTORY_OK) {
        m->lost++;
        return m->told;
    }
    const real_t ratio = marker->sigma > 0 ? square((real_t)m->config.noise_px / marker->sigma) : 1;
    const int64_t weight = (int64_t)fminl(fmaxl(roundl(16 * ratio), 1), 64);
    const frame_t f = {.t = scene_us, .q = q, .u = marker->u, .v = marker->v, .w = weight};
    frame_comes(m, &f, out);
    return m->told;
}

static bool model_polls(model_t *m, const tl_history_t *history, tl_us_t now_us, tl_onset_t *out) {
    const int64_t scene_us = (int64_t)now_us - m->config.delay_us - 60000;
    m->told = false;
    if (scene_us >= 0) {
        time_is(m, history, scene_us, out);
    }
    return m->told;
}

#endif
