#include "tautline/tl_motion.h"

#include "tautline/tl_fast.h"

#include <string.h>

#define POSITION_MAX ((int32_t)1 << 30) ///< Q8: 4 M counts
#define SPEED_MIN    (TL_COUNT_ONE / 4)
#define SPEED_MAX    ((int64_t)100 << 32)
#define STEPS_MAX    ((int64_t)1 << 20)
#define RESOLUTION   1000 ///< smallest acceleration, Q32: known to a thousandth

/// On the way to where the first reversal will be; a reversal is under way; it is over.
enum { PREPARING, MEASURING, TRAVELLING };

static TL_FAST int64_t q32(int64_t q8) {
    return q8 * ((int64_t)1 << 24);
}
static TL_FAST int64_t low_end(const tl_motion_t *m) {
    return q32(m->config.low);
}
static TL_FAST int64_t high_end(const tl_motion_t *m) {
    return q32(m->config.high);
}
static TL_FAST int64_t stroke_max(const tl_motion_t *m) {
    return q32(m->config.stroke_max);
}
static TL_FAST int64_t smaller(int64_t a, int64_t b) {
    return a < b ? a : b;
}
static TL_FAST int64_t larger(int64_t a, int64_t b) {
    return a > b ? a : b;
}

/// Distance until rest when braking begins on the next tick: a (1 + 2 + ... + (steps - 1)), never less than
/// needed; none of one step or of none.
static TL_FAST int64_t braking_distance(int64_t acceleration, uint32_t steps) {
    return acceleration * (int64_t)((uint64_t)steps * (steps - 1U) / 2U);
}

static TL_FAST bool is_forward(const tl_motion_t *m) {
    return m->leg % 2U == 0;
}
static TL_FAST uint32_t legs_of_pass(const tl_motion_t *m) {
    return 2U * m->config.cycles + 1U;
}

static TL_FAST bool goes_back(const tl_motion_t *m) {
    return m->pass % 2U != 0;
}
static TL_FAST int64_t far_end(const tl_motion_t *m) {
    return goes_back(m) ? low_end(m) : high_end(m);
}

/// End of the forward leg under way: a turning point of the pass or its far end. Both passes reach their
/// first turning point where the range begins to be visible to them; half a step between them interleaves the
/// middles of their strokes.
static TL_FAST int64_t turning_point(const tl_motion_t *m) {
    const uint32_t i = m->leg / 2U;
    if (i >= m->config.cycles) {
        return far_end(m);
    }
    const int64_t offset = m->half_step * (int64_t)(2U * i + (goes_back(m) ? 0U : 1U));
    return goes_back(m) ? m->first - offset : m->first + offset;
}

static TL_FAST void begin_leg(tl_motion_t *m, uint8_t phase, int64_t target) {
    m->direction = target < m->position ? -1 : 1;
    m->phase = phase;
    m->began = m->position;
    m->target = target;
}

/// A forward leg goes on to its turning point without a rest: until its onset all of the range is before it.
static TL_FAST void begin_reversal(tl_motion_t *m) {
    const int64_t back = goes_back(m) ? smaller(m->position + stroke_max(m), high_end(m))
                                      : larger(m->position - stroke_max(m), low_end(m));
    begin_leg(m, MEASURING, is_forward(m) ? far_end(m) : back);
}

static TL_FAST void end_measuring(tl_motion_t *m) {
    const int64_t further = braking_distance(m->acceleration, m->steps) + q32(m->config.approach);
    const bool rising = m->direction > 0;
    m->phase = TRAVELLING;
    m->target = rising ? smaller(m->position + further, high_end(m)) : larger(m->position - further, low_end(m));
    if (!is_forward(m)) {
        return;
    }
    if (m->leg == 0) { // from here to the far end the pass has its turning points
        const int64_t way_q8 = (rising ? far_end(m) - m->target : m->target - far_end(m)) / ((int64_t)1 << 24);
        m->first = m->target;
        m->half_step = q32((int64_t)((uint64_t)way_q8 * m->half_step_share >> 32));
    }
    m->target = rising ? larger(m->target, turning_point(m)) : smaller(m->target, turning_point(m));
}

static TL_FAST void end_leg(tl_motion_t *m) {
    m->speed = 0;
    m->steps = 0;
    if (m->phase == PREPARING && m->position != low_end(m)) {
        begin_leg(m, PREPARING, low_end(m));
        return;
    }
    if (m->phase != PREPARING && ++m->leg == legs_of_pass(m)) {
        m->leg = 0;
        m->pass++;
    }
    if (m->pass == 2U * m->config.speed_count) {
        m->state = TL_MOTION_COMPLETE;
    } else {
        begin_reversal(m);
    }
}

static TL_FAST int64_t left_to_target(const tl_motion_t *m) {
    return m->direction > 0 ? m->target - m->position : m->position - m->target;
}

/// Takes `speed` for this tick if that leaves room to brake: to rest at the target, and to measuring speed
/// before the approach.
static TL_FAST bool take_speed(tl_motion_t *m, int64_t speed, uint32_t steps) {
    const int64_t left = left_to_target(m);
    const int64_t needed = speed + braking_distance(m->acceleration, steps);
    if (needed > left) {
        return false;
    }
    if (speed > m->measuring[m->pass / 2U]) {
        const int64_t slow = braking_distance(m->acceleration, m->measuring_steps[m->pass / 2U]);
        if (needed - slow > left - q32(m->config.approach)) {
            return false;
        }
    }
    m->speed = speed;
    m->steps = steps;
    return true;
}

static TL_FAST bool speed_up(tl_motion_t *m, int64_t cap) {
    const int64_t faster = smaller(m->speed + m->acceleration, cap);
    const uint32_t steps = faster <= m->acceleration * m->steps ? m->steps : m->steps + 1U;
    return faster > m->speed && take_speed(m, faster, steps);
}

static TL_FAST void choose_speed(tl_motion_t *m) {
    const int64_t measuring = m->measuring[m->pass / 2U];
    const int64_t cap = m->phase == MEASURING ? measuring : m->transit;
    const int64_t left = left_to_target(m);
    if (m->steps < 2 && left <= smaller(m->acceleration, measuring)) {
        m->speed = left; // lands on the target
        m->steps = 1;
        return;
    }
    // As fast as may be; else as fast as costs no longer braking; else as before; else to measuring speed;
    // else slower.
    if (speed_up(m, cap) || speed_up(m, measuring) || speed_up(m, smaller(m->acceleration * m->steps, cap)) ||
        (m->speed > 0 && take_speed(m, m->speed, m->steps)) ||
        (m->speed > measuring && m->speed - m->acceleration < measuring &&
         take_speed(m, measuring, m->measuring_steps[m->pass / 2U]))) {
        return;
    }
    m->speed = larger(m->speed - m->acceleration, 0);
    m->steps = m->steps > 0 ? m->steps - 1U : 0;
}

static TL_FAST void brake(tl_motion_t *m) {
    m->speed = larger(m->speed - m->acceleration, 0);
    if (m->speed == 0) {
        m->state = m->ends_as;
    }
}

static TL_FAST void begin_stopping(tl_motion_t *m, tl_motion_state_t ends_as) {
    if (m->state == TL_MOTION_RUNNING) {
        m->state = TL_MOTION_STOPPING;
        m->ends_as = (uint8_t)ends_as;
    }
}

static tl_motion_error_t check(const tl_motion_config_t *c, tl_count_q8_t q) {
    if (c->rate_hz < 1000 || c->rate_hz > 10000) {
        return TL_MOTION_BAD_RATE;
    }
    if (c->approach < TL_COUNT_ONE || c->stroke_max > POSITION_MAX || c->stroke_max / 2 < c->approach) {
        return TL_MOTION_BAD_STROKE;
    }
    if (c->low < -POSITION_MAX || c->high > POSITION_MAX || q < -POSITION_MAX || q > POSITION_MAX ||
        (int64_t)c->high - c->low <= 2 * (int64_t)c->stroke_max) {
        return TL_MOTION_BAD_RANGE;
    }
    if (c->cycles < 1 || c->cycles > 100) {
        return TL_MOTION_BAD_CYCLES;
    }
    if (c->speed_count < 1 || c->speed_count > TL_MOTION_SPEEDS) {
        return TL_MOTION_BAD_SPEED;
    }
    for (uint32_t i = 0; i < c->speed_count; i++) {
        if (c->speed[i] < SPEED_MIN || c->speed[i] > c->transit) {
            return TL_MOTION_BAD_SPEED;
        }
    }
    return TL_MOTION_OK;
}

tl_motion_error_t tl_motion_start(tl_motion_t *motion, const tl_motion_config_t *config, tl_count_q8_t q) {
    const tl_motion_error_t error = check(config, q);
    if (error != TL_MOTION_OK) {
        return error;
    }
    const int64_t rate = config->rate_hz;
    const int64_t transit = q32(config->transit) / rate;
    const int64_t acceleration = q32(config->acceleration) / (rate * rate);
    if (transit > SPEED_MAX) {
        return TL_MOTION_BAD_RATE;
    }
    if (acceleration < RESOLUTION || transit / acceleration >= STEPS_MAX) {
        return TL_MOTION_BAD_ACCELERATION;
    }
    const uint32_t transit_steps = (uint32_t)(transit / acceleration) + 1U;
    if ((transit / 2) * transit_steps > q32(config->stroke_max)) {
        return TL_MOTION_BAD_ACCELERATION;
    }
    tl_motion_t *m = motion;
    memset(m, 0, sizeof *m);
    m->config = *config;
    m->state = TL_MOTION_RUNNING;
    m->position = q32(q);
    m->acceleration = acceleration;
    m->transit = transit;
    for (uint32_t i = 0; i < config->speed_count; i++) {
        m->measuring[i] = q32(config->speed[i]) / rate;
        m->measuring_steps[i] = (uint32_t)((m->measuring[i] + acceleration - 1) / acceleration);
    }
    m->half_step_share = UINT32_MAX / (2U * config->cycles);
    m->timeout_ticks = (uint32_t)((uint64_t)config->host_timeout_us * config->rate_hz / 1000000U);
    const int64_t prepared = low_end(m) + stroke_max(m);
    begin_leg(m, PREPARING, m->position < prepared ? prepared : low_end(m));
    return TL_MOTION_OK;
}

TL_FAST tl_motion_reference_t tl_motion_tick(tl_motion_t *motion) {
    tl_motion_t *m = motion;
    if (m->state == TL_MOTION_RUNNING) {
        if (m->timeout_ticks > 0 && ++m->quiet_ticks > m->timeout_ticks) {
            begin_stopping(m, TL_MOTION_HOST_LOST);
        } else if (m->position == m->target) {
            end_leg(m);
        } else {
            const int64_t way = m->direction > 0 ? m->position - m->began : m->began - m->position;
            if (m->phase == MEASURING && is_forward(m) && way >= stroke_max(m)) {
                end_measuring(m);
            }
            choose_speed(m);
        }
    }
    if (m->state == TL_MOTION_STOPPING) {
        brake(m);
    }
    const int64_t velocity = m->direction < 0 ? -m->speed : m->speed;
    m->position += velocity;
    return (tl_motion_reference_t){
        .q = (tl_count_q8_t)((m->position + ((int64_t)1 << 23)) >> 24),
        .velocity = (int32_t)((velocity * (int64_t)m->config.rate_hz) >> 24),
    };
}

TL_FAST void tl_motion_onset(tl_motion_t *motion, int8_t direction) {
    if (motion->state == TL_MOTION_RUNNING && motion->phase == MEASURING && motion->direction == direction) {
        end_measuring(motion);
    }
}

TL_FAST void tl_motion_frame(tl_motion_t *motion) {
    motion->quiet_ticks = 0;
}

TL_FAST void tl_motion_stop(tl_motion_t *motion) {
    begin_stopping(motion, TL_MOTION_STOPPED);
}

TL_FAST tl_motion_state_t tl_motion_state(const tl_motion_t *motion) {
    return (tl_motion_state_t)motion->state;
}

uint16_t tl_motion_progress(const tl_motion_t *motion) {
    const uint32_t legs = legs_of_pass(motion) * 2U * motion->config.speed_count;
    const uint32_t done = legs_of_pass(motion) * motion->pass + motion->leg;
    return legs == 0 ? 0 : (uint16_t)(done * 1000U / legs);
}
