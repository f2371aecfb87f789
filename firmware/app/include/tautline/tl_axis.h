/// The state of one axis: where its motor is, where it should be, and what is wrong. Data alone; who changes what:
///
/// - tl_axis_step.h, the control step: on every tick encoder, actuator, path; once a millisecond, in TL_AXIS_JOBS jobs
///   that are spread over its ticks, the plan (tl_axis_plan.h). Planning looks ahead, so that a set-point with a time
///   is met at that time.
/// - tl_axis_watch.h and tl_axis_guard.h, once a millisecond each, after the motors have their duty: forward play,
///   history and telemetry; what puts an axis into its safe state, checks it and homes it.
/// - tl_stop.h, once a millisecond for all axes: what stops those that are well themselves.
/// - tl_axis_rest.h: what brings an axis to rest, for all of these.
/// - tl_axis_ask.h: what a host asks for. The task, under the port's lock.
///
/// Any fault puts the axis into its safe state: motor off, compensation off, until the fault is cleared.
#ifndef TAUTLINE_TL_AXIS_H
#define TAUTLINE_TL_AXIS_H

#include "tautline/tl_actuator.h"
#include "tautline/tl_compensator.h"
#include "tautline/tl_history.h"
#include "tautline/tl_motion.h"
#include "tautline/tl_path.h"
#include "tautline/tl_play.h"
#include "tautline/tl_port.h"
#include "tautline/tl_stream.h"

#define TL_AXIS_PLAN_HZ 1000U ///< control_hz is a multiple of it
#define TL_AXIS_JOBS    5U
/// Fewest ticks of a millisecond that the build is for; with less than TL_AXIS_JOBS the last tick has several jobs.
#ifndef TL_AXIS_TICKS_MIN
#define TL_AXIS_TICKS_MIN 1U
#endif
/// Telemetry samples that wait for the task and the host, a power of two: half a second of them at 1 kHz.
#define TL_AXIS_SAMPLES   512U
#define TL_AXIS_RANGE_MAX (4000000 * TL_COUNT_ONE)

/// Once a millisecond: from what the host asks for to the reference.
typedef struct {
    tl_count_q8_t target; ///< of the reference
    tl_reference_t reference;
    tl_reference_limits_t travel;
    tl_reference_limits_t move; ///< `travel` with the speed of the move under way
    tl_count_q8_t move_target;
    uint32_t lead_us;        ///< by which the time that is planned for is ahead of the last tick of its millisecond
    tl_deg_q16_t c_next;     ///< demanded two milliseconds from now,
    tl_deg_q16_t c_last[2];  ///< in one, and now: half a millisecond after the watch, and before
    tl_motion_t *motion;     ///< while calibrating, else NULL
    tl_count_q8_t low, high; ///< position limits in force
    tl_us_t heard_us;        ///< when the last set-point came
    tl_stream_t stream;
} tl_axis_planned_t;

/// The tables at work.
typedef struct {
    tl_deg_q16_t c_ref; ///< demanded at the last watch
    int32_t strength_q15;
    int32_t takeup_accel; ///< counts/s2, as the table says; `lookup` has what the axis' limits leave of it
    tl_play_t play;
    tl_compensator_t compensator;
    tl_lookup_t lookup;
} tl_axis_tip_t;

#define TL_AXIS_LET_GO UINT32_MAX ///< of alone_ms: its time is over, whatever its settings say

/// What the guards remember.
typedef struct {
    int32_t current_ma;
    int32_t current_mean_q8;
    tl_count_q8_t still_q;   ///< where the motor was when it last moved
    tl_count_q8_t seen_q;    ///< what the encoder showed last
    tl_duty_q15_t seen_duty; ///< the drive when it last showed anything new, and the motor had come to rest
    uint16_t pushed_ms;      ///< that it pushed without a motion, less those that it did not
    uint16_t swing;          ///< how often the drive has lately changed from limit to limit
    uint8_t swing_way;       ///< the last limit, as tl_actuator_pushed() has it
    uint8_t supply_ms;       ///< too low
    uint8_t driver_ms;       ///< it reports a fault
    uint8_t estop_ms;        ///< the stop input is active (tl_stop.h)
    uint8_t still_ms;        ///< a move is at its target
    uint8_t pushed;          ///< limits of the last millisecond, likewise
    uint8_t off_ms;          ///< since it is off, up to 255
    uint8_t unseen_ms;       ///< that it has shown nothing new, in closed loop; up to 20
    bool blind;              ///< the motor may have moved without its encoder: off, its position is not known
    bool lapsed;             ///< the host is lost: a fault as soon as the axis rests
    bool homing;             ///< the move under way is the retreat from an end
    bool homed;              ///< the play does not know yet
    uint32_t patience;       ///< milliseconds until the sender, or the host, counts as lost
    uint32_t silence_ms;     ///< what patience begins from
    uint16_t supply_mv;
    int32_t fault_value;
    tl_us_t fault_us;
    uint32_t alone_ms;  ///< held without a word of a host
    tl_duty_q15_t sink; ///< drive that it loses each millisecond since that took too long; 0: it has not
} tl_axis_guarded_t;

/// A check of motor and encoder, or a search for an end, under way.
typedef struct {
    int8_t way;
    uint8_t phase;
    bool moved, right_scale;
    uint16_t ms;         ///< of the phase
    tl_duty_q15_t duty;  ///< of open loop: 0 but during a check
    tl_duty_q15_t most;  ///< of the check
    tl_count_q8_t from;  ///< where the phase began
    tl_count_q8_t mark;  ///< where measuring its speed began
    tl_count_q8_t least; ///< way of the measured time at the right scale,
    tl_count_q8_t far;   ///< and the greatest; 0: the gains do not say
    int32_t speed;       ///< as measured, counts/s
    tl_count_q8_t reach; ///< of homing,
    tl_count_q8_t end, retreat;
} tl_axis_trial_t;

typedef struct {
    uint32_t t_us; ///< low word
    tl_count_q8_t q, q_ref, p;
    tl_deg_q16_t c_ref, c_est;
    int16_t duty;
    uint16_t flags;
} tl_sample_t;

typedef struct {
    uint8_t divider; ///< of 1 kHz; 0 off
    uint8_t skipped;
    volatile uint32_t head, tail; ///< written, taken
    uint32_t dropped;
    tl_sample_t samples[TL_AXIS_SAMPLES];
} tl_axis_telemetry_t;

/// What every tick needs comes first: near offsets are cheap on a Cortex-M0+.
typedef struct {
    const tl_port_t *port;
    uint8_t index;
    uint8_t mode;   ///< tl_wire_mode_t
    uint8_t fault;  ///< tl_wire_fault_t
    uint8_t events; ///< bit n: tl_wire_event_code_t n came; the task clears it
    bool closed;    ///< the actuator follows the path; else it gets trial.duty
    bool silent;
    bool has_table;
    bool referenced; ///< the position is known
    bool checked;    ///< motor and encoder agree
    uint16_t noted;  ///< tl_wire_flag_t of the last millisecond
    uint32_t ticks;  ///< of a millisecond
    uint32_t slot;   ///< ticks since the millisecond began
    tl_count_q8_t q; ///< position
    tl_path_t path;  ///< where it should be now
    tl_actuator_t motor;
    tl_axis_planned_t plan;
    tl_axis_guarded_t guard;
    tl_axis_trial_t trial;
    tl_history_t *history;   ///< while calibrating, else NULL
    tl_wire_limits_t limits; ///< in force; the table's are respected, too
    tl_wire_settings_t settings;
    tl_axis_telemetry_t telemetry;
    tl_axis_tip_t tip;
} tl_axis_t;

static inline bool tl_axis_is_following(const tl_axis_t *axis) {
    return axis->mode == TL_WIRE_MODE_FOLLOW_MOTOR || axis->mode == TL_WIRE_MODE_FOLLOW_TIP;
}

/// Control step, or the task under the port's lock.
static inline void tl_axis_event(tl_axis_t *axis, tl_wire_event_code_t code) {
    axis->events = (uint8_t)(axis->events | (1U << code));
}

#endif
