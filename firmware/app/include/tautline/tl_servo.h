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

#define TL_SERVO_FILTER_HZ 80
#define TL_SERVO_GAIN_MAX  32767 ///< of each gain

/// Gains in duty Q15, each 0 to TL_SERVO_GAIN_MAX.
typedef struct {
    int32_t proportional; ///< per count
    int32_t integral;     ///< per count and second
    int32_t derivative;   ///< per 1000 counts/s
    int32_t feed_forward; ///< per 1000 counts/s
    int32_t inertia;      ///< per 100000 counts/s2
    tl_duty_q15_t friction;
} tl_servo_gains_t;

/// Fields are the module's own, but `gains` and `saturated` may be read.
typedef struct {
    uint32_t predicted;  ///< position, counts Q16, modulo 2^32: only differences count
    int32_t velocity;    ///< as measured, counts/tick Q24
    int32_t alpha, beta; ///< of the filter: Q15; counts/tick Q24 for a count Q8
    int32_t proportional;
    uint32_t speed_down;  ///< bits that leave a speed in 15
    int32_t derivative;   ///< duty Q25 for such a unit
    int32_t feed_forward; ///< likewise
    uint32_t bend_down;   ///< bits that leave a change of speed in 15
    int32_t inertia;      ///< duty Q25 for such a unit
    tl_duty_q15_t friction;
    int32_t integral_step; ///< duty Q29 for each Q8 count and tick
    int32_t integral;      ///< duty Q29
    bool saturated;        ///< the drive was at its limit; for the reader to clear
    tl_servo_gains_t gains;
} tl_servo_t;

/// Sets gains for `rate_hz` (1000 to 10000); false where one is out of its range. Task; 64-bit divisions.
bool tl_servo_configure(tl_servo_t *servo, const tl_servo_gains_t *gains, uint32_t rate_hz);

/// Forgets integral and speed: the axis is at `q` and rests.
void tl_servo_reset(tl_servo_t *servo, tl_count_q8_t q);

/// Takes in the position only, while the motor is off. As tl_servo_step, without an output.
void tl_servo_watch(tl_servo_t *servo, tl_count_q8_t q);

/// One tick, with the motor at `q` and the path where it should be; `limit`: most drive, 0 to 32768. Positions within
/// +-4 M counts. Returns the duty.
tl_duty_q15_t tl_servo_step(tl_servo_t *servo, tl_count_q8_t q, const tl_path_t *path, tl_duty_q15_t limit);

#endif
