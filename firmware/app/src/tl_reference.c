#include "tautline/tl_reference.h"

#define ONE              ((int64_t)1 << 32)
#define ACCELERATION_MAX (ONE / 2 - 1) // counts/tick2: twice it fits 32 bits

tl_reference_limits_t tl_reference_limits(int32_t speed, int32_t acceleration, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    speed = tl_clamp(speed, 1, TL_REFERENCE_SPEED_MAX);
    acceleration = tl_clamp(acceleration, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    const int64_t per_tick = ((int64_t)acceleration << 24) / (rate * rate);
    return (tl_reference_limits_t){
        .speed = ((int64_t)speed << 24) / rate,
        .acceleration = per_tick < 1 ? 1 : (per_tick > ACCELERATION_MAX ? ACCELERATION_MAX : per_tick),
    };
}

void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q) {
    reference->position = (int64_t)q * (1 << 24);
    reference->velocity = 0;
    reference->target = reference->position;
    reference->behind = false;
}

static int64_t clamp64(int64_t x, int64_t most) { return x > most ? most : (x < -most ? -most : x); }

// Whether stopping from `speed` (counts/tick Q32) takes more than `distance` (counts Q32): v^2 > 2 a d, each side in Q32.
static bool must_brake(int64_t speed, int64_t distance, int64_t acceleration) {
    const uint64_t v = (uint64_t)(speed < 0 ? -speed : speed) >> 16;
    uint64_t d = (uint64_t)(distance < 0 ? -distance : distance) >> 16;
    d = d > UINT32_MAX ? UINT32_MAX : d;
    const uint64_t v32 = v > UINT32_MAX ? UINT32_MAX : v;
    return v32 * v32 > ((uint64_t)(uint32_t)(2 * acceleration) * (uint32_t)d) >> 16;
}

void tl_reference_step(tl_reference_t *reference, tl_count_q8_t q, const tl_reference_limits_t *limits) {
    const int64_t target = (int64_t)q * (1 << 24);
    const int64_t target_speed = clamp64(target - reference->target, limits->speed);
    const int64_t distance = target - reference->position;
    int64_t velocity = distance; // there within this tick
    if (velocity > limits->speed || velocity < -limits->speed || velocity - reference->velocity > limits->acceleration ||
        velocity - reference->velocity < -limits->acceleration) {
        const int64_t relative = reference->velocity - target_speed;
        const bool closing = (relative > 0) == (distance > 0);
        const bool brake = closing && must_brake(relative, distance, limits->acceleration);
        const bool up = (distance > 0) != brake;
        velocity = reference->velocity + (up ? limits->acceleration : -limits->acceleration);
        velocity = clamp64(velocity, limits->speed);
        // A lowered speed limit is reached by braking, too.
        if (velocity - reference->velocity > limits->acceleration) {
            velocity = reference->velocity + limits->acceleration;
        } else if (velocity - reference->velocity < -limits->acceleration) {
            velocity = reference->velocity - limits->acceleration;
        }
    }
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
