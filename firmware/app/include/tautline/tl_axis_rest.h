/// What brings an axis to rest. Control step, or the task under the port's lock.
#ifndef TAUTLINE_TL_AXIS_REST_H
#define TAUTLINE_TL_AXIS_REST_H

#include "tautline/tl_axis.h"

/// Enters a mode; the actuator follows the path in all but OFF and CHECK.
static inline void tl_axis_enter(tl_axis_t *axis, tl_wire_mode_t mode) {
    axis->mode = (uint8_t)mode;
    axis->closed = mode != TL_WIRE_MODE_OFF && mode != TL_WIRE_MODE_CHECK;
    axis->trial.duty = 0;
}

/// Motor off at once, without a fault.
void tl_axis_off(tl_axis_t *axis);

/// Motor off at once, compensation off; the first fault stays the one that is reported. `value`: what was measured.
/// Faults of the encoder, and of a motion that it did not show, take the reference with them, faults of the wiring the
/// check.
void tl_axis_fail(tl_axis_t *axis, tl_wire_fault_t fault, int32_t value, tl_us_t now_us);

/// Comes to rest within limits; then holds, or switches off. A check stops at once.
void tl_axis_stop(tl_axis_t *axis, bool then_off);

/// The sender or the host is gone: it comes to rest. A follower then holds; any other motion ends as a fault.
/// Its table is the calibrated one again.
void tl_axis_silence(tl_axis_t *axis);

/// At rest where the motor is: what switching on begins from.
void tl_axis_settle(tl_axis_t *axis);

/// Position limits in force: those set and the table's, where the position is known. An axis that stands outside may
/// stay there or come back, not go farther out.
void tl_axis_admit(tl_axis_t *axis);

#endif
