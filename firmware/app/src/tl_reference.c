#include "tautline/tl_reference.h"

#define NEAR             ((tl_count_q8_t)1 << 14) // 64 counts: distances up to there are kept in Q24
#define FAR              ((tl_count_q8_t)1 << 22) // 16384 counts: farther ones count as that
#define ACCELERATION_MAX (1 << 22)                // counts/tick2 Q24: with two of them in Q32 there is room to spare

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
    const int64_t ticks = limits.speed / limits.acceleration + 2;
    const int64_t stop = (ticks * (limits.speed / 2 + 1)) >> 16;
    limits.stop = stop < INT32_MAX ? (int32_t)stop : INT32_MAX;
    return limits;
}

void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q) {
    *reference = (tl_reference_t){.q = q, .target = q};
}

// The whole product, from four of 16 x 16 bits: the library's would be a call for 64 x 64.
static inline uint64_t product(uint32_t a, uint32_t b) {
    const uint32_t a0 = a & 0xFFFFU, a1 = a >> 16, b0 = b & 0xFFFFU, b1 = b >> 16;
    const uint64_t outer = ((uint64_t)(a1 * b1) << 32) | (a0 * b0);
    return outer + ((uint64_t)(a1 * b0) << 16) + ((uint64_t)(a0 * b1) << 16);
}

// Whether one tick at `speed` (> 0) and then braking ends within a distance: v (v + a) <= 2 a d. `room` is 2 a d, Q48.
static inline bool can_stop(int32_t speed, int32_t acceleration, uint64_t room) {
    return speed <= 0 || product((uint32_t)speed, (uint32_t)(speed + acceleration)) <= room;
}

// 2 a d in Q48, d in counts Q16.
static inline uint64_t room_for(uint32_t distance_q16, int32_t acceleration) {
    return product(distance_q16, (uint32_t)acceleration << 9);
}

// The speed towards a distance, both seen from the target, that this tick allows: faster, as before, or slower.
static int32_t approach(int32_t speed, uint32_t distance_q16, int32_t acceleration) {
    const uint64_t room = room_for(distance_q16, acceleration);
    if (can_stop(speed + acceleration, acceleration, room)) {
        return speed + acceleration;
    }
    return can_stop(speed, acceleration, room) ? speed : speed - acceleration;
}

// `velocity`, or braking where it would not end before the end of the range: `room` ahead, and `more` of Q16.
static int32_t hold_back(int32_t velocity, int32_t before, tl_count_q8_t room, int32_t more,
                         const tl_reference_limits_t *limits) {
    if (velocity <= 0) {
        return velocity;
    }
    const int32_t room_q16 = room < FAR ? room * 256 + more : INT32_MAX;
    if (room_q16 > 0 && can_stop(velocity, limits->acceleration, room_for((uint32_t)room_q16, limits->acceleration))) {
        return velocity;
    }
    return before > limits->acceleration ? before - limits->acceleration : 0;
}

static void advance(tl_reference_t *reference, int32_t velocity) {
    const uint32_t fraction = reference->fraction + ((uint32_t)velocity & 0xFFFFU);
    reference->q += (velocity >> 16) + (int32_t)(fraction >> 16);
    reference->fraction = fraction & 0xFFFFU;
    reference->velocity = velocity;
}

static bool within(int32_t x, int32_t most) {
    return x <= most && x >= -most;
}

void tl_reference_step(tl_reference_t *reference, tl_count_q8_t target, tl_count_q8_t low, tl_count_q8_t high,
                       const tl_reference_limits_t *limits) {
    const int32_t a = limits->acceleration;
    const int32_t before = reference->velocity;
    const int32_t most_q8 = limits->speed >> 16;
    const int32_t target_speed = tl_clamp(target - reference->target, -most_q8, most_q8) * 65536;
    const tl_count_q8_t apart = target - reference->q;
    reference->target = target;
    int32_t velocity;
    if (within(apart, NEAR - 1)) {
        const int32_t distance = apart * 65536 - (int32_t)reference->fraction;
        const int32_t lag = distance - target_speed; // what is left if both go on as they do
        const int32_t half = target_speed + lag / 2;
        if (within(lag, a) && within(distance - before, a)) {
            velocity = distance; // there within this tick, and as fast as the target
        } else if (within(lag, 2 * a) && within(half - before, a)) {
            velocity = half; // the last stretch in two ticks, whatever its length
        } else {
            const int32_t relative = before - target_speed;
            velocity = target_speed + (lag >= 0 ? approach(relative, (uint32_t)lag >> 8, a)
                                                : -approach(-relative, (uint32_t)-lag >> 8, a));
        }
        reference->behind = !within(distance - velocity, 1 << 24);
    } else {
        const int32_t relative = before - target_speed;
        const tl_count_q8_t far = apart > 0 ? apart : -apart;
        const int32_t ahead = (apart > 0 ? target_speed : -target_speed) / 256;
        const uint32_t lag_q16 = (uint32_t)((far < FAR ? far * 256 : INT32_MAX - (1 << 24)) - ahead);
        velocity = target_speed + (apart > 0 ? approach(relative, lag_q16, a) : -approach(-relative, lag_q16, a));
        reference->behind = true;
    }
    // Also where the limits were lowered meanwhile, or the target's own speed changed faster than they allow.
    velocity = tl_clamp(velocity, -limits->speed, limits->speed);
    velocity = tl_clamp(velocity, before - a, before + a);
    const tl_count_q8_t room = velocity >= 0 ? high - reference->q : reference->q - low;
    if (room <= limits->stop) {
        const int32_t fraction = (int32_t)(reference->fraction >> 8); // rounded in favour: else no end is quite reached
        velocity = velocity >= 0 ? hold_back(velocity, before, room, -fraction, limits)
                                 : -hold_back(-velocity, -before, room, fraction + 1, limits);
    }
    advance(reference, velocity);
}

bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits) {
    const int32_t before = reference->velocity;
    advance(reference, before - tl_clamp(before, -limits->acceleration, limits->acceleration));
    reference->target = reference->q;
    return reference->velocity == 0;
}
