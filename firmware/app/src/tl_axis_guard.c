#include "tautline/tl_axis_guard.h"

#include "tautline/tl_axis_rest.h"
#include "tautline/tl_fast.h"

#define STALL_WAY     (8 * TL_COUNT_ONE) // within it for the stall time, a pushing motor stands still
#define RUN_DOWN_MS   150U               // of a motor that is off: 0.11 s from full speed
#define SETTLES_MS    20U                // without a count after which it brakes no more
#define SETTLED       8                  // ms, of the mean drive while it brakes
#define STICKS        1311               // of drive beyond sliding friction, both ways: 4 %
#define DRIVER_MS     5U                 // a fault line that is low for as long is no glitch
#define SUPPLY_MS     20U                // a dip as long is more than a motor's start
#define SWING_STEP    160U               // a change from limit to limit, forgotten in 40 ms, and in
#define SWING_REST    4U                 // times as many where the path rests, where no change is called for;
#define SWING_MOST    1600U              // an oscillation: 12 changes at 100 Hz, 27 at 20; at rest 21 at 6 Hz
#define BOTH_WAYS     3U                 // tl_actuator_pushed()
#define STILL_MS      10U                // a move has arrived once it was at its target for so long
#define HOME_MS       100U               // pressing against an end
#define CHECK_STEP    64                 // of the ramp: the most drive is reached in as many milliseconds
#define CHECK_MOVED   (6 * TL_COUNT_ONE) // a motion
#define CHECK_LONGEST 400U               // to see one
#define CHECK_SETTLE  24U                // at the most drive, until its speed is measured, over
#define CHECK_MEASURE 32U                // so long
#define CHECK_BRAKE   100U               // and then to rest
#define CHECK_PUSH    2621               // drive beyond friction: 8 %

enum { CHECK_RAMP, CHECK_RUN, CHECK_TIME, CHECK_REST };

static bool fails(tl_axis_t *axis, bool bad, tl_wire_fault_t fault, int32_t value, tl_us_t now_us) {
    if (bad) {
        tl_axis_fail(axis, fault, value, now_us);
    }
    return bad;
}

static inline bool within(tl_count_q8_t way, tl_count_q8_t most) {
    return way <= most && way >= -most;
}

// -- what is measured, also while the motor is off ----------------------------------------------------------------

static inline uint8_t counted(uint8_t ms, bool is) {
    return is ? (uint8_t)(ms < UINT8_MAX ? ms + 1U : ms) : 0U;
}

// Returns the size of the current.
static int32_t measure(tl_axis_t *axis) {
    const tl_port_t *port = axis->port;
    tl_axis_guarded_t *guard = &axis->guard;
    guard->current_ma = tl_clamp(port->current_ma(port->context, axis->index), -100000, 100000);
    const int32_t magnitude = guard->current_ma < 0 ? -guard->current_ma : guard->current_ma;
    const int32_t difference = tl_clamp(magnitude * 256 - guard->current_mean_q8, -(1 << 20), 1 << 20);
    guard->current_mean_q8 += (difference * (32768 / 20)) >> 15; // first-order mean over 20 ms
    if (port->supply_mv != NULL) {
        guard->supply_mv = port->supply_mv(port->context);
        guard->supply_ms = counted(guard->supply_ms, guard->supply_mv < axis->settings.supply_low_mv);
    }
    if (port->driver_fault != NULL) {
        guard->driver_ms = counted(guard->driver_ms, port->driver_fault(port->context, axis->index));
    }
    return magnitude;
}

// -- what is to be seen of a motor, also while it runs down -------------------------------------------------------

// It was moving, must have gone on, and its encoder shows nothing: it has met something hard, or the encoder is lost.
// An end that is looked for is hard; a check finds out by itself; one whose drive sinks gives way; a motor that nobody
// has commissioned may be another than the gains are for; and one that has run down is turned by hand.
static bool is_lost(tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_guarded_t *guard = &axis->guard;
    const bool off = axis->mode == TL_WIRE_MODE_OFF;
    guard->off_ms = counted(guard->off_ms, off);
    if (tl_actuator_sees(&axis->motor, axis->q) || axis->settings.commissioned == 0U ||
        !(off ? guard->off_ms < RUN_DOWN_MS
              : axis->closed && axis->mode != TL_WIRE_MODE_HOME && guard->sink == 0 && guard->swing == 0)) {
        return false;
    }
    guard->blind = true;
    return fails(axis, true, off ? TL_WIRE_FAULT_EDGES : TL_WIRE_FAULT_STALL,
                 off ? tl_actuator_speed(&axis->motor) : axis->motor.duty, now_us);
}

// -- faults of a driven motor -----------------------------------------------------------------------------------

static bool electrical(tl_axis_t *axis, tl_us_t now_us) {
    const tl_axis_guarded_t *guard = &axis->guard;
    const int32_t most = axis->limits.current_ma;
    return fails(axis, guard->driver_ms >= DRIVER_MS, TL_WIRE_FAULT_DRIVER, 0, now_us) ||
           fails(axis, guard->supply_ms >= SUPPLY_MS, TL_WIRE_FAULT_SUPPLY, guard->supply_mv, now_us) ||
           fails(axis, most > 0 && guard->current_mean_q8 > most * 256, TL_WIRE_FAULT_CURRENT,
                 guard->current_mean_q8 >> 8, now_us);
}

// How long it has been pushing without a motion, less how long it has not. A driver at its own current limit pushes as
// hard as it can, too; and so does a drive that has grown, since the encoder last showed anything, by more than twice
// what the check has shown to overcome friction: whatever load it holds, it would have moved. In the dark is one that
// shows nothing and pushes, or whose drive has grown by more than would free one that stuck against the other way:
// within a count of its path nothing more is asked of it (tl_servo.h).
static void feel(tl_axis_t *axis, int32_t size_ma) {
    tl_axis_guarded_t *guard = &axis->guard;
    const tl_count_q8_t q = axis->q;
    const int32_t chops_ma = axis->port->driver_ma * 15 >> 4; // with the noise of its measurement
    bool pushes = (chops_ma > 0 && size_ma >= chops_ma) || guard->pushed != 0;
    bool blind = false;
    if (q != guard->seen_q) {
        guard->seen_q = q;
        guard->seen_duty = axis->motor.duty;
        guard->unseen_ms = 0;
    } else if (guard->unseen_ms < SETTLES_MS) {
        guard->seen_duty += (axis->motor.duty - guard->seen_duty) / SETTLED; // a pulse that brakes is no drive
        guard->unseen_ms = (uint8_t)(guard->unseen_ms + 1U);
    } else {
        const int32_t grown = axis->motor.duty - guard->seen_duty;
        const int32_t more = (grown < 0 ? -grown : grown) - 2 * axis->motor.servo.gains.friction;
        pushes = pushes || more > 2 * CHECK_PUSH;
        blind = pushes || more > STICKS;
    }
    guard->blind = blind;
    int32_t pushed_ms = pushes ? guard->pushed_ms + 1 : guard->pushed_ms - 1;
    if (pushed_ms < 0 || !within(q - guard->still_q, STALL_WAY)) { // a stall, or an end, comes before it overflows
        guard->still_q = q;
        pushed_ms = 0;
    }
    guard->pushed_ms = (uint16_t)pushed_ms;
}

static bool oscillates(tl_axis_t *axis) {
    tl_axis_guarded_t *guard = &axis->guard;
    const uint8_t pushed = guard->pushed;
    guard->pushed = 0;
    const uint16_t less = tl_path_rests(&axis->path) ? 1U : SWING_REST;
    guard->swing = guard->swing > less ? (uint16_t)(guard->swing - less) : 0U;
    if (pushed == BOTH_WAYS || (pushed != 0 && pushed != guard->swing_way)) {
        guard->swing = (uint16_t)(guard->swing + (guard->swing_way != 0 ? SWING_STEP : 0U));
        guard->swing_way = pushed;
    }
    return guard->swing >= SWING_MOST;
}

static bool mechanical(tl_axis_t *axis, int32_t size_ma, tl_us_t now_us) {
    const tl_count_q8_t error = axis->path.q - axis->q;
    feel(axis, size_ma);
    const bool stalls = axis->mode != TL_WIRE_MODE_HOME && axis->guard.pushed_ms >= axis->settings.stall_ms;
    return fails(axis, !within(error, axis->limits.following_error_q8), TL_WIRE_FAULT_FOLLOWING, error / TL_COUNT_ONE,
                 now_us) ||
           fails(axis, stalls, TL_WIRE_FAULT_STALL, axis->motor.duty, now_us) ||
           fails(axis, oscillates(axis), TL_WIRE_FAULT_OSCILLATION, 0, now_us);
}

// Held for longer than the settings allow without a word of a host: the drive sinks to nothing within a second, never
// at once, as what pulls at the motor would let go. Whether it follows or stalls is not looked at meanwhile.
static __attribute__((noinline)) TL_FAST bool left_alone(tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_guarded_t *guard = &axis->guard;
    if (guard->sink == 0) {
        if (guard->alone_ms != TL_AXIS_LET_GO &&
            (axis->settings.hold_ms == 0 || ++guard->alone_ms < axis->settings.hold_ms)) {
            return false;
        }
        const tl_duty_q15_t duty = axis->motor.duty, size = duty < 0 ? -duty : duty;
        guard->sink = (size >> 10) + 1;
        axis->motor.limit = size;
        axis->silent = true;
        tl_axis_event(axis, TL_WIRE_EVENT_SILENT);
    }
    axis->motor.limit -= guard->sink;
    fails(axis, axis->motor.limit <= 0, TL_WIRE_FAULT_HOST_LOST, 0, now_us);
    return true;
}

// -- moves ------------------------------------------------------------------------------------------------------

static void arrive(tl_axis_t *axis) {
    const tl_count_q8_t target = axis->plan.move_target;
    tl_axis_guarded_t *guard = &axis->guard;
    const bool there = tl_reference_rests_at(&axis->plan.reference, target) && axis->path.q == target &&
                       tl_path_rests(&axis->path) && within(axis->q - target, axis->settings.arrive_q8);
    guard->still_ms = counted(guard->still_ms, there);
    if (guard->still_ms >= STILL_MS) {
        tl_axis_enter(axis, TL_WIRE_MODE_HOLD);
        tl_axis_event(axis, guard->homing ? TL_WIRE_EVENT_HOMED : TL_WIRE_EVENT_ARRIVED);
        guard->homing = false;
    }
}

static void home(tl_axis_t *axis, tl_us_t now_us) {
    const tl_axis_trial_t *trial = &axis->trial;
    const tl_count_q8_t gone = (axis->q - trial->from) * trial->way;
    if (fails(axis, gone > trial->reach, TL_WIRE_FAULT_NO_END, gone / TL_COUNT_ONE, now_us)) {
        return;
    }
    if (axis->guard.pushed_ms < HOME_MS) {
        const tl_count_q8_t lead = axis->limits.following_error_q8 / 2;
        axis->plan.move_target = axis->q + (trial->way > 0 ? lead : -lead);
        return;
    }
    axis->q = trial->end;
    tl_axis_settle(axis);
    tl_actuator_reset(&axis->motor, axis->q);
    axis->referenced = true;
    tl_axis_admit(axis);
    axis->guard.homing = axis->guard.homed = true;
    axis->guard.pushed_ms = 0;
    axis->guard.still_q = axis->q;
    const tl_reference_t *reference = &axis->plan.reference;
    const tl_count_q8_t back = trial->end - (trial->way > 0 ? trial->retreat : -trial->retreat);
    axis->plan.move_target = tl_clamp(back, reference->low, reference->high);
    tl_axis_enter(axis, TL_WIRE_MODE_MOVE);
}

// -- check of motor and encoder ---------------------------------------------------------------------------------

TL_FAST void tl_axis_start_check(tl_axis_t *axis) {
    const tl_servo_gains_t *gains = &axis->motor.servo.gains;
    int32_t most = gains->friction + CHECK_PUSH;
    most = most < axis->settings.low_duty_q15 ? most : axis->settings.low_duty_q15;
    most = most < axis->limits.duty_q15 ? most : axis->limits.duty_q15;
    tl_count_q8_t way = 0; // at (most - friction) / feed_forward thousand counts/s
    if (gains->feed_forward > 0 && most > gains->friction) {
        way = (most - gains->friction) * (int32_t)(CHECK_MEASURE * TL_COUNT_ONE) / gains->feed_forward;
    }
    tl_axis_enter(axis, TL_WIRE_MODE_CHECK);
    axis->trial = (tl_axis_trial_t){
        .way = 1, .phase = CHECK_RAMP, .most = most, .from = axis->q, .least = way / 3, .far = way * 3};
}

static void next_phase(tl_axis_t *axis, uint8_t phase) {
    axis->trial.phase = phase;
    axis->trial.ms = 0;
    axis->trial.mark = axis->q;
    if (phase == CHECK_RAMP) {
        axis->trial.from = axis->q;
    } else if (phase == CHECK_REST) {
        axis->trial.duty = 0;
    }
}

// It has come to rest: the other way, or the verdict.
static void turn(tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_trial_t *trial = &axis->trial;
    if (trial->way > 0) {
        trial->way = -1;
        next_phase(axis, CHECK_RAMP);
    } else if (!fails(axis, !trial->moved, TL_WIRE_FAULT_UNMOVED, 0, now_us) &&
               !fails(axis, !trial->right_scale, TL_WIRE_FAULT_SCALE, trial->speed, now_us)) {
        axis->checked = true;
        tl_axis_event(axis, TL_WIRE_EVENT_CHECKED);
        tl_axis_settle(axis);
        tl_actuator_reset(&axis->motor, axis->q);
        tl_axis_admit(axis);
        tl_axis_enter(axis, TL_WIRE_MODE_HOLD);
    }
}

static void check(tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_trial_t *trial = &axis->trial;
    const tl_count_q8_t way = trial->way > 0 ? axis->q - trial->from : trial->from - axis->q;
    trial->ms++;
    if (fails(axis, trial->phase != CHECK_REST && way < -CHECK_MOVED, TL_WIRE_FAULT_REVERSED, way / TL_COUNT_ONE,
              now_us)) {
        return;
    }
    switch (trial->phase) {
    case CHECK_RAMP: {
        const int32_t duty = (trial->most * (int32_t)trial->ms) / CHECK_STEP;
        trial->duty = trial->way > 0 ? duty : -duty;
        if (trial->ms == CHECK_STEP) {
            next_phase(axis, CHECK_RUN);
        }
        break;
    }
    case CHECK_RUN:
        if (way > CHECK_MOVED && trial->ms >= CHECK_SETTLE) {
            trial->moved = true;
            next_phase(axis, CHECK_TIME);
        } else if (trial->ms >= CHECK_LONGEST) {
            next_phase(axis, CHECK_REST);
        }
        break;
    case CHECK_TIME:
        if (trial->ms == CHECK_MEASURE) {
            const tl_count_q8_t timed = trial->way > 0 ? axis->q - trial->mark : trial->mark - axis->q;
            trial->speed = timed / TL_COUNT_ONE * (int32_t)(1000U / CHECK_MEASURE);
            trial->right_scale =
                trial->right_scale || trial->far == 0 || (timed >= trial->least && timed <= trial->far);
            next_phase(axis, CHECK_REST);
        }
        break;
    default:
        if (trial->ms == CHECK_BRAKE) {
            turn(axis, now_us);
        }
        break;
    }
}

// ---------------------------------------------------------------------------------------------------------------

static bool has_patience(const tl_axis_t *axis) {
    return tl_axis_is_following(axis) || axis->mode == TL_WIRE_MODE_MOVE || axis->mode == TL_WIRE_MODE_HOME;
}

// What no axis that follows has to do.
static __attribute__((noinline)) TL_FAST void try_out(tl_axis_t *axis, tl_us_t now_us) {
    if (axis->mode == TL_WIRE_MODE_MOVE) {
        arrive(axis);
    } else if (axis->mode == TL_WIRE_MODE_HOME) {
        home(axis, now_us);
    } else if (axis->mode == TL_WIRE_MODE_CHECK) {
        check(axis, now_us);
    } else if (axis->mode == TL_WIRE_MODE_OFF) {
        fails(axis, axis->guard.lapsed, TL_WIRE_FAULT_HOST_LOST, 0, now_us);
    }
}

TL_FAST void tl_axis_guard(tl_axis_t *axis, tl_us_t now_us) {
    const int32_t size_ma = measure(axis);
    if (is_lost(axis, now_us)) {
        return;
    }
    if (has_patience(axis) && --axis->guard.patience == 0U) {
        tl_axis_silence(axis); // all that this millisecond has room for
        return;
    }
    if (axis->mode != TL_WIRE_MODE_OFF && !electrical(axis, now_us) && axis->closed &&
        (axis->mode != TL_WIRE_MODE_HOLD || !left_alone(axis, now_us))) {
        mechanical(axis, size_ma, now_us);
    }
    if (!tl_axis_is_following(axis)) {
        try_out(axis, now_us);
    }
}
