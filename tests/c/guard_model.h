/// What an axis notices by itself, written again from tl_axis_guard.h, tl_axis_rest.h and docs/safety.md: one
/// millisecond of it. Numbers that are nobody's promise (how long a dip of the supply may be) stand here once more.
#ifndef GUARD_MODEL_H
#define GUARD_MODEL_H

#include "tautline/tl_axis_guard.h"

#include <stdlib.h>

typedef struct {
    int mode, fault, events, fault_value;
    bool referenced, checked, commissioned, silent, lapsed, blind, homing, homed, rests;
    int mean, seen_q, seen_duty, unseen, still_q, pushed_ms, swing, swing_way, supply_ms, driver_ms, still_ms, off_ms;
    int limit, sink, q, target, error;
    unsigned patience, alone;
    struct {
        int way, phase, ms, duty, most, from, mark, least, far, speed, reach, end, retreat;
        bool moved, right_scale;
    } trial;
} guard_model_t;

/// What there is to be measured.
typedef struct {
    int duty, pushed, current_ma, supply_mv, speed;
    bool driver_fault, sees, path_rests, there;
} guard_input_t;

enum { RAMP, RUN, TIME, REST }; // of a check

static int saturating(int ms, bool is) {
    return is ? (ms < 255 ? ms + 1 : 255) : 0;
}

static bool is_closed(const guard_model_t *m) {
    return m->mode != TL_WIRE_MODE_OFF && m->mode != TL_WIRE_MODE_CHECK;
}

static bool follows(const guard_model_t *m) {
    return m->mode == TL_WIRE_MODE_FOLLOW_MOTOR || m->mode == TL_WIRE_MODE_FOLLOW_TIP;
}

static void happens(guard_model_t *m, int event) {
    m->events |= 1 << event;
}

static bool model_fails(guard_model_t *m, bool bad, int fault, int value) {
    if (!bad) {
        return false;
    }
    const bool of_encoder = fault == TL_WIRE_FAULT_ENCODER || fault == TL_WIRE_FAULT_EDGES ||
                            fault == TL_WIRE_FAULT_REVERSED || fault == TL_WIRE_FAULT_SCALE ||
                            fault == TL_WIRE_FAULT_UNMOVED;
    const bool of_motion =
        fault == TL_WIRE_FAULT_FOLLOWING || fault == TL_WIRE_FAULT_CURRENT || fault == TL_WIRE_FAULT_STALL;
    const bool of_wiring = of_encoder || of_motion || fault == TL_WIRE_FAULT_DRIVER || fault == TL_WIRE_FAULT_SUPPLY;
    m->referenced = m->referenced && !m->blind && !of_encoder && !(of_motion && m->unseen >= 5);
    m->checked = m->checked && !of_wiring;
    m->mode = TL_WIRE_MODE_OFF;
    m->blind = m->lapsed = false;
    m->trial.duty = 0;
    if (m->fault == TL_WIRE_FAULT_NONE) {
        m->fault = fault;
        m->fault_value = value;
        happens(m, TL_WIRE_EVENT_FAULT);
    }
    return true;
}

static void feels(guard_model_t *m, const tl_axis_t *axis, const guard_input_t *in) {
    const int chops = axis->port->driver_ma * 15 / 16;
    bool pushes = in->pushed != 0 || (chops > 0 && abs(in->current_ma) >= chops), dark = false;
    if (m->q != m->seen_q) {
        m->seen_q = m->q;
        m->seen_duty = in->duty;
        m->unseen = 0;
    } else if (m->unseen < 20) { // it may brake
        m->seen_duty += (in->duty - m->seen_duty) / 8;
        m->unseen++;
    } else {
        const int beyond = abs(in->duty - m->seen_duty) - 2 * axis->motor.servo.gains.friction;
        pushes = pushes || beyond > 2 * 2621; // 8 % either way
        dark = pushes || beyond > 1311;       // 4 % both ways
    }
    m->blind = dark;
    m->pushed_ms += pushes ? 1 : -1;
    if (m->pushed_ms < 0 || abs(m->q - m->still_q) > 8 * 256) {
        m->still_q = m->q;
        m->pushed_ms = 0;
    }
}

// Each change from limit to limit is 160, forgotten by 4 a millisecond, by 1 where the path rests.
static bool swings(guard_model_t *m, const guard_input_t *in) {
    const int less = in->path_rests ? 1 : 4;
    m->swing = m->swing > less ? m->swing - less : 0;
    if (in->pushed == 3 || (in->pushed != 0 && in->pushed != m->swing_way)) {
        m->swing += m->swing_way != 0 ? 160 : 0;
        m->swing_way = in->pushed;
    }
    return m->swing >= 1600;
}

static bool lets_go(guard_model_t *m, const tl_axis_t *axis, const guard_input_t *in) {
    if (m->sink == 0) {
        const unsigned most = axis->settings.hold_ms;
        if (m->alone != TL_AXIS_LET_GO) {
            m->alone += most != 0U ? 1U : 0U;
            if (most == 0U || m->alone < most) {
                return false;
            }
        }
        m->limit = abs(in->duty);
        m->sink = m->limit / 1024 + 1;
        m->silent = true;
        happens(m, TL_WIRE_EVENT_SILENT);
    }
    m->limit -= m->sink;
    model_fails(m, m->limit <= 0, TL_WIRE_FAULT_HOST_LOST, 0);
    return true;
}

static void arrives(guard_model_t *m, const tl_axis_t *axis, const guard_input_t *in) {
    m->still_ms = saturating(m->still_ms, in->there && abs(m->q - m->target) <= axis->settings.arrive_q8);
    if (m->still_ms >= 10) {
        m->mode = TL_WIRE_MODE_HOLD;
        happens(m, m->homing ? TL_WIRE_EVENT_HOMED : TL_WIRE_EVENT_ARRIVED);
        m->homing = false;
    }
}

static void homes(guard_model_t *m, const tl_axis_t *axis) {
    const int gone = (m->q - m->trial.from) * m->trial.way;
    if (model_fails(m, gone > m->trial.reach, TL_WIRE_FAULT_NO_END, gone / 256)) {
        return;
    }
    if (m->pushed_ms < 100) {
        m->target = m->q + m->trial.way * (axis->limits.following_error_q8 / 2);
        return;
    }
    const int end = m->trial.end, low = axis->limits.q_low_q8, high = axis->limits.q_high_q8;
    const int back = end - m->trial.way * m->trial.retreat;
    m->q = m->still_q = end; // outside of its limits it may stay
    m->target = tl_clamp(back, end < low ? end : low, end > high ? end : high);
    m->pushed_ms = 0;
    m->referenced = m->homing = m->homed = true;
    m->mode = TL_WIRE_MODE_MOVE;
}

static void enters(guard_model_t *m, int phase) {
    m->trial.phase = phase;
    m->trial.ms = 0;
    m->trial.mark = m->q;
    m->trial.from = phase == RAMP ? m->q : m->trial.from;
    m->trial.duty = phase == REST ? 0 : m->trial.duty;
}

static void checks(guard_model_t *m) {
    const int way = m->trial.way * (m->q - m->trial.from), timed = m->trial.way * (m->q - m->trial.mark);
    m->trial.ms++;
    if (model_fails(m, m->trial.phase != REST && way < -6 * 256, TL_WIRE_FAULT_REVERSED, way / 256)) {
        return;
    }
    if (m->trial.phase == RAMP) {
        m->trial.duty = m->trial.way * (m->trial.most * m->trial.ms / 64);
        if (m->trial.ms == 64) {
            enters(m, RUN);
        }
    } else if (m->trial.phase == RUN) {
        if (way > 6 * 256 && m->trial.ms >= 24) {
            m->trial.moved = true;
            enters(m, TIME);
        } else if (m->trial.ms >= 400) {
            enters(m, REST);
        }
    } else if (m->trial.phase == TIME && m->trial.ms == 32) {
        m->trial.speed = timed / 256 * (1000 / 32);
        m->trial.right_scale |= m->trial.far == 0 || (timed >= m->trial.least && timed <= m->trial.far);
        enters(m, REST);
    } else if (m->trial.phase == REST && m->trial.ms == 100 && m->trial.way > 0) {
        m->trial.way = -1;
        enters(m, RAMP);
    } else if (m->trial.phase == REST && m->trial.ms == 100) {
        if (!model_fails(m, !m->trial.moved, TL_WIRE_FAULT_UNMOVED, 0) &&
            !model_fails(m, !m->trial.right_scale, TL_WIRE_FAULT_SCALE, m->trial.speed)) {
            m->checked = true;
            m->mode = TL_WIRE_MODE_HOLD;
            happens(m, TL_WIRE_EVENT_CHECKED);
        }
    }
}

/// Whether nobody has been heard of for too long: this millisecond is over then.
static bool hears_nobody(guard_model_t *m) {
    const bool sender = follows(m);
    if ((!sender && m->mode != TL_WIRE_MODE_MOVE && m->mode != TL_WIRE_MODE_HOME) || --m->patience != 0U) {
        return false;
    }
    m->mode = sender ? TL_WIRE_MODE_STOPPING : TL_WIRE_MODE_STOPPING_OFF;
    m->silent = true;
    m->lapsed = !sender;
    happens(m, TL_WIRE_EVENT_SILENT);
    return true;
}

/// Driven: what is electrical comes first, then what the motor does.
static void is_watched(guard_model_t *m, const tl_axis_t *axis, const guard_input_t *in) {
    const int most_ma = axis->limits.current_ma;
    if (model_fails(m, m->driver_ms >= 5, TL_WIRE_FAULT_DRIVER, 0) ||
        model_fails(m, m->supply_ms >= 20, TL_WIRE_FAULT_SUPPLY, in->supply_mv) ||
        model_fails(m, most_ma > 0 && m->mean > most_ma * 256, TL_WIRE_FAULT_CURRENT, m->mean / 256) ||
        m->mode == TL_WIRE_MODE_CHECK || (m->mode == TL_WIRE_MODE_HOLD && lets_go(m, axis, in))) {
        return;
    }
    feels(m, axis, in);
    if (model_fails(m, abs(m->error) > axis->limits.following_error_q8, TL_WIRE_FAULT_FOLLOWING, m->error / 256) ||
        model_fails(m, m->mode != TL_WIRE_MODE_HOME && m->pushed_ms >= axis->settings.stall_ms, TL_WIRE_FAULT_STALL,
                    in->duty)) {
        return;
    }
    model_fails(m, swings(m, in), TL_WIRE_FAULT_OSCILLATION, 0);
}

static void guard_model_ms(guard_model_t *m, const tl_axis_t *axis, const guard_input_t *in) {
    const int size = in->current_ma < -100000 || in->current_ma > 100000 ? 100000 : abs(in->current_ma);
    const int change = tl_clamp(size * 256 - m->mean, -(1 << 20), 1 << 20) * (32768 / 20);
    m->mean += change >= 0 ? change / 32768 : -((32767 - change) / 32768); // over 20 ms, rounded down
    m->supply_ms = saturating(m->supply_ms, in->supply_mv < axis->settings.supply_low_mv);
    m->driver_ms = saturating(m->driver_ms, in->driver_fault);
    const bool off = m->mode == TL_WIRE_MODE_OFF;
    m->off_ms = saturating(m->off_ms, off);
    if (!in->sees && m->commissioned &&
        (off ? m->off_ms < 150 : is_closed(m) && m->mode != TL_WIRE_MODE_HOME && m->sink == 0 && m->swing == 0)) {
        m->blind = true;
        model_fails(m, true, off ? TL_WIRE_FAULT_EDGES : TL_WIRE_FAULT_STALL, off ? in->speed : in->duty);
        return;
    }
    if (hears_nobody(m)) {
        return;
    }
    if (m->mode != TL_WIRE_MODE_OFF) {
        is_watched(m, axis, in);
    }
    if (m->mode == TL_WIRE_MODE_MOVE) {
        arrives(m, axis, in);
    } else if (m->mode == TL_WIRE_MODE_HOME) {
        homes(m, axis);
    } else if (m->mode == TL_WIRE_MODE_CHECK) {
        checks(m);
    } else if (m->mode == TL_WIRE_MODE_OFF) {
        model_fails(m, m->lapsed, TL_WIRE_FAULT_HOST_LOST, 0);
    }
}

#endif
