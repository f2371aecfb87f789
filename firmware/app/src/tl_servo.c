#include "tautline/tl_servo.h"

#define ERROR_MAX    (128 * TL_COUNT_ONE) // beyond it proportional drive is saturated at any useful gain
#define REST_BAND    TL_COUNT_ONE
#define VELOCITY_MAX (1 << 30) // 64 counts a tick

// The filter follows the encoder; static inline, as it is a part of every step.
static inline void observe(tl_servo_t *servo, tl_count_q8_t q) {
    const uint32_t position = (uint32_t)q << 8;
    const uint32_t predicted = servo->predicted + (uint32_t)(servo->velocity >> 8);
    const int32_t residual = (int32_t)(position - predicted) >> 8;
    if (residual > ERROR_MAX || residual < -ERROR_MAX) { // set to another position, or lost: start again
        servo->predicted = position;
        servo->velocity = 0;
        return;
    }
    servo->predicted = predicted + (uint32_t)(residual * servo->alpha >> 7);
    servo->velocity = tl_clamp(servo->velocity + residual * servo->beta, -VELOCITY_MAX, VELOCITY_MAX);
}

void tl_servo_watch(tl_servo_t *servo, tl_count_q8_t q) {
    observe(servo, q);
}

tl_duty_q15_t tl_servo_step(tl_servo_t *servo, tl_count_q8_t q, const tl_path_t *path, tl_duty_q15_t limit) {
    observe(servo, q);
    // Each product is below 2^31: an error in 15 bits, a speed or a change of it in 15 by a gain in 16.
    const int32_t speed = path->speed;
    const int32_t lag = tl_clamp((speed - servo->velocity) >> servo->speed_down, -32767, 32767);
    int32_t sum = lag * servo->derivative >> 10;
    sum += (speed >> servo->speed_down) * servo->feed_forward >> 10;
    sum += (path->bend >> servo->bend_down) * servo->inertia >> 10;
    if (speed != 0) {
        sum += speed > 0 ? servo->friction : -servo->friction;
    }
    const int32_t error = tl_clamp(path->q - q, -ERROR_MAX, ERROR_MAX);
    const int32_t integral = servo->integral;
    sum += (error * servo->proportional >> 8) + (integral >> 14);
    if (sum > limit || sum < -limit) {
        servo->saturated = true;
        sum = sum > 0 ? limit : -limit;
        if ((sum > 0) == (error > 0)) {
            return sum;
        }
    }
    if (speed != 0 || error > REST_BAND || error < -REST_BAND) {
        const int32_t most = limit << 14;
        servo->integral = tl_clamp(integral + error * servo->integral_step, -most, most);
    }
    return sum;
}
