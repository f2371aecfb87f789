/// The actuator of tl_actuator.h's seam for a drive with a position loop of its own, behind a field bus: it is told
/// where to be and says where it is. Positions are the port's, counts Q8; the servo holds gains and a speed, no more.
#ifndef TAUTLINE_HOSTED_ACTUATOR_H
#define TAUTLINE_HOSTED_ACTUATOR_H

#include "tautline/tl_port.h"
#include "tautline/tl_servo.h"

#define TL_ACTUATOR_JUMP (2048 * TL_COUNT_ONE) // in one tick: above any motor's speed, below a wrong answer's

typedef struct {
    const tl_port_t *port;
    uint32_t index;
    tl_count_q8_t encoder; // as read last
    tl_duty_q15_t duty;    // 0: a drive says none
    tl_duty_q15_t limit;
    tl_servo_t servo;
    int32_t jump;
    tl_count_q8_t goal; // where the drive is to be, in the axis' positions
    int32_t crept;      // of an open loop, counts Q24 beyond `goal`
    bool on;
} tl_actuator_t;

static inline void tl_actuator_init(tl_actuator_t *actuator, const tl_port_t *port, uint8_t index) {
    actuator->port = port;
    actuator->index = index;
    actuator->encoder = port->encoder(port->context, index);
    actuator->duty = 0;
    actuator->on = false;
}

static inline bool tl_actuator_measure_late(tl_actuator_t *actuator, uint32_t elapsed_us, tl_count_q8_t *q) {
    const tl_count_q8_t encoder = actuator->port->encoder(actuator->port->context, (uint8_t)actuator->index);
    const int32_t moved = (int32_t)((uint32_t)encoder - (uint32_t)actuator->encoder);
    const int32_t most = TL_ACTUATOR_JUMP + (int32_t)(elapsed_us < 1000000U ? elapsed_us : 1000000U) * TL_COUNT_ONE;
    actuator->encoder = encoder;
    if (moved > most || moved < -most) {
        actuator->jump = moved / TL_COUNT_ONE;
        return false;
    }
    *q += moved;
    return true;
}

static inline bool tl_actuator_measure(tl_actuator_t *actuator, tl_count_q8_t *q) {
    return tl_actuator_measure_late(actuator, 0, q);
}

static inline int32_t tl_actuator_speed(const tl_actuator_t *actuator) {
    return (int32_t)(((int64_t)actuator->servo.velocity * (int32_t)actuator->port->control_hz) >> 24);
}

static inline void tl_actuator_begin(tl_actuator_t *actuator, const tl_path_t *path) {
    (void)actuator;
    (void)path;
}

static inline void tl_actuator_set(tl_actuator_t *actuator, tl_count_q8_t q, const tl_path_t *path) {
    tl_servo_observe(&actuator->servo, q);
    actuator->goal = path->q;
    actuator->crept = 0;
    actuator->on = true;
}

/// Open loop: no drive here takes a duty. The goal creeps as fast as the gains say that a motor turns under it, so the
/// check of motor and encoder asks of a drive what it asks of a motor: the way, the direction, the scale.
static inline void tl_actuator_push(tl_actuator_t *actuator, tl_count_q8_t q, tl_duty_q15_t duty) {
    const tl_servo_gains_t *gains = &actuator->servo.gains;
    const int32_t size = duty < 0 ? -duty : duty;
    const int32_t beyond = size > gains->friction && gains->feed_forward > 0 ? size - gains->friction : 0;
    tl_servo_observe(&actuator->servo, q);
    if (!actuator->on) {
        actuator->goal = q;
        actuator->crept = 0;
        actuator->on = duty != 0;
        return;
    }
    if (beyond > 0) { // counts/s are 1000 beyond / feed_forward
        const int64_t per_s = ((int64_t)beyond * 1000 << 24) / gains->feed_forward;
        const int64_t way = per_s / (int32_t)actuator->port->control_hz;
        const int32_t most = 1 << 30, size_q24 = way < most ? (int32_t)way : most;
        actuator->crept += duty < 0 ? -size_q24 : size_q24;
    }
    actuator->goal += actuator->crept >> 16;
    actuator->crept &= 0xFFFF;
}

static inline void tl_actuator_release(tl_actuator_t *actuator) {
    actuator->on = false;
}

static inline void tl_actuator_reset(tl_actuator_t *actuator, tl_count_q8_t q) {
    tl_servo_reset(&actuator->servo, q);
}

// A drive looks after its own encoder.
static inline bool tl_actuator_sees(tl_actuator_t *actuator, tl_count_q8_t q) {
    (void)actuator;
    (void)q;
    return true;
}

static inline int32_t tl_actuator_unseen_ms(const tl_actuator_t *actuator) {
    (void)actuator;
    return 0;
}

static inline void tl_actuator_know(tl_actuator_t *actuator) {
    (void)actuator;
}

static inline uint8_t tl_actuator_pushed(tl_actuator_t *actuator) {
    (void)actuator;
    return 0;
}

#endif
