#include "tautline/tl_servo.h"

#define ERROR_MAX (128 * TL_COUNT_ONE) // beyond it proportional drive is saturated at any useful gain
#define REST_BAND TL_COUNT_ONE

static bool in_range(int32_t value) {
    return value >= 0 && value <= TL_SERVO_GAIN_MAX;
}

bool tl_servo_configure(tl_servo_t *servo, const tl_servo_gains_t *gains, uint32_t rate_hz) {
    if (!in_range(gains->proportional) || !in_range(gains->integral) || !in_range(gains->derivative) ||
        !in_range(gains->feed_forward) || !in_range(gains->inertia) || !in_range(gains->friction)) {
        return false;
    }
    const int32_t rate = (int32_t)rate_hz;
    servo->gains = *gains;
    servo->integral_step = gains->integral * 64 / rate; // Q29 - Q15 - Q8 of the error = 2^6
    servo->derivative = gains->derivative * 128 / 125;
    servo->feed_forward = gains->feed_forward * 128 / 125;
    servo->inertia = gains->inertia * (rate / 10) / 625; // rate * 4096 / 256 / 100000
    servo->change_max = INT32_MAX / (servo->inertia + 1);
    const int32_t omega = TL_SERVO_FILTER_HZ * 6283 / 1000; // rad/s
    servo->alpha = 2 * omega * 32768 / rate;
    servo->beta = (omega * omega / rate) * 128; // Q7: omega^2 / rate is of the order of 50
    servo->rate_inverse = (1 << 24) / rate;
    return true;
}

void tl_servo_reset(tl_servo_t *servo, tl_count_q8_t q) {
    servo->integral = 0;
    servo->predicted = q;
    servo->velocity = 0;
    servo->wanted = 0;
    servo->saturated = false;
}

// x * factor / 2^shift for |x| and factor below 2^15 or a product below 2^31.
static int32_t scale(int32_t x, int32_t factor, unsigned shift) {
    return (x * factor) >> shift;
}

void tl_servo_watch(tl_servo_t *servo, tl_count_q8_t q) {
    // Speed below 2^23 (Q8), rate_inverse below 2^15: the product of speed / 2^7 fits.
    servo->predicted = tl_add_sat(servo->predicted, scale(servo->velocity / 128, servo->rate_inverse, 17));
    const int32_t residual = tl_sub_sat(q, servo->predicted);
    if (residual > ERROR_MAX || residual < -ERROR_MAX) { // set to another position, or lost: start again
        servo->predicted = q;
        servo->velocity = 0;
        return;
    }
    servo->predicted += scale(residual, servo->alpha, 15);
    const int32_t velocity = servo->velocity + scale(residual, servo->beta, 7);
    servo->velocity = tl_clamp(velocity, -TL_SERVO_SPEED_MAX, TL_SERVO_SPEED_MAX);
}

tl_duty_q15_t tl_servo_step(tl_servo_t *servo, tl_count_q8_t q, tl_count_q8_t reference, int32_t velocity,
                            tl_duty_q15_t limit) {
    tl_servo_watch(servo, q);
    const int32_t error = tl_clamp(reference - q, -ERROR_MAX, ERROR_MAX);
    const int32_t wanted = velocity / 256;
    const int32_t change = tl_clamp(velocity - servo->wanted, -servo->change_max, servo->change_max);
    servo->wanted = velocity;
    const int32_t lag = tl_clamp(wanted - servo->velocity / 256, -32767, 32767);
    int32_t sum = scale(error, servo->gains.proportional, 8) + scale(lag, servo->derivative, 10) +
                  scale(wanted, servo->feed_forward, 10) + scale(change, servo->inertia, 12) + (servo->integral >> 14);
    sum += velocity > 0 ? servo->gains.friction : (velocity < 0 ? -servo->gains.friction : 0);
    const tl_duty_q15_t driven = tl_clamp(sum, -limit, limit);
    servo->saturated = driven != sum;
    const bool winding = servo->saturated && (sum > 0) == (error > 0);
    const bool resting = velocity == 0 && error <= REST_BAND && error >= -REST_BAND;
    if (!winding && !resting) {
        const int32_t most = limit << 14;
        servo->integral = tl_clamp(servo->integral + error * servo->integral_step, -most, most);
    }
    return driven;
}
