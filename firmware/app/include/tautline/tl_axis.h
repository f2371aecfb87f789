/// One axis: where its motor is, where it should be, what drives it there, and what is wrong.
///
/// tl_axis_step() is the control step (tl_axis_step.c, with all that it needs); everything else belongs to the task
/// and must be called under the port's lock. Any fault puts the axis into its safe state: motor off, compensation off,
/// until the fault is cleared.
///
/// The control step has two rates. On every tick: encoder, servo, duty, and whether the motor follows. Once a
/// millisecond, in TL_AXIS_JOBS jobs that are spread over its ticks, it plans: set-points, inverse with take-up, limits
/// on speed and acceleration. tl_path.h joins what is planned. Planning looks ahead, so that a set-point with a time is
/// met at that time. Also once a millisecond, but after the motors have their duty, comes tl_axis_watch().
#ifndef TAUTLINE_TL_AXIS_H
#define TAUTLINE_TL_AXIS_H

#include "tautline/tl_compensator.h"
#include "tautline/tl_history.h"
#include "tautline/tl_motion.h"
#include "tautline/tl_path.h"
#include "tautline/tl_play.h"
#include "tautline/tl_port.h"
#include "tautline/tl_servo.h"
#include "tautline/tl_stream.h"

#define TL_AXIS_PLAN_HZ 1000U ///< control_hz is a multiple of it
#define TL_AXIS_JOBS    5U
/// Fewest ticks of a millisecond that the build is for; with less than TL_AXIS_JOBS the last tick has several jobs.
#ifndef TL_AXIS_TICKS_MIN
#define TL_AXIS_TICKS_MIN 1U
#endif
#define TL_AXIS_SAMPLES        16U     ///< telemetry samples waiting for the task, a power of two
#define TL_AXIS_SILENCE_US     100000U ///< default
#define TL_AXIS_SILENCE_MAX_US 60000000U
#define TL_AXIS_AHEAD_US       10000000U ///< a set-point may lie this far ahead
#define TL_AXIS_RANGE_MAX      (4000000 * TL_COUNT_ONE)

typedef struct {
    uint32_t t_us; ///< low word
    tl_count_q8_t q, q_ref, p;
    tl_deg_q16_t c_ref, c_est;
    int16_t duty;
    uint16_t flags;
} tl_sample_t;

/// What every tick needs comes first: near offsets are cheap on a Cortex-M0+.
typedef struct {
    const tl_port_t *port;
    uint8_t index;
    uint8_t mode;   ///< tl_wire_mode_t
    uint8_t fault;  ///< tl_wire_fault_t
    uint8_t events; ///< bit n: tl_wire_event_code_t n came; the task clears it
    bool silent;
    bool has_table;
    uint16_t noted;  ///< tl_wire_flag_t of the last millisecond
    uint32_t ticks;  ///< of a millisecond
    uint32_t slot;   ///< ticks since the millisecond began
    int32_t encoder; ///< as read last, counts
    tl_count_q8_t q; ///< position
    tl_duty_q15_t duty;
    tl_path_t path;          ///< where it should be now
    tl_wire_limits_t limits; ///< as set; the table's are respected, too
    tl_servo_t servo;

    tl_count_q8_t target; ///< of the reference
    tl_reference_t reference;
    tl_reference_limits_t travel;
    tl_reference_limits_t move; ///< `travel` with the speed of the move under way
    tl_count_q8_t move_target;
    uint32_t lead_us;       ///< by which the time that is planned for is ahead of the last tick of its millisecond
    uint32_t patience;      ///< milliseconds until a follower's sender counts as silent
    tl_deg_q16_t c_next;    ///< demanded two milliseconds from now,
    tl_deg_q16_t c_last[2]; ///< in one, and now: half a millisecond after the watch, and before
    tl_deg_q16_t c_ref;     ///< demanded at the last watch
    tl_motion_t *motion;    ///< while calibrating, else NULL
    tl_history_t *history;  ///< likewise
    tl_play_t play;
    tl_compensator_t compensator;

    tl_count_q8_t low, high; ///< position limits in force
    int32_t current_ma;
    int32_t current_mean_q8;
    tl_us_t fault_us;
    int32_t strength_q15;
    int32_t takeup_accel; ///< counts/s2, as the table says; `lookup` has what the axis' limits leave of it
    uint32_t silence_us;
    tl_us_t heard_us; ///< when the last set-point came

    uint8_t divider; ///< of 1 kHz telemetry; 0 off
    uint8_t skipped;
    volatile uint32_t sample_head, sample_tail; ///< written, taken
    uint32_t samples_dropped;
    tl_stream_t stream;
    tl_sample_t samples[TL_AXIS_SAMPLES];
    tl_lookup_t lookup;
} tl_axis_t;

/// Off, at position 0, without a table, with default limits and gains.
void tl_axis_init(tl_axis_t *axis, const tl_port_t *port, uint8_t index);

/// The control step: reads the encoder, drives the motor. At port->control_hz.
void tl_axis_step(tl_axis_t *axis);

static inline bool tl_axis_is_following(const tl_axis_t *axis) {
    return axis->mode == TL_WIRE_MODE_FOLLOW_MOTOR || axis->mode == TL_WIRE_MODE_FOLLOW_TIP;
}

static inline void tl_axis_event(tl_axis_t *axis, tl_wire_event_code_t code) {
    axis->events = (uint8_t)(axis->events | (1U << code));
}

static inline void tl_axis_drive(tl_axis_t *axis, tl_duty_q15_t duty) {
    const tl_port_t *port = axis->port;
    axis->duty = duty;
    port->drive(port->context, axis->index, duty);
}

/// Forward play, encoder history, current limit, telemetry: after the step in which axis->slot came back to 0.
void tl_axis_watch(tl_axis_t *axis, tl_us_t now_us);

/// Parts of the control step: set-points in, reference out.
void tl_axis_listen(tl_axis_t *axis);
void tl_axis_plan(tl_axis_t *axis);

/// At rest where the motor is: what switching on begins from.
void tl_axis_rest(tl_axis_t *axis);

/// tl_wire_flag_t now, and those that came within the last millisecond.
uint16_t tl_axis_flags(const tl_axis_t *axis);

/// Takes the content of axis->lookup into use, or none. The motor must be off.
void tl_axis_use_table(tl_axis_t *axis, bool has_table);

/// Motor off at once, compensation off; the first fault stays the one that is reported.
void tl_axis_fail(tl_axis_t *axis, tl_wire_fault_t fault, tl_us_t now_us);

/// Comes to rest within limits; then holds, or switches off.
void tl_axis_stop(tl_axis_t *axis, bool then_off);

/// A follower's sender is gone: it comes to rest and holds. Nothing in any other mode.
void tl_axis_silence(tl_axis_t *axis);

/// A reason, or 0 when done. Preconditions that the axis itself knows are checked here.
uint8_t tl_axis_enable(tl_axis_t *axis);
uint8_t tl_axis_move(tl_axis_t *axis, tl_count_q8_t target, int32_t speed_q8_s);
uint8_t tl_axis_follow(tl_axis_t *axis, bool tip, uint8_t compensation, uint32_t silence_us, tl_us_t now_us);
uint8_t tl_axis_set_point(tl_axis_t *axis, int32_t value, tl_us_t at_us, tl_us_t now_us, bool *late);
uint8_t tl_axis_calibrate(tl_axis_t *axis, tl_motion_t *motion, tl_history_t *history);
uint8_t tl_axis_set_limits(tl_axis_t *axis, const tl_wire_limits_t *limits);
uint8_t tl_axis_set_servo(tl_axis_t *axis, const tl_servo_gains_t *gains);
uint8_t tl_axis_set_position(tl_axis_t *axis, tl_count_q8_t q);
void tl_axis_set_strength(tl_axis_t *axis, int32_t strength_q15);

#endif
