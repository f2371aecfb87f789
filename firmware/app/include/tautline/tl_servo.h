/// Position servo of one axis: PI on position, D on speed, feed-forward of speed, inertia and friction; fixed point.
///
///     duty = kp e + ki int(e) + kd (v_ref - v) + kff v_ref + inertia dv_ref/dt + friction sign(v_ref)
///
/// v comes from an alpha-beta filter over the encoder (critically damped, TL_SERVO_FILTER_HZ). The integral is held
/// while the drive is saturated, and at rest within a count of the reference, so that static friction makes no limit
/// cycle. Cost of a step: eight 32-bit products, no division; about 170 cycles on a Cortex-M0+ (-O2). Control step
/// only.
#ifndef TAUTLINE_TL_SERVO_H
#define TAUTLINE_TL_SERVO_H

#include "tautline/tl_path.h"
#include "tautline/tl_wire.h"

#define TL_SERVO_FILTER_HZ 80
#define TL_SERVO_ERROR_MAX (128 * TL_COUNT_ONE) ///< beyond it proportional drive is saturated at any useful gain
#define TL_SERVO_REST_BAND TL_COUNT_ONE

/// Gains in duty Q15, each 0 to TL_WIRE_GAIN_MAX.
typedef struct {
    int32_t proportional; ///< per count
    int32_t integral;     ///< per count and second
    int32_t derivative;   ///< per 1000 counts/s
    int32_t feed_forward; ///< per 1000 counts/s
    int32_t inertia;      ///< per 100000 counts/s2
    tl_duty_q15_t friction;
} tl_servo_gains_t;

/// Fields are the module's own, but `gains` and `pushed` may be read.
typedef struct {
    uint32_t predicted;   ///< position, counts Q16, modulo 2^32: only differences count
    int32_t velocity;     ///< as measured, counts/tick Q24
    int32_t velocity_max; ///< what a speed in 15 bits can be
    int32_t alpha, beta;  ///< of the filter: Q15; counts/tick Q24 for a count Q8
    int32_t feed;         ///< duty Q23 that the path asks for by itself, and
    int32_t feed_step;    ///< its change a tick
    int32_t proportional;
    uint32_t speed_down;     ///< bits that leave a speed in 15
    int32_t derivative;      ///< duty Q25 for such a unit
    int32_t integral_step;   ///< duty Q29 for each Q8 count and tick
    int32_t integral;        ///< duty Q29
    uint32_t pushed;         ///< 1: the drive was at its upper limit, 2: at its lower one; for the reader to clear
    int32_t path_gain;       ///< duty Q25 for a unit of the path's speed: feed-forward and D
    uint32_t bend_down;      ///< bits that leave a change of speed in 14
    uint32_t bend_per_speed; ///< further ones to a unit of speed, and two
    int32_t inertia;         ///< duty Q25 for a unit of change
    tl_servo_gains_t gains;
} tl_servo_t;

/// Sets gains for `rate_hz` (1000 to 10000); false where one is out of its range. Task; 64-bit divisions.
bool tl_servo_configure(tl_servo_t *servo, const tl_servo_gains_t *gains, uint32_t rate_hz);

/// Forgets integral and speed: the axis is at `q` and rests.
void tl_servo_reset(tl_servo_t *servo, tl_count_q8_t q);

/// The filter follows the encoder, alone while the motor is off.
static inline void tl_servo_observe(tl_servo_t *servo, tl_count_q8_t q) {
    const uint32_t position = (uint32_t)q << 8;
    const uint32_t predicted = servo->predicted + (uint32_t)(servo->velocity >> 8);
    const int32_t residual = (int32_t)(position - predicted) >> 8;
    if (residual > TL_SERVO_ERROR_MAX ||
        residual < -TL_SERVO_ERROR_MAX) { // set to another position, or lost: start again
        servo->predicted = position;
        servo->velocity = 0;
        return;
    }
    servo->predicted = predicted + (uint32_t)(residual * servo->alpha >> 7);
    const int32_t most = servo->velocity_max;
    servo->velocity = tl_clamp(servo->velocity + residual * servo->beta, -most, most);
}

/// The path has begun another millisecond: what it asks for by its speed and acceleration alone. Three products.
void tl_servo_feed(tl_servo_t *servo, const tl_path_t *path);

/// One tick, with the motor at `q` and the path where it should be; `limit`: most drive, 0 to 32768. Positions within
/// +-4 M counts. Returns the duty. Inline, as a call would cost a fifth of it.
static inline tl_duty_q15_t tl_servo_step(tl_servo_t *servo, tl_count_q8_t q, const tl_path_t *path,
                                          tl_duty_q15_t limit) {
    tl_servo_observe(servo, q);
    // Each product is below 2^31: an error or a speed in 15 bits by a gain in 16.
    const int32_t feed = servo->feed;
    servo->feed = feed + servo->feed_step;
    int32_t sum = (feed >> 8) - ((servo->velocity >> servo->speed_down) * servo->derivative >> 10);
    const int32_t error = tl_clamp(path->q - q, -TL_SERVO_ERROR_MAX, TL_SERVO_ERROR_MAX);
    const int32_t integral = servo->integral;
    sum += (error * servo->proportional >> 8) + (integral >> 14);
    if (sum > limit || sum < -limit) {
        servo->pushed |= sum > 0 ? 1U : 2U;
        sum = sum > 0 ? limit : -limit;
        if ((sum > 0) == (error > 0)) {
            return sum;
        }
    }
    if (path->speed != 0 || error > TL_SERVO_REST_BAND || error < -TL_SERVO_REST_BAND) {
        const int32_t most = limit << 14;
        servo->integral = tl_clamp(integral + error * servo->integral_step, -most, most);
    }
    return sum;
}

#endif
