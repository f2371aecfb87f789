#include "tautline/tl_reference.h"

#define ONE              ((int64_t)1 << 32)
#define ACCELERATION_MAX (ONE / 2 - 1) // counts/tick2: twice it fits 32 bits

tl_reference_limits_t tl_reference_limits(int32_t speed, int32_t acceleration, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    speed = tl_clamp(speed, 1, TL_REFERENCE_SPEED_MAX);
    acceleration = tl_clamp(acceleration, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    const int64_t speed_q32 = ((int64_t)speed << 24) / rate;
    const int64_t per_tick = ((int64_t)acceleration << 24) / (rate * rate);
    const int64_t acceleration_q32 = per_tick < 1 ? 1 : (per_tick > ACCELERATION_MAX ? ACCELERATION_MAX : per_tick);
    const int64_t ticks = speed_q32 / acceleration_q32 + 2;
    return (tl_reference_limits_t){
        .speed = speed_q32,
        .acceleration = acceleration_q32,
        .stop = ticks > INT32_MAX ? INT64_MAX : (speed_q32 / 2 + 1) * ticks,
    };
}

void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q) {
    reference->position = (int64_t)q * (1 << 24);
    reference->velocity = 0;
    reference->target = reference->position;
    reference->behind = false;
}

static int64_t clamp64(int64_t x, int64_t most) { return x > most ? most : (x < -most ? -most : x); }

// Whether one tick at `speed` and then braking covers at most `distance`: v^2 + a v <= 2 a d (v in counts/tick Q32, d in
// counts Q32). Both sides in Q32; a distance beyond 65536 counts counts as that.
static bool can_stop(int64_t speed, int64_t distance, int64_t acceleration) {
    if (speed <= 0) {
        return true;
    }
    if (distance <= 0) {
        return false;
    }
    const uint64_t v = ((uint64_t)speed >> 16) + 1U; // rounded against us
    const uint64_t d = (uint64_t)distance >> 16;
    const uint32_t d32 = d > UINT32_MAX ? UINT32_MAX : (uint32_t)d;
    const uint32_t v32 = v > UINT32_MAX / 2U ? UINT32_MAX / 2U : (uint32_t)v;
    const uint32_t a32 = (uint32_t)acceleration;
    return (uint64_t)v32 * v32 + ((uint64_t)v32 * a32 >> 16) <= ((uint64_t)(2U * a32) * d32) >> 16;
}

// The speed towards a distance, both seen from the target, that this tick allows: faster, as before, or slower; the last
// stretch in two ticks, whatever its length.
static int64_t approach(int64_t speed, int64_t distance, int64_t acceleration) {
    const int64_t half = distance / 2;
    if (half <= acceleration && half - speed <= acceleration && speed - half <= acceleration) {
        return half;
    }
    if (can_stop(speed + acceleration, distance, acceleration)) {
        return speed + acceleration;
    }
    return can_stop(speed, distance, acceleration) ? speed : speed - acceleration;
}

// `velocity`, or braking where it would not end before the end of the range, `room` ahead.
static int64_t hold_back(int64_t velocity, int64_t before, int64_t room, const tl_reference_limits_t *limits) {
    if (velocity <= 0 || room > limits->stop || can_stop(velocity, room, limits->acceleration)) {
        return velocity;
    }
    return before > limits->acceleration ? before - limits->acceleration : 0;
}

void tl_reference_step(tl_reference_t *reference, tl_count_q8_t q, tl_count_q8_t low, tl_count_q8_t high,
                       const tl_reference_limits_t *limits) {
    const int64_t target = (int64_t)q * (1 << 24);
    const int64_t target_speed = clamp64(target - reference->target, limits->speed);
    const int64_t distance = target - reference->position;
    const int64_t lag = distance - target_speed; // what is left if both go on as they do
    const int64_t a = limits->acceleration;
    int64_t velocity = distance; // there within this tick, and as fast as the target
    if (velocity > limits->speed || velocity < -limits->speed || velocity - reference->velocity > a ||
        velocity - reference->velocity < -a || lag > a || lag < -a) {
        const int64_t relative = reference->velocity - target_speed;
        velocity = target_speed + (lag >= 0 ? approach(relative, lag, a) : -approach(-relative, -lag, a));
        velocity = clamp64(velocity, limits->speed);
        // A lowered speed limit is reached by braking, too.
        if (velocity - reference->velocity > a) {
            velocity = reference->velocity + a;
        } else if (velocity - reference->velocity < -a) {
            velocity = reference->velocity - a;
        }
    }
    const int64_t before = reference->velocity;
    velocity = velocity >= 0
                   ? hold_back(velocity, before, (int64_t)high * (1 << 24) - reference->position, limits)
                   : -hold_back(-velocity, -before, reference->position - (int64_t)low * (1 << 24), limits);
    reference->velocity = velocity;
    reference->position += velocity;
    reference->target = target;
    reference->behind = distance - velocity > ONE || distance - velocity < -ONE;
}

bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits) {
    if (reference->velocity > limits->acceleration) {
        reference->velocity -= limits->acceleration;
    } else if (reference->velocity < -limits->acceleration) {
        reference->velocity += limits->acceleration;
    } else {
        reference->velocity = 0;
    }
    reference->position += reference->velocity;
    reference->target = reference->position;
    return reference->velocity == 0;
}
