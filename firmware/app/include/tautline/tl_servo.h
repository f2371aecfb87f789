/// Position servo of one axis: PI on position, D on speed, feed-forward of speed and friction; fixed point.
///
///     duty = kp e + ki int(e) + kd (v_ref - v) + kff v_ref + inertia dv_ref/dt + friction sign(v_ref)
///
/// v comes from an alpha-beta filter over the encoder (critically damped, TL_SERVO_FILTER_HZ). The integral is held
/// while the drive is saturated, and at rest within a count of the reference, so that static friction makes no limit
/// cycle. Cost of a step: eleven 32-bit products, no division; about 200 cycles on a Cortex-M0+. Control step only.
#ifndef TAUTLINE_TL_SERVO_H
#define TAUTLINE_TL_SERVO_H

#include "tautline/tl_fixed.h"

#define TL_SERVO_FILTER_HZ 80
#define TL_SERVO_GAIN_MAX  32767         ///< of each gain
#define TL_SERVO_SPEED_MAX (30000 * 256) ///< Q8 counts/s

/// Gains in duty Q15, each 0 to TL_SERVO_GAIN_MAX.
typedef struct {
    int32_t proportional; ///< per count
    int32_t integral;     ///< per count and second
    int32_t derivative;   ///< per 1000 counts/s
    int32_t feed_forward; ///< per 1000 counts/s
    int32_t inertia;      ///< per 100000 counts/s2
    tl_duty_q15_t friction;
} tl_servo_gains_t;

/// Fields are the module's own, but `velocity` (measured, counts/s Q8) and `saturated` may be read.
typedef struct {
    tl_servo_gains_t gains;
    int32_t integral_step; ///< duty Q29 for each Q8 count and tick
    int32_t derivative;    ///< duty Q15 for 1024 counts/s
    int32_t feed_forward;
    int32_t inertia;      ///< duty Q15 for 4096 (counts/s Q8) of change in a tick
    int32_t change_max;   ///< that `inertia` takes without overflow
    int32_t wanted;       ///< reference's speed in the last tick, counts/s Q8
    int32_t alpha, beta;  ///< filter, Q15; beta in (counts/s Q8) for each (count Q8)
    int32_t rate_inverse; ///< 1 / rate, Q24
    int32_t integral;     ///< duty Q29
    int32_t predicted;    ///< position, count Q8
    int32_t velocity;     ///< counts/s Q8
    bool saturated;
} tl_servo_t;

/// Sets gains for `rate_hz` (1000 to 10000); false where one is out of its range. Task; 32-bit divisions.
bool tl_servo_configure(tl_servo_t *servo, const tl_servo_gains_t *gains, uint32_t rate_hz);

/// Forgets integral and speed: the axis is at `q` and rests.
void tl_servo_reset(tl_servo_t *servo, tl_count_q8_t q);

/// Takes in the position only, while the motor is off. As tl_servo_step, without an output.
void tl_servo_watch(tl_servo_t *servo, tl_count_q8_t q);

/// One tick. `reference` and `velocity` (counts/s Q8, within TL_SERVO_SPEED_MAX) are where the axis should be and how
/// fast; `limit`: most drive, 0 to 32768. Positions within +-4 M counts. Returns the duty.
tl_duty_q15_t tl_servo_step(tl_servo_t *servo, tl_count_q8_t q, tl_count_q8_t reference, int32_t velocity,
                            tl_duty_q15_t limit);

#endif
