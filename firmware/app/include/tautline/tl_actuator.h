/// The seam between an axis and what moves it: the axis says where it should be, the actuator measures and drives.
///
/// Everything above (planning, compensation, guards, calibration, telemetry) knows an actuator by the functions below
/// alone. This one is a DC motor with a quadrature encoder under the position servo of tl_servo.h. A build for another
/// kind of actuator (a drive with a position loop of its own, a stepper) names a header with the same type and
/// functions in TL_ACTUATOR_HEADER, in quotes; it is compiled in, as a call through a pointer would cost the control
/// step a tenth.
///
/// All are for the control step, but for tl_actuator_init() and tl_actuator_reset(). Positions are counts Q8. The
/// fields `duty`, `limit` and `jump` belong to the seam, too.
#ifndef TAUTLINE_TL_ACTUATOR_H
#define TAUTLINE_TL_ACTUATOR_H

#ifdef TL_ACTUATOR_HEADER
#include TL_ACTUATOR_HEADER
#else

#include "tautline/tl_port.h"
#include "tautline/tl_servo.h"
#include "tautline/tl_sight.h"

#define TL_ACTUATOR_JUMP 2048U ///< counts in one step: above any motor's speed, below a glitch's

typedef struct {
    const tl_port_t *port;
    uint32_t index;      ///< of the port's motors; a word, as those are cheap at this distance
    int32_t encoder;     ///< as read last, counts
    tl_duty_q15_t duty;  ///< as driven
    tl_duty_q15_t limit; ///< most drive in closed loop
    tl_servo_t servo;
    tl_sight_t sight;
    int32_t jump; ///< what tl_actuator_measure() refused last, counts; behind what every step needs
} tl_actuator_t;

static inline void tl_actuator_drive(tl_actuator_t *actuator, tl_duty_q15_t duty) {
    const tl_port_t *port = actuator->port;
    actuator->duty = duty;
    port->drive(port->context, (uint8_t)actuator->index, duty);
}

/// Off, at rest; what the encoder shows is position 0.
static inline void tl_actuator_init(tl_actuator_t *actuator, const tl_port_t *port, uint8_t index) {
    actuator->port = port;
    actuator->index = index;
    actuator->encoder = port->encoder(port->context, index);
    tl_actuator_drive(actuator, 0);
}

/// Adds what the motor has moved since the last call to *q. False: more than a motor can, in `jump`; *q is left alone.
static inline bool tl_actuator_measure(tl_actuator_t *actuator, tl_count_q8_t *q) {
    const int32_t encoder = actuator->port->encoder(actuator->port->context, (uint8_t)actuator->index);
    const int32_t moved = (int32_t)((uint32_t)encoder - (uint32_t)actuator->encoder);
    actuator->encoder = encoder;
    if ((uint32_t)moved + TL_ACTUATOR_JUMP >= 2U * TL_ACTUATOR_JUMP) {
        actuator->jump = moved;
        return false;
    }
    *q += moved * TL_COUNT_ONE;
    return true;
}

/// The same after a pause of `elapsed_us`, in which it may have been turned by a count each microsecond.
static inline bool tl_actuator_measure_late(tl_actuator_t *actuator, uint32_t elapsed_us, tl_count_q8_t *q) {
    const int32_t encoder = actuator->port->encoder(actuator->port->context, (uint8_t)actuator->index);
    const int32_t moved = (int32_t)((uint32_t)encoder - (uint32_t)actuator->encoder);
    const uint32_t most = TL_ACTUATOR_JUMP + (elapsed_us < 1000000U ? elapsed_us : 1000000U);
    actuator->encoder = encoder;
    if ((uint32_t)moved + most >= 2U * most) {
        actuator->jump = moved;
        return false;
    }
    *q += moved * TL_COUNT_ONE;
    return true;
}

/// As measured, counts/s. Task.
static inline int32_t tl_actuator_speed(const tl_actuator_t *actuator) {
    return (int32_t)(((int64_t)actuator->servo.velocity * (int32_t)actuator->port->control_hz) >> 24);
}

/// The path has begun another millisecond.
static inline void tl_actuator_begin(tl_actuator_t *actuator, const tl_path_t *path) {
    tl_servo_feed(&actuator->servo, path);
}

/// Closed loop, one tick: the motor is at `q`, path->q is where it should be.
static inline void tl_actuator_set(tl_actuator_t *actuator, tl_count_q8_t q, const tl_path_t *path) {
    tl_actuator_drive(actuator, tl_servo_step(&actuator->servo, q, path, actuator->limit));
}

/// Open loop, one tick: `duty` as it is, 0 is off.
static inline void tl_actuator_push(tl_actuator_t *actuator, tl_count_q8_t q, tl_duty_q15_t duty) {
    tl_servo_observe(&actuator->servo, q);
    tl_actuator_drive(actuator, duty);
}

/// Off at once, from either thread.
static inline void tl_actuator_release(tl_actuator_t *actuator) {
    tl_actuator_drive(actuator, 0);
}

/// Forgets what it has learnt: it rests at `q`.
static inline void tl_actuator_reset(tl_actuator_t *actuator, tl_count_q8_t q) {
    tl_servo_reset(&actuator->servo, q);
    tl_sight_reset(&actuator->sight, q);
}

/// Once a millisecond: whether what it measures is still what the motor does.
static inline bool tl_actuator_sees(tl_actuator_t *actuator, tl_count_q8_t q) {
    return tl_sight_step(&actuator->sight, q, actuator->duty);
}

/// Milliseconds since it was seen to go one way: one of its encoder's lines alone goes to and fro.
static inline int32_t tl_actuator_unseen_ms(const tl_actuator_t *actuator) {
    return actuator->sight.unseen_ms;
}

/// Its gains have changed. Task.
static inline void tl_actuator_know(tl_actuator_t *actuator) {
    tl_sight_configure(&actuator->sight, &actuator->servo.gains);
}

/// Since the last call: bit 0, it has been at its upper limit; bit 1, at its lower one.
static inline uint8_t tl_actuator_pushed(tl_actuator_t *actuator) {
    const uint32_t pushed = actuator->servo.pushed;
    actuator->servo.pushed = 0;
    return (uint8_t)pushed;
}

#endif
#endif
