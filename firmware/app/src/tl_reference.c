#include "tautline/tl_reference.h"

#include "tautline/tl_fast.h"

#define ACCELERATION_MAX (1 << 26) // counts/tick2 Q24: with four of them, and twice the greatest speed, below 2^31
#define NEAR             ((tl_count_q8_t)1 << 14) // 64 counts: distances up to there are kept in Q24
#define FAR              ((tl_count_q8_t)1 << 22) // 16384 counts: farther ones count as that

TL_FAST void tl_reference_set(tl_reference_t *reference,
                              tl_count_q8_t q) { // field by field: the control step has no memset
    reference->q = reference->target = q;
    reference->fraction = 0;
    reference->velocity = 0;
    reference->behind = false;
}

// What one tick at `speed` (0 to twice the limit) and then braking take at most, in Q16 without way_down bits; of a
// speed above, where the limit was lowered meanwhile, some number: catch_up() then brakes whatever it is. With v = n a
// + f that is a n (n + 1) / 2 + (n + 1) f = v (v + a) / 2a + f (a - f) / 2a, whose last part is a / 8 at most.
static inline int32_t stopping(int32_t speed, const tl_reference_limits_t *limits) {
    const uint32_t v = (uint32_t)(speed >> limits->speed_down) + 1U;
    const uint32_t product = v * (v + (uint32_t)limits->acceleration_scaled + 1U), ratio = limits->ratio;
    return (int32_t)(((product >> 16) * ratio + ((product & 0xFFFFU) * ratio >> 16)) >> limits->ratio_down) +
           limits->whole_ticks;
}

// The speed towards a distance (counts Q16), both seen from the target, that this tick allows: faster, as before, or
// slower.
static inline int32_t approach(int32_t speed, int32_t distance_q16, const tl_reference_limits_t *limits) {
    const int32_t a = limits->acceleration;
    if (speed <= 0) { // a way that is shorter than that, from rest or after turning, is gone in this tick
        return (speed + a) >> 8 > distance_q16 ? distance_q16 * 256 : speed + a;
    }
    const uint32_t down = limits->way_down;
    const int32_t spare = (distance_q16 >> down) - stopping(speed, limits);
    if (spare < 0) {
        return speed > a ? speed - a : 0;
    }
    return spare > (speed + a) >> (8U + down) ? speed + a : speed; // faster, a tick and braking take v + a more
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

// Catches up with a target that is not reached at once.
static TL_FAST int32_t catch_up(const tl_reference_t *reference, int32_t target_speed, tl_count_q8_t apart,
                                const tl_reference_limits_t *limits) {
    const int32_t before = reference->velocity, a = limits->acceleration, most = limits->speed;
    const tl_count_q8_t ahead = target_speed > 0 ? reference->high - reference->q : reference->q - reference->low;
    if (ahead <= limits->stop) {
        target_speed = 0; // it will have to stop at the end: caught up with as if it stood
    }
    const int32_t relative = before - target_speed;
    const int32_t way = tl_clamp(apart, -FAR, FAR) * 256 - (int32_t)(reference->fraction >> 8) - (target_speed >> 8);
    const int32_t velocity =
        target_speed + (way >= 0 ? approach(relative, way, limits) : -approach(-relative, -way, limits));
    if (velocity > most) { // where it was lowered meanwhile, as fast as the limits allow
        return before - a > most ? before - a : most;
    }
    return velocity < -most ? (before + a < -most ? before + a : -most) : velocity;
}

TL_FAST void tl_reference_step(tl_reference_t *reference, tl_count_q8_t wanted, const tl_reference_limits_t *limits) {
    const tl_count_q8_t target = tl_clamp(wanted, reference->low, reference->high);
    reference->clamped = target != wanted;
    const int32_t most_q8 = limits->speed >> 16;
    const int32_t target_speed = tl_clamp(target - reference->target, -most_q8, most_q8) * 65536;
    reference->target = target;
    const tl_count_q8_t apart = target - reference->q;
    if (apart < NEAR && apart > -NEAR) {
        const int32_t a = limits->acceleration, before = reference->velocity;
        const int32_t distance = apart * 65536 - (int32_t)reference->fraction;
        const int32_t lag = distance - target_speed; // what is left if both go on as they do
        const int32_t half = target_speed + (lag >> 1);
        int32_t velocity = distance; // there within this tick, and as fast as the target
        bool follows = within(lag, a) && within(distance - before, a);
        if (!follows && within(lag, 2 * a) && within(half - before, a)) {
            velocity = half; // the last stretch in two ticks, whatever its length
            follows = true;
        }
        if (follows) {
            velocity = tl_clamp(velocity, -limits->speed, limits->speed);
            reference->behind = !within(distance - velocity, 1 << 24);
            const bool up = velocity > 0;
            const tl_count_q8_t room = up ? reference->high - reference->q : reference->q - reference->low;
            if (room <= limits->stop && velocity != 0) { // no faster than can be stopped before the end
                const int32_t fraction = (int32_t)(reference->fraction >> 8); // in favour: else no end is quite reached
                const int32_t room_q16 = tl_clamp(room, -FAR, FAR) * 256 + (up ? -fraction : fraction + 1);
                const int32_t speed = up ? velocity : -velocity;
                if (speed > a ? stopping(speed, limits) > room_q16 >> limits->way_down : speed >> 8 > room_q16) {
                    velocity = up ? (before > a ? before - a : 0) : (before < -a ? before + a : 0);
                }
            }
            advance(reference, velocity);
            return;
        }
    }
    reference->behind = true;
    advance(reference, catch_up(reference, target_speed, apart, limits));
}

TL_FAST bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits) {
    const int32_t before = reference->velocity;
    advance(reference, before - tl_clamp(before, -limits->acceleration, limits->acceleration));
    reference->target = reference->q;
    return reference->velocity == 0;
}

TL_FAST int32_t tl_reference_speed(int32_t speed, uint32_t rate_hz) {
    const uint32_t of = (uint32_t)tl_clamp(speed, 1, TL_REFERENCE_SPEED_MAX);
    return (int32_t)((of / rate_hz << 16) + (of % rate_hz << 16) / rate_hz);
}

tl_reference_limits_t tl_reference_limits(int32_t speed, int32_t acceleration, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    acceleration = tl_clamp(acceleration, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    const int64_t per_tick2 = ((int64_t)acceleration << 16) / (rate * rate);
    tl_reference_limits_t limits = {
        .speed = tl_reference_speed(speed, rate_hz),
        .acceleration = per_tick2 > ACCELERATION_MAX ? ACCELERATION_MAX : (int32_t)per_tick2,
    };
    // A speed relative to the target's is at most twice the limit.
    while ((2 * (int64_t)limits.speed + limits.acceleration) >> limits.speed_down >= 32768) {
        limits.speed_down++;
    }
    limits.acceleration_scaled = limits.acceleration >> limits.speed_down;
    // v (v + a) / 2a, of speeds v 2^speed_down: 2^(2 speed_down - 25) / a in counts. As 2^(bits + 15) / a has 16 bits:
    uint32_t bits = 0;
    while (limits.acceleration >> bits != 0) {
        bits++;
    }
    limits.ratio = (uint32_t)(((uint64_t)1 << (bits + 15U)) / (uint32_t)limits.acceleration) + 1U; // 65537 at most
    const uint32_t down =
        24U + bits - 2U * limits.speed_down; // in counts it would lose this much, and so has it to spare
    limits.ratio_down = down > 16U ? down - 16U : 0U;
    limits.way_down = down > 16U ? 0U : 16U - down;
    limits.whole_ticks = (limits.acceleration >> (11U + limits.way_down)) + 3; // and what is cut off, here and there
    const int64_t ticks = limits.speed / limits.acceleration + 2;
    const int64_t stop = (ticks * (limits.speed / 2 + 1)) >> 16;
    limits.stop = stop < INT32_MAX ? (int32_t)stop : INT32_MAX;
    return limits;
}
