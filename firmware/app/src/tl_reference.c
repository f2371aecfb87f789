#include "tautline/tl_reference.h"

#define NEAR             ((tl_count_q8_t)1 << 14) // 64 counts: distances up to there are kept in Q24
#define FAR              ((tl_count_q8_t)1 << 22) // 16384 counts: farther ones count as that
#define ACCELERATION_MAX (1 << 26)                // counts/tick2 Q24: what room_for() has bits for

tl_reference_limits_t tl_reference_limits(int32_t speed, int32_t acceleration, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    speed = tl_clamp(speed, 1, TL_REFERENCE_SPEED_MAX);
    acceleration = tl_clamp(acceleration, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    const int64_t per_tick = ((int64_t)speed << 16) / rate;
    const int64_t per_tick2 = ((int64_t)acceleration << 16) / (rate * rate);
    tl_reference_limits_t limits = {
        .speed = (int32_t)per_tick,
        .acceleration = per_tick2 > ACCELERATION_MAX ? ACCELERATION_MAX : (int32_t)per_tick2,
    };
    const tl_scale_t per_2a = tl_scale_of(128U, (uint32_t)limits.acceleration);
    limits.ticks = per_2a.mantissa;
    limits.ticks_down = (uint32_t)-per_2a.shift; // as acceleration is more than 128
    const int64_t ticks = limits.speed / limits.acceleration + 2;
    const int64_t stop = (ticks * (limits.speed / 2 + 1)) >> 16;
    limits.stop = stop < INT32_MAX ? (int32_t)stop : INT32_MAX;
    return limits;
}

void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q) { // field by field: the control step has no memset
    reference->q = reference->target = q;
    reference->fraction = 0;
    reference->velocity = 0;
    reference->behind = false;
}

// Counts Q16 that one tick at `speed` (Q24, 0 to 2^30) and then braking take: v (v + a) / 2a, by at most a 256th of a
// tick more with more = 1, less with 0.
static inline uint32_t stopping(int32_t speed, uint32_t more, const tl_reference_limits_t *limits) {
    const uint32_t ticks_q8 =
        tl_mul_high((uint32_t)(speed + limits->acceleration), limits->ticks) >> limits->ticks_down;
    const uint64_t way_q32 = tl_mul_wide((uint32_t)speed, ticks_q8 + more);
    return way_q32 >> 47 != 0 ? INT32_MAX : (uint32_t)(way_q32 >> 16);
}

// The speed towards a distance (counts Q16), both seen from the target, that this tick allows: faster, as before, or
// slower.
static int32_t approach(int32_t speed, int32_t distance_q16, const tl_reference_limits_t *limits) {
    const int32_t a = limits->acceleration;
    if (speed < 0) {
        return speed + a;
    }
    const int32_t spare = distance_q16 - (int32_t)stopping(speed, 1, limits);
    if (spare < 0) {
        return speed - a;
    }
    return spare >= (speed + a) >> 8 ? speed + a : speed; // faster, a tick and braking take v + a more
}

// `velocity` (> 0), or braking where it would not end before the end of the range: `room` ahead, and `more` of Q16.
static int32_t hold_back(int32_t velocity, int32_t before, tl_count_q8_t room, int32_t more,
                         const tl_reference_limits_t *limits) {
    const int32_t room_q16 = room < FAR ? room * 256 + more : INT32_MAX;
    if ((int32_t)stopping(velocity, 0, limits) <= room_q16) {
        return velocity;
    }
    return before > limits->acceleration ? before - limits->acceleration : 0;
}

static inline void advance(tl_reference_t *reference, int32_t velocity) {
    const uint32_t fraction = reference->fraction + ((uint32_t)velocity & 0xFFFFU);
    reference->q += (velocity >> 16) + (int32_t)(fraction >> 16);
    reference->fraction = fraction & 0xFFFFU;
    reference->velocity = velocity;
}

static inline bool within(int32_t x, int32_t most) {
    return x <= most && x >= -most;
}

// Whether the target, moving by `step` a tick, is on its way to an end of the range from where we may not pass it.
static inline bool leads_to_the_end(tl_count_q8_t q, int32_t step, tl_count_q8_t low, tl_count_q8_t high,
                                    tl_count_q8_t stop) {
    return step > 0 ? high - q <= stop : q - low <= stop;
}

void tl_reference_step(tl_reference_t *reference, tl_count_q8_t target, tl_count_q8_t low, tl_count_q8_t high,
                       const tl_reference_limits_t *limits) {
    const int32_t a = limits->acceleration;
    const int32_t before = reference->velocity;
    const tl_count_q8_t q = reference->q;
    const int32_t most_q8 = limits->speed >> 16;
    int32_t target_speed = tl_clamp(target - reference->target, -most_q8, most_q8) * 65536;
    const tl_count_q8_t apart = target - q;
    reference->target = target;
    int32_t velocity = 0;
    bool follows = false;
    if (within(apart, NEAR - 1)) {
        const int32_t distance = apart * 65536 - (int32_t)reference->fraction;
        const int32_t lag = distance - target_speed; // what is left if both go on as they do
        const int32_t half = target_speed + lag / 2;
        if (within(lag, a) && within(distance - before, a)) {
            velocity = distance; // there within this tick, and as fast as the target
            follows = true;
        } else if (within(lag, 2 * a) && within(half - before, a)) {
            velocity = half; // the last stretch in two ticks, whatever its length
            follows = true;
        }
    }
    if (follows) {
        // Also where the target's own speed is beyond what the limits allow.
        velocity = tl_clamp(velocity, -limits->speed, limits->speed);
        reference->behind = !within(apart * 65536 - velocity, 1 << 24);
        if (velocity > 0 ? high - q <= limits->stop : (velocity < 0 && q - low <= limits->stop)) {
            const int32_t fraction = (int32_t)(reference->fraction >> 8); // in favour: else no end is quite reached
            velocity = velocity > 0 ? hold_back(velocity, before, high - q, -fraction, limits)
                                    : -hold_back(-velocity, -before, q - low, fraction + 1, limits);
        }
    } else {
        if (target_speed != 0 && leads_to_the_end(q, target_speed, low, high, limits->stop)) {
            target_speed = 0; // it will have to stop: caught up with as if it stood
        }
        const int32_t relative = before - target_speed;
        const int32_t way = tl_clamp(apart, -FAR, FAR) * 256 - (int32_t)(reference->fraction >> 8) - target_speed / 256;
        velocity = target_speed + (way >= 0 ? approach(relative, way, limits) : -approach(-relative, -way, limits));
        reference->behind = true;
        if (!within(velocity, limits->speed)) { // where they were lowered meanwhile
            velocity = velocity > 0 ? (before - a > limits->speed ? before - a : limits->speed)
                                    : (before + a < -limits->speed ? before + a : -limits->speed);
        }
    }
    advance(reference, velocity);
}

bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits) {
    const int32_t before = reference->velocity;
    advance(reference, before - tl_clamp(before, -limits->acceleration, limits->acceleration));
    reference->target = reference->q;
    return reference->velocity == 0;
}
