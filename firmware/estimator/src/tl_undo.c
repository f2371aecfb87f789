#include "tautline/tl_undo.h"

#include "tautline/tl_fast.h"
#include "tl_ratio.h"

#define HAS(lookup, section) (((lookup)->table.has & (uint32_t)TL_TABLE_HAS_##section) != 0)

#define COUNT_Q16   65536           // a count, of an offset
#define SCALE_STEP  (1 << 12)       // of a scale in a tick, Q23: B = 2000 counts then changes by a count
#define SCALE_LEAST (-(1 << 23))    // no width at all
#define SCALE_MOST  ((1 << 23) - 1) // twice of it
#define GAIN_MOST   (1 << 22)       // half of it
#define MOST        (((int32_t)1 << 30) - 1)
#define SHORT_MOST  (((int32_t)1 << 20) - 1) // that a factor may take
#define COARSE_US   50000
#define ALL_Q12     4096            // of what a side or the speed adds
#define AGAIN_MOST  ((1 << 14) - 1) // Q8 counts of a tick: a product with 14 in Q12 is within 2^30
#define GROWN_MOST  ((1 << 10) - 1) // of w in a tick, Q12: with what is late in Q4 a product within 2^30
#define TURNED_MOST (TL_TABLE_POSITION_MAX + TL_TABLE_VALUE_MAX)
#define BEFORE_MOST ((int32_t)1 << 24) // Q8 counts: 65536

static TL_FAST inline uint32_t size_of(int32_t value) {
    return value < 0 ? 0U - (uint32_t)value : (uint32_t)value;
}

// a b / 2^right for right 8 to 31, towards 0, within +-MOST.
static TL_FAST int32_t times(int32_t a, int32_t b, uint32_t right) {
    const uint32_t x = size_of(a), y = size_of(b), high = tl_mul_high(x, y);
    uint32_t size = (uint32_t)MOST;
    if (high >> (right - 2U) == 0) {
        size = high << (32U - right) | x * y >> right;
    }
    return (a ^ b) < 0 ? -(int32_t)size : (int32_t)size;
}

// -- ramps -------------------------------------------------------------------------------------------------------

static TL_FAST void aim(tl_ramp_t *ramp, int32_t goal, int32_t step_max, uint32_t ticks) {
    const uint32_t way = size_of(goal - ramp->now);
    const uint32_t step = ticks > 1U ? way / ticks + 1U : way;
    ramp->now = ticks == 0 ? goal : ramp->now;
    ramp->goal = goal;
    ramp->step = step < (uint32_t)step_max ? (int32_t)step : step_max;
}

static TL_FAST void aim_all(tl_undo_t *undo, int32_t gain, uint32_t ticks) {
    tl_moved_t *moved = &undo->moved;
    const int32_t offset = tl_clamp(tl_add_sat(moved->adapt_offset, moved->load_offset), -MOST, MOST);
    const int32_t scale = tl_clamp(moved->adapt_scale + moved->load_scale, SCALE_LEAST, SCALE_MOST);
    aim(&moved->offset, offset, COUNT_Q16 / 2, ticks);
    aim(&moved->scale, scale, SCALE_STEP, ticks);
    aim(&moved->gain, gain, SCALE_STEP, ticks);
    undo->active |= offset != 0 || scale != 0 || gain != 0; // until the next start
}

static TL_FAST void approach(tl_ramp_t *ramp) {
    const int32_t step = ramp->step;
    ramp->now += tl_clamp(ramp->goal - ramp->now, -step, step);
}

TL_FAST void tl_undo_forget(tl_undo_t *undo) {
    tl_moved_t *moved = &undo->moved;
    moved->adapt_offset = moved->adapt_scale = 0;
    moved->offset.now = moved->offset.goal = moved->load_offset;
    moved->scale.now = moved->scale.goal = moved->load_scale;
}

TL_FAST bool tl_undo_adapt(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t offset, int32_t scale_q15,
                           uint32_t ticks) {
    const tl_table_adapt_t *most = &lookup->table.adapt;
    const bool none = offset == 0 && scale_q15 == TL_RATIO_ONE;
    if (!none && (!HAS(lookup, adapt) || size_of(offset) > (uint32_t)most->offset ||
                  scale_q15 < most->width_least_q15 || scale_q15 > most->width_most_q15)) {
        return false;
    }
    undo->moved.adapt_offset = offset * 256;
    undo->moved.adapt_scale = (scale_q15 - TL_RATIO_ONE) * 256;
    aim_all(undo, undo->moved.gain.goal, ticks);
    return true;
}

TL_FAST void tl_undo_load(tl_undo_t *undo, const tl_lookup_t *lookup, int32_t load, uint32_t ticks) {
    const tl_table_load_t *by = &lookup->table.load;
    if (!HAS(lookup, load)) {
        return;
    }
    const int32_t beyond = tl_sub_sat(load, by->reference); // Q8
    const int64_t gain = tl_clamp(times(beyond, by->gain, 9), -GAIN_MOST, GAIN_MOST);
    undo->moved.load_offset = times(beyond, by->offset, 8);
    undo->moved.load_scale = tl_clamp(times(beyond, by->width, 9), SCALE_LEAST, SCALE_MOST);
    aim_all(undo, (int32_t)(-gain * (1 << 23) / ((1 << 23) + gain)), ticks);
}

// -- before p* ---------------------------------------------------------------------------------------------------

TL_FAST void tl_undo_join(tl_undo_t *undo, const tl_lookup_t *lookup) {
    const tl_table_joints_t *joints = &lookup->table.joints;
    int32_t angle = 0, before = 0;
    for (uint32_t i = 0; i < undo->joints; i++) {
        const int32_t at = undo->moved.joint[i], half = joints->play[i] / 2;
        const int32_t carried = tl_clamp(undo->carried[i], at - half, at + half);
        const tl_factor_t slope = undo->slope[i]; // in Q28 to deg Q16, in Q20 to Q8 counts
        const int32_t moves = tl_clamp(carried >> 4, -SHORT_MOST, SHORT_MOST) * slope.value >> (16U - slope.log2);
        undo->carried[i] = carried;
        if (slope.before) {
            before = tl_add_sat(before, moves);
        } else {
            angle = tl_add_sat(angle, moves);
        }
    }
    undo->joined = angle;
    undo->before = tl_clamp(before, -BEFORE_MOST, BEFORE_MOST);
}

TL_FAST tl_deg_q16_t tl_undo_angle(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_deg_q16_t c) {
    c = tl_sub_sat(c, undo->joined);
    const int32_t gain = undo->moved.gain.now;
    return gain == 0 ? c : tl_add_sat(c, times(tl_sub_sat(c, lookup->table.load.middle), gain, 23));
}

// The rest is taken in the middle of the tick: a ramp is then followed exactly as late as the time says.
TL_FAST tl_count_q8_t tl_undo_late(tl_undo_t *undo, tl_count_q8_t p) {
    uint32_t sum = (uint32_t)p;
    for (tl_follower_t *f = undo->late; f < undo->late + TL_TABLE_LATE_MAX && f->share != 0; f++) {
        const int32_t most = f->most, rest = tl_clamp((p - f->at) >> f->coarse, -most, most), way = rest * f->share;
        const uint32_t less = (uint32_t)way << f->up, more = f->more + less;
        const int32_t step = way >> f->down; // as coarse as the rest
        f->more = more;
        f->at += (way >> (32U - f->up)) + (more < less ? 1 : 0);
        sum += (uint32_t)((rest - step / 2) * f->gain >> f->lead_down);
    }
    return tl_clamp((int32_t)sum, -MOST, MOST);
}

// -- the width ---------------------------------------------------------------------------------------------------

// A small table at x >= 0: its nodes are at 0, 1, 2, 3, 4, 6, 8, 12, .. 192, 256 steps.
static TL_FAST int32_t at(const int32_t *values, uint32_t x, int32_t step_log2) {
    uint32_t log2 = (uint32_t)step_log2, node = x >> log2;
    if (node >= TL_TABLE_STEPS) {
        return values[TL_TABLE_LAST];
    }
    if (node >= 4U) {
        const uint32_t octave = tl_bits(node) - 1U;
        node = 2U * octave + (node >> (octave - 1U) & 1U);
        log2 += octave - 1U;
    }
    const uint32_t into = x & ((1U << log2) - 1U);
    return tl_lerp(values[node], values[node + 1U], log2 > 16U ? into >> (log2 - 16U) : into << (16U - log2));
}

TL_FAST void tl_undo_turned(tl_undo_t *undo, tl_count_q8_t p, int32_t side) {
    undo->side = side;
    undo->turned_at = p;
    undo->caught = undo->followed = 0;
}

TL_FAST bool tl_undo_anew(tl_undo_t *undo, bool goes_on, bool still) {
    const bool anew = goes_on && undo->awaits == 0 && undo->rest_ticks != 0;
    if (goes_on || !still) {
        undo->awaits = undo->rest_ticks;
    } else if (undo->awaits != 0) {
        undo->awaits--;
    }
    return anew;
}

// A part of x, 0 .. 2^24, of at most 15.
static TL_FAST inline int32_t part_of(int32_t x, int32_t part_q12) {
    return (x >> 12) * part_q12 + ((x & 0xFFF) * part_q12 >> 12);
}

// max(0, 1 + share (B / mean - 1)); beyond: B / mean - 1, at most 7.
static TL_FAST inline int32_t part_at(int32_t beyond_q14, int32_t share_q16) {
    const int32_t part = ALL_Q12 + (beyond_q14 * (share_q16 >> 4) >> 14);
    return part < 0 ? 0 : part;
}

// Moves the turn, so that the travel from it is section 10's d, to where half of B and w are now: a side is late by
// less where w is more, where the end that carries has gone beside p, and where w itself has grown. What was caught up
// is a step of a fixed-point iteration, so a tick late, and more ticks where w is large; what is rounded of it is kept.
static TL_FAST void follow(tl_undo_t *undo, const tl_lookup_t *lookup, int32_t half, int32_t sides_q12) {
    const int32_t more = tl_clamp(undo->caught - undo->followed, 0, AGAIN_MOST) >> lookup->follows_log2;
    const int32_t again_q12 = more * (undo->sides_q12 - ALL_Q12) + undo->follows_rest_q12;
    const int32_t late_q4 = (lookup->table.sides.late[0] - undo->caught) >> 4;
    const int32_t grown_q12 = tl_clamp(sides_q12 - undo->sides_q12, -GROWN_MOST, GROWN_MOST);
    const int32_t ahead = half - undo->half + ((late_q4 * grown_q12 + 128) >> 8), way = (again_q12 >> 12) - ahead;
    undo->followed += more;
    undo->follows_rest_q12 = again_q12 & 0xFFF;
    undo->turned_at = tl_clamp(undo->turned_at + (undo->side > 0 ? way : -way), -TURNED_MOST, TURNED_MOST);
    undo->half = half;
    undo->sides_q12 = sides_q12;
}

TL_FAST void tl_undo_weigh(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p) {
    const tl_table_pressed_t *pressed = &lookup->table.pressed;
    undo->wider = undo->extra;
    if (HAS(lookup, pressed)) {
        uint32_t ends = 0;
        const int32_t width = tl_lookup_width(lookup, p, &ends);
        const int32_t beyond_q14 = (int32_t)tl_scale((uint32_t)width, lookup->per_mean_q14) - (1 << 14);
        follow(undo, lookup, width >> 1, part_at(beyond_q14, pressed->sides_q16));
        undo->wider = part_of(undo->extra, part_at(beyond_q14, pressed->speed_q16));
    }
}

TL_FAST int32_t tl_undo_wider(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p) {
    const tl_table_sides_t *sides = &lookup->table.sides;
    if (undo->side != sides->side || undo->side == 0) {
        return undo->wider;
    }
    const int32_t travel = undo->side > 0 ? p - undo->turned_at : undo->turned_at - p;
    const int32_t late = at(sides->late, travel > 0 ? (uint32_t)travel : 0, sides->step_log2);
    undo->caught = sides->late[0] - late;
    return undo->wider + 2 * part_of(late, undo->sides_q12);
}

// The motor's speed is p's but for the take-up, which is over before anything of it is seen.
TL_FAST void tl_undo_tick(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p) {
    const tl_table_speed_t *speed = &lookup->table.speed;
    const int32_t by = p - undo->p; // both within the range
    undo->p = p;
    undo->by = by;
    approach(&undo->moved.offset);
    approach(&undo->moved.scale);
    approach(&undo->moved.gain);
    if (HAS(lookup, speed) && (by != 0 || speed->held == 0)) {
        const int32_t off = tl_clamp(by, -undo->step_max, undo->step_max) * undo->rate_hz - undo->speed_q8;
        const uint32_t share = undo->speed_share_q16;
        undo->speed_q8 += (off >> 16) * (int32_t)share + (int32_t)(((uint32_t)off & 0xFFFFU) * share >> 16);
        undo->extra = at(speed->extra, size_of(undo->speed_q8), speed->step_log2);
    }
}

TL_FAST int32_t tl_undo_scaled(const tl_undo_t *undo, int32_t width) {
    const int32_t scale = undo->moved.scale.now;
    return scale == 0 ? width : width + times(width, scale, 23);
}

// -- behind the width --------------------------------------------------------------------------------------------

// sin of a turn in 2^32, Q15: an odd polynomial of the fifth degree over a quarter of it, to 1.4e-4.
static TL_FAST int32_t sine(uint32_t turn) {
    int32_t z = (int32_t)turn >> 16; // quarters, Q14
    z = z > 16384 ? 32768 - z : (z < -16384 ? -32768 - z : z);
    const int32_t square = z * z >> 14;
    return z * (25733 - (square * (10539 - (square * 1191 >> 14)) >> 14)) >> 13;
}

static TL_FAST int32_t share_of(int32_t amplitude, int32_t wave_q15) {
    return amplitude * (wave_q15 >> 2) >> 13;
}

static TL_FAST int32_t encoder_error(const tl_lookup_t *lookup, tl_count_q8_t x) {
    const tl_table_encoder_t *e = &lookup->table.encoder;
    const uint32_t rest = lookup->phase_rest; // 16 bits below those of a turn
    const uint32_t turn =
        (uint32_t)x * lookup->phase + (uint32_t)((x >> 16) * (int32_t)rest) + (((uint32_t)x & 0xFFFFU) * rest >> 16);
    const int32_t s = sine(turn), c = sine(turn + (1U << 30));
    int32_t error = share_of(e->sine, s) + share_of(e->cosine, c);
    if ((e->sine2 | e->cosine2) != 0) {
        error += share_of(e->sine2, s * c >> 14) + share_of(e->cosine2, 32768 - (s * s >> 14));
    }
    return error;
}

TL_FAST tl_count_q8_t tl_undo_reading(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t q) {
    const tl_count_q8_t shaft = tl_sub_sat(q, (undo->moved.offset.now >> 8) + undo->before);
    return HAS(lookup, encoder) ? shaft - encoder_error(lookup, shaft) : shaft;
}

TL_FAST tl_count_q8_t tl_undo_pushing(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t reading,
                                      uint32_t rounds) {
    tl_count_q8_t shaft = reading;
    for (uint32_t i = HAS(lookup, encoder) ? 0 : rounds; i < rounds; i++) {
        shaft = reading + encoder_error(lookup, shaft);
    }
    return tl_add_sat(shaft, (undo->moved.offset.now >> 8) + undo->before);
}

// -- beginning ---------------------------------------------------------------------------------------------------

static tl_factor_t factor_of(int32_t value, uint32_t log2_least) {
    const uint32_t bits = tl_bits(size_of(value));
    const uint32_t log2 = bits > 11U + log2_least ? bits - 11U : log2_least;
    const int32_t rounded = (int32_t)(((int64_t)value + ((int64_t)1 << log2 >> 1)) >> log2);
    return (tl_factor_t){.value = (int16_t)tl_clamp(rounded, -2047, 2047), .log2 = (uint8_t)log2};
}

// Either the one or the other is 0.
static tl_factor_t joint_of(int32_t slope_q28, int32_t before_q20) {
    tl_factor_t factor = factor_of(before_q20 != 0 ? before_q20 : slope_q28, 0);
    factor.before = before_q20 != 0;
    return factor;
}

// A rest of `most` leads by 2^28 at most. After COARSE_US nothing is so steep that a sixteenth of a count matters.
static tl_follower_t follower_of(int32_t share_q32, int32_t gain_q16, int32_t time_us) {
    const tl_factor_t share = factor_of(share_q32, 1U), gain = factor_of(gain_q16, 0);
    const uint32_t coarse = time_us >= COARSE_US && gain.log2 <= 11U ? 4U : 0, lead_down = 16U - gain.log2 - coarse;
    const int64_t most = ((int64_t)1 << 28 << lead_down) / (gain.value != 0 ? (int64_t)size_of(gain.value) : 1);
    return (tl_follower_t){.most = most < SHORT_MOST ? (int32_t)most : SHORT_MOST,
                           .share = share.value,
                           .gain = gain.value,
                           .coarse = (uint8_t)coarse,
                           .up = (uint8_t)(share.log2 + coarse),
                           .down = (uint8_t)(32U - share.log2),
                           .lead_down = (uint8_t)lead_down};
}

// 1 / (time in ticks + 1/2) is 1 - exp(-1 / ticks) to its third order, Q32 less one.
static uint32_t share_of_tick(int32_t time_us, uint32_t rate_hz) {
    const uint64_t halves = 2U * (uint64_t)(uint32_t)time_us * rate_hz;
    const uint64_t share = ((uint64_t)2000000 << 32) / (halves + 1000000U);
    return share > INT32_MAX ? INT32_MAX : (uint32_t)share; // half of the rest at most
}

void tl_undo_start(tl_undo_t *undo, const tl_lookup_t *lookup, uint32_t rate_hz) {
    const tl_table_t *table = &lookup->table;
    tl_moved_t moved = undo->moved;
    moved.offset.now = moved.offset.goal;
    moved.scale.now = moved.scale.goal;
    moved.gain.now = moved.gain.goal;
    *undo = (tl_undo_t){
        .moved = moved, .sides_q12 = ALL_Q12, .rate_hz = (int32_t)rate_hz, .step_max = MOST / (int32_t)rate_hz};
    tl_follower_t *next = undo->late; // any place of the section may be free; of these the last ones are
    for (uint32_t i = 0; i < TL_TABLE_LATE_MAX; i++) {
        const int32_t time_us = table->late.time_us[i];
        if (time_us != 0) {
            *next++ = follower_of((int32_t)share_of_tick(time_us, rate_hz), table->late.gain_q16[i], time_us);
        }
    }
    if (HAS(lookup, anew)) { // longer than so many us
        undo->awaits = undo->rest_ticks = (uint32_t)((uint64_t)(uint32_t)table->anew.rest_us * rate_hz / 1000000U) + 1U;
    }
    undo->speed_share_q16 = table->speed.time_us == 0 ? 65536U : share_of_tick(table->speed.time_us, rate_hz) >> 16;
    for (uint32_t i = 0; i < TL_TABLE_JOINTS; i++) {
        undo->carried[i] = moved.joint[i];
        if (table->joints.axis[i] != 0) { // any place may be free, and its slope is nobody's
            undo->slope[i] = joint_of(table->joints.slope[i], table->before.slope_q20[i]);
            undo->joints = i + 1U;
        }
    }
    tl_undo_join(undo, lookup);
    undo->active =
        (table->has & ~(uint32_t)TL_TABLE_HAS_adapt) != 0 || (moved.offset.now | moved.scale.now | moved.gain.now) != 0;
}

TL_FAST void tl_undo_rest(tl_undo_t *undo, tl_count_q8_t p) {
    undo->p = p;
    undo->by = 0;
    for (uint32_t i = 0; i < TL_TABLE_LATE_MAX; i++) {
        undo->late[i].at = p;
        undo->late[i].more = (uint32_t)1 << 31; // half of a Q8 count: rests are rounded
    }
}
