#include "tautline/tl_servo.h"

#include "tautline/tl_fast.h"

#define ACCELERATION_MAX (TL_REFERENCE_ACCELERATION_MAX / TL_COUNT_ONE) // counts/s2
#define SPEED_MAX        (TL_REFERENCE_SPEED_MAX / TL_COUNT_ONE)        // counts/s

static bool in_range(int32_t value) {
    return value >= 0 && value <= TL_WIRE_GAIN_MAX;
}

// Bits to drop, so that `most` (Q24) is left with 15.
static uint32_t down_to_15_bits(int64_t most) {
    uint32_t down = 0;
    while (most >> down >= 32768) {
        down++;
    }
    return down;
}

// A gain for `per` a second (or a second squared: rate^2), in units of 2^(down - 24) a tick, with 10 more bits.
static int32_t per_unit(int32_t gain, int64_t rate, uint32_t down, int32_t per) {
    return (int32_t)((((int64_t)gain * rate) << (10U + down)) / per >> 24);
}

bool tl_servo_configure(tl_servo_t *servo, const tl_servo_gains_t *gains, uint32_t rate_hz) {
    if (!in_range(gains->proportional) || !in_range(gains->integral) || !in_range(gains->derivative) ||
        !in_range(gains->feed_forward) || !in_range(gains->inertia) || !in_range(gains->friction)) {
        return false;
    }
    const int32_t rate = (int32_t)rate_hz;
    const int64_t rate2 = (int64_t)rate * rate;
    servo->gains = *gains;
    servo->proportional = gains->proportional;
    servo->integral_step = gains->integral * 64 / rate; // Q29 - Q15 - Q8 of the error = 2^6
    servo->speed_down = down_to_15_bits(((int64_t)SPEED_MAX << 24) / rate);
    servo->velocity_max = 32767 << servo->speed_down;
    servo->derivative = per_unit(gains->derivative, rate, servo->speed_down, 1000);
    servo->path_gain = servo->derivative + per_unit(gains->feed_forward, rate, servo->speed_down, 1000);
    servo->bend_down = down_to_15_bits(((int64_t)ACCELERATION_MAX << 25) / rate2);
    servo->bend_per_speed = servo->speed_down + 2U - servo->bend_down;
    servo->inertia = per_unit(gains->inertia, rate2, servo->bend_down, 100000);
    const int32_t omega = TL_SERVO_FILTER_HZ * 6283 / 1000; // rad/s
    servo->alpha = 2 * omega * 32768 / rate;
    servo->beta = (int32_t)(((int64_t)omega * omega << 16) / rate2);
    return true;
}

TL_FAST void tl_servo_reset(tl_servo_t *servo, tl_count_q8_t q) {
    servo->integral = 0;
    servo->predicted = (uint32_t)q << 8;
    servo->velocity = 0;
    servo->feed = servo->feed_step = 0;
    servo->pushed = 0;
}

TL_FAST void tl_servo_feed(tl_servo_t *servo, const tl_path_t *path) {
    // D on the path's speed belongs to it: the step takes D on the measured one off again. Gains have 17 bits here.
    const int32_t bend = path->bend >> servo->bend_down, gain = servo->path_gain;
    const int32_t way = path->speed != 0 ? path->speed : bend;
    int32_t feed = ((path->speed >> servo->speed_down >> 1) * gain >> 1) + (bend * servo->inertia >> 2);
    if (way != 0) {
        const int32_t friction = servo->gains.friction << 8;
        feed += way > 0 ? friction : -friction;
    }
    servo->feed = feed;
    servo->feed_step = bend * gain >> servo->bend_per_speed;
}
