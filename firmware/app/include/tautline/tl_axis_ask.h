/// What is asked of one axis, by a host or at the start. The task; under the port's lock where nothing else is said.
/// What takes long is worked out before the control step is kept out, and only put into force meanwhile: for a few
/// microseconds, from memory that is fast (TL_FAST_LOCKED).
///
/// Functions that return a byte give a tl_wire_reason_t, or 0 when done. Preconditions that the axis itself knows are
/// checked here: no fault, referenced, checked, within settings and limits.
#ifndef TAUTLINE_TL_AXIS_ASK_H
#define TAUTLINE_TL_AXIS_ASK_H

#include "tautline/tl_axis.h"

#define TL_AXIS_FOLLOW_SILENCE_US 100000U  ///< default of followers,
#define TL_AXIS_MOVE_SILENCE_US   1000000U ///< and of other motions
#define TL_AXIS_SILENCE_MAX_US    60000000U
#define TL_AXIS_HOLD_MAX_MS       86400000U ///< of the settings
#define TL_AXIS_AHEAD_US          10000000U ///< a set-point may lie this far ahead

/// Off, at position 0 and not referenced, without a table, with the port's default settings.
void tl_axis_init(tl_axis_t *axis, const tl_port_t *port, uint8_t index);

/// What the port's hardware stands, and gains that hold a small gearmotor.
tl_wire_settings_t tl_axis_default_settings(const tl_port_t *port, uint8_t index);

/// A reason why settings cannot be, or 0.
uint8_t tl_axis_check_settings(const tl_port_t *port, const tl_wire_settings_t *settings);

/// Settings that have been checked, into force with their limits and gains. The motor is off.
void tl_axis_use_settings(tl_axis_t *axis, const tl_wire_settings_t *settings);

/// Takes the content of axis->tip.lookup into use, or none. The motor is off.
void tl_axis_use_table(tl_axis_t *axis, bool has_table);

uint8_t tl_axis_enable(tl_axis_t *axis);
uint8_t tl_axis_check(tl_axis_t *axis);
uint8_t tl_axis_move(tl_axis_t *axis, const tl_wire_move_t *request);
uint8_t tl_axis_jog(tl_axis_t *axis, const tl_wire_jog_t *request);
uint8_t tl_axis_home(tl_axis_t *axis, const tl_wire_home_t *request);
uint8_t tl_axis_set_point(tl_axis_t *axis, const tl_wire_set_point_t *request, tl_us_t now_us, bool *late);
uint8_t tl_axis_set_strength(tl_axis_t *axis, int32_t strength_q15);
uint8_t tl_axis_adapt(tl_axis_t *axis, const tl_wire_adapt_t *request);
uint8_t tl_axis_load(tl_axis_t *axis, const tl_wire_load_t *request);
uint8_t tl_axis_clear_fault(tl_axis_t *axis, tl_us_t now_us);

/// Not under the lock: these take it themselves, where they need it.
uint8_t tl_axis_follow(tl_axis_t *axis, const tl_wire_follow_t *request, tl_us_t now_us);
uint8_t tl_axis_calibrate(tl_axis_t *axis, tl_motion_t *motion, tl_history_t *history);
uint8_t tl_axis_set_limits(tl_axis_t *axis, const tl_wire_limits_t *limits);
uint8_t tl_axis_set_servo(tl_axis_t *axis, const tl_wire_servo_t *gains);
uint8_t tl_axis_set_position(tl_axis_t *axis, tl_count_q8_t q);

/// The host has said something: no motion lapses for now. Not under the lock.
void tl_axis_hear(tl_axis_t *axis);

#endif
