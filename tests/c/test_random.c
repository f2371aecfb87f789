// Hours of a board's life in seconds: random requests, encoder values and faults on a fake clock, with what must hold
// after every control step. tools/guards.py has what each guard of it is worth.
#include "draws.h"
#include "fake_board.h"

#include <math.h>

#ifndef RANDOM_STEPS
#define RANDOM_STEPS 30000000U // control steps
#endif
#define AXES           2U
#define DROPOUT_ONE_IN 16U                   // events
#define DROPOUT_SPEED  500                   // counts/s from which on 50 counts are promised
#define COUNTS_LOW     (-400 * TL_COUNT_ONE) // of a calibration motion

void setUp(void) {}
void tearDown(void) {}

static bool one_in(uint32_t n) {
    return random_u32() % n == 0U;
}

// -- the world: what the board cannot know ------------------------------------------------------------------------

typedef struct {
    bool truly_referenced; // nothing has happened since that would spoil its position
    int64_t off_by;        // position less the motor's, counts Q8, while it is referenced
    tl_count_q8_t path_q;  // a step ago
    tl_count_q8_t began_q; // where its loop was closed
    int32_t path_speed;
    uint8_t mode;
    bool was_closed;
    uint32_t still_steps; // full drive, no motion
    double still_at;
    uint32_t ill_steps;   // driver or supply ill while driven
    uint32_t apart_steps; // the motor is too far from its path
    double swings;        // changes from limit to limit, lately
    uint32_t swung_steps; // since the last one
    int way;              // of the last limit
    uint32_t overloaded_steps;
    uint32_t lost_steps;    // since something has spoilt its position
    uint32_t stopped_steps; // the stop input is active
    uint32_t sink_steps;    // its drive sinks: whether it stalls, follows or swings is not looked at meanwhile
    uint32_t group_steps;   // driven though another one of its group has failed
    bool mate_failed;
    uint32_t steady_steps;  // its path goes at one speed, and it goes with it
    uint32_t dropout_steps; // that its encoder has still dropped out for
    bool steady;            // and has dropped out in such a motion, which goes on
    double gone_from;       // where the motor was then
    uint32_t astray_steps;  // driven away from its path unseen
} seen_t;

static seen_t seen[AXES];
static uint32_t heard_steps_ago;
static uint32_t moved, arrived, faults, homed, checked, stopped, taken, sunk, dropped, steady, told;

#define STEPS(ms) ((ms) * FAKE_HZ / 1000U)

static bool is_motion(uint8_t mode) {
    return mode != TL_WIRE_MODE_OFF && mode != TL_WIRE_MODE_HOLD;
}

// What stops an axis that is well itself: the stop input, and the fault of another axis of its group.
static void check_stops(uint8_t i) {
    const tl_axis_t *axis = &app.axes[i];
    seen_t *s = &seen[i];
    const bool stops = fake.estop_closed != (axis->settings.estop == TL_WIRE_ESTOP_OPEN);
    s->stopped_steps = stops ? s->stopped_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->stopped_steps <= STEPS(5U) ||
                                 (axis->mode == TL_WIRE_MODE_OFF && axis->fault != TL_WIRE_FAULT_NONE),
                             "stopped is off, until it is released and cleared");
    bool failed = false, sinks = false;
    for (uint8_t j = 0; j < AXES; j++) {
        const tl_axis_t *mate = &app.axes[j];
        const bool of_group = j != i && axis->settings.group != 0 && mate->settings.group == axis->settings.group;
        const bool fails = of_group && mate->fault != TL_WIRE_FAULT_NONE && mate->fault != TL_WIRE_FAULT_GROUP;
        failed = failed || fails;
        sinks = sinks || (fails && mate->fault == TL_WIRE_FAULT_HOST_LOST && mate->guard.sink != 0);
    }
    TEST_ASSERT_TRUE_MESSAGE(!failed || !s->mate_failed || s->mode != TL_WIRE_MODE_OFF || axis->mode == s->mode,
                             "none is driven while its group has a fault");
    s->mate_failed = failed;
    const bool lets_go =
        sinks && axis->mode == TL_WIRE_MODE_HOLD && axis->guard.sink != 0; // for how long: check_axis()
    s->group_steps = failed && axis->mode != TL_WIRE_MODE_OFF && !lets_go ? s->group_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->group_steps <= STEPS(2U), "a group goes off together");
    stopped += s->mode != TL_WIRE_MODE_OFF && axis->fault == TL_WIRE_FAULT_ESTOP ? 1U : 0U;
    taken += s->mode != TL_WIRE_MODE_OFF && axis->fault == TL_WIRE_FAULT_GROUP ? 1U : 0U;
    sunk += lets_go && s->sink_steps == STEPS(10U) ? 1U : 0U;
}

// docs/safety.md: an encoder that drops out.
static void check_sight(uint8_t i) {
    const tl_axis_t *axis = &app.axes[i];
    seen_t *s = &seen[i];
    const tl_wire_settings_t *own = &axis->settings, usual = tl_axis_default_settings(&fake_port, i);
    const int32_t error = axis->path.q - axis->q;
    const bool driven = axis->closed && axis->mode != TL_WIRE_MODE_HOME && axis->guard.sink == 0 &&
                        own->commissioned != 0U && own->proportional == usual.proportional;
    const bool one_speed = driven && axis->path.speed == s->path_speed && axis->guard.swing == 0 && !fake.blocked &&
                           llabs((int64_t)axis->path.speed * (int32_t)FAKE_HZ >> 24) >= DROPOUT_SPEED;
    s->steady_steps = one_speed && !fake.dropped[i] && abs(error) < 3 * TL_COUNT_ONE ? s->steady_steps + 1U : 0U;
    if (!fake.dropped[i]) {
        s->astray_steps = 0U;
        return;
    }
    dropped++;
    s->steady = s->steady && one_speed;
    TEST_ASSERT_TRUE_MESSAGE(!s->steady || fabs(fake.position[i] - s->gone_from) <= 50.0, "fifty counts unseen");
    told += s->was_closed && axis->mode == TL_WIRE_MODE_OFF && axis->fault == TL_WIRE_FAULT_STALL ? 1U : 0U;
    s->astray_steps = driven && abs(error) >= 6 * TL_COUNT_ONE ? s->astray_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->astray_steps <= STEPS(own->stall_ms + 150U), "not driven for long unseen");
    TEST_ASSERT_TRUE_MESSAGE(axis->fault != TL_WIRE_FAULT_STALL || !s->was_closed || !axis->referenced,
                             "a stall in the dark takes the position");
    if (--s->dropout_steps == 0U) {
        fake_drop(i, false);
    }
}

// What must hold after each step, whatever happened.
static void check_axis(uint8_t i) {
    const tl_axis_t *axis = &app.axes[i];
    seen_t *s = &seen[i];
    const tl_duty_q15_t duty = fake.duty[i];
    const tl_wire_settings_t *own = &axis->settings;
    // Duty within limits; low until the position is known, and while motor and encoder are checked.
    TEST_ASSERT_TRUE_MESSAGE(abs(duty) <= own->duty_q15 && abs(duty) <= axis->limits.duty_q15, "duty within limits");
    const bool weak = axis->mode == TL_WIRE_MODE_CHECK || axis->mode == TL_WIRE_MODE_HOME || !axis->referenced ||
                      own->commissioned == 0U;
    TEST_ASSERT_TRUE_MESSAGE(!weak || abs(duty) <= own->low_duty_q15, "low duty without a reference, or commissioning");
    // Off is off, and a fault means off.
    TEST_ASSERT_TRUE_MESSAGE(axis->fault == TL_WIRE_FAULT_NONE || axis->mode == TL_WIRE_MODE_OFF, "fault means off");
    TEST_ASSERT_TRUE_MESSAGE(axis->mode != TL_WIRE_MODE_OFF || duty == 0, "off means no drive");
    // Checked, and referenced, before motion.
    TEST_ASSERT_TRUE_MESSAGE(axis->mode == TL_WIRE_MODE_OFF || axis->mode == TL_WIRE_MODE_CHECK || axis->checked,
                             "checked before it is driven");
    const bool by_position = tl_axis_is_following(axis) || axis->mode == TL_WIRE_MODE_CALIBRATE;
    TEST_ASSERT_TRUE_MESSAGE(!by_position || axis->referenced, "referenced before motion");
    s->lost_steps = axis->referenced && !s->truly_referenced ? s->lost_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->lost_steps <= STEPS(2U), "a position that was lost is not trusted");
    if (axis->referenced && s->truly_referenced && axis->mode != TL_WIRE_MODE_OFF) { // and it is the motor's
        const int64_t here = (int64_t)fake_encoder(&fake, i) * TL_COUNT_ONE;
        const int64_t off_by = axis->q - here;
        if (s->off_by == INT64_MIN) {
            s->off_by = off_by;
        }
        TEST_ASSERT_TRUE_MESSAGE(off_by == s->off_by, "the position is the encoder's");
    } else {
        s->off_by = INT64_MIN;
    }
    // The path has no jumps, in position or in speed, and keeps the range.
    if (axis->closed && s->was_closed && axis->mode != TL_WIRE_MODE_HOME && s->mode != TL_WIRE_MODE_HOME) {
        const int32_t most_q8 = own->speed_q8_s / (int32_t)FAKE_HZ + 2;
        TEST_ASSERT_TRUE_MESSAGE(abs(axis->path.q - s->path_q) <= most_q8, "the path has no jumps");
        const int64_t bend = (int64_t)own->acceleration_q8_s2 * 65536 / FAKE_HZ / FAKE_HZ;
        TEST_ASSERT_TRUE_MESSAGE(abs(axis->path.speed - s->path_speed) <= bend + bend / 8 + 64, "nor has its speed");
    }
    if (axis->closed && (!s->was_closed || (s->mode == TL_WIRE_MODE_HOME && axis->mode != TL_WIRE_MODE_HOME))) {
        s->began_q = axis->path.q; // it may stay there, and come back, but not go farther out
    }
    if (axis->closed && axis->referenced) {
        const tl_count_q8_t low = own->q_low_q8 < s->began_q ? own->q_low_q8 : s->began_q;
        const tl_count_q8_t high = own->q_high_q8 > s->began_q ? own->q_high_q8 : s->began_q;
        TEST_ASSERT_TRUE_MESSAGE(axis->path.q >= low - 1 && axis->path.q <= high + 1, "range kept");
    }
    const bool sinks = axis->mode == TL_WIRE_MODE_HOLD && axis->guard.sink != 0;
    s->sink_steps = sinks ? s->sink_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->sink_steps <= STEPS(1100U), "a drive that sinks is gone within a second");
    // A motor that stands still under full drive, a driver or a supply that is ill: off within the stated time.
    const bool pushes = axis->mode != TL_WIRE_MODE_HOME && axis->closed && axis->motor.limit > 0 && !sinks &&
                        abs(duty) == axis->motor.limit && fake.position[i] - s->still_at < 3.0 &&
                        fake.position[i] - s->still_at > -3.0;
    s->still_steps = pushes ? s->still_steps + 1U : 0U;
    s->still_at = pushes ? s->still_at : fake.position[i];
    TEST_ASSERT_TRUE_MESSAGE(s->still_steps <= STEPS(own->stall_ms + 10U), "a stall is noticed");
    const bool ill = axis->mode != TL_WIRE_MODE_OFF &&
                     (fake.driver_fault[i] || (own->supply_low_mv > 0 && fake.supply_mv < own->supply_low_mv));
    s->ill_steps = ill ? s->ill_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->ill_steps <= STEPS(25U), "driver and supply are watched");
    const bool overloaded =
        axis->mode != TL_WIRE_MODE_OFF && axis->limits.current_ma > 0 && fake.current_ma > 2 * axis->limits.current_ma;
    s->overloaded_steps = overloaded ? s->overloaded_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->overloaded_steps <= STEPS(40U), "the current is watched");
    // A host that is not heard of: at rest after its silence (0.3 s, or 0.2 after a set-point up to 1 s ahead) and
    // braking (2 s from the greatest speed at the least acceleration).
    const bool depends = axis->mode != TL_WIRE_MODE_OFF && axis->mode != TL_WIRE_MODE_HOLD;
    TEST_ASSERT_TRUE_MESSAGE(!depends || heard_steps_ago <= STEPS(4000U), "no motion without a host");
    check_stops(i);
    check_sight(i);
    // A position that the motor does not follow, a drive that swings, a motor that turns against its encoder.
    const bool apart = axis->closed && !sinks && abs(axis->path.q - axis->q) > axis->limits.following_error_q8;
    s->apart_steps = apart ? s->apart_steps + 1U : 0U;
    TEST_ASSERT_TRUE_MESSAGE(s->apart_steps <= STEPS(2U), "the following error is watched");
    const int way =
        axis->closed && !sinks && axis->motor.limit > 0 && abs(duty) == axis->motor.limit ? (duty > 0 ? 1 : -1) : 0;
    s->swings = axis->closed && s->swings > 0.0 ? s->swings - 1.0 / STEPS(50U) : 0.0;
    s->swung_steps++;
    if (way != 0 && way != s->way) {
        const bool counts = s->way != 0 && s->swung_steps >= STEPS(1U); // one a millisecond
        s->swings += counts ? 1.0 : 0.0;
        s->swung_steps = counts ? 0U : s->swung_steps;
        s->way = way;
    }
    TEST_ASSERT_TRUE_MESSAGE(s->swings < 20.0, "an oscillation is noticed");
    TEST_ASSERT_TRUE_MESSAGE(!axis->closed || fake.wiring[i] > 0.0, "swapped wires never close the loop");
    // A move that has arrived is there, and rests.
    if (s->mode == TL_WIRE_MODE_MOVE && axis->mode == TL_WIRE_MODE_HOLD &&
        (axis->events & (1U << TL_WIRE_EVENT_ARRIVED)) != 0U) {
        TEST_ASSERT_TRUE_MESSAGE(abs(axis->q - axis->plan.move_target) <= own->arrive_q8, "arrived is there");
        arrived++;
    }
    moved += is_motion(axis->mode) ? 1U : 0U;
    faults += axis->fault != TL_WIRE_FAULT_NONE ? 1U : 0U;
    homed += s->mode == TL_WIRE_MODE_HOME && axis->mode == TL_WIRE_MODE_MOVE ? 1U : 0U;
    checked += s->mode == TL_WIRE_MODE_CHECK && axis->mode == TL_WIRE_MODE_HOLD ? 1U : 0U;
    s->truly_referenced = s->truly_referenced || (s->mode == TL_WIRE_MODE_HOME && axis->mode == TL_WIRE_MODE_MOVE);
    s->mode = axis->mode;
    s->was_closed = axis->closed;
    s->path_q = axis->path.q;
    s->path_speed = axis->path.speed;
}

// One step of the world: motors with walls, then the board.
static void live(void) {
    const double dt = 1.0 / FAKE_HZ;
    fake.t_us += 1000000U / FAKE_HZ;
    for (uint8_t i = 0; i < AXES; i++) {
        fake.speed[i] += (fake.duty[i] / 32768.0 * FAKE_SPEED - fake.speed[i]) * dt / FAKE_LAG;
        fake.speed[i] = fake.blocked ? 0.0 : fake.speed[i];
        fake.position[i] += fake.speed[i] * dt;
    }
    tl_app_control(&app);
    for (uint8_t i = 0; i < AXES; i++) {
        check_axis(i); // before the task takes the events
    }
    static uint32_t ticks;
    if (++ticks % STEPS(1U) == 0U) {
        tl_app_task(&app);
    }
    heard_steps_ago++;
}

static void say(uint8_t type, const void *message) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_app_receive(&app, frame, tl_wire_frame(frame, type, (uint16_t)random_u32(), message));
    heard_steps_ago = 0;
    for (uint8_t i = 0; i < AXES; i++) {
        seen[i].was_closed = seen[i].was_closed && app.axes[i].closed; // off and on again within a step
    }
}

static void say_position(uint8_t axis, int32_t q_q8) {
    const tl_wire_set_position_t request = {.axis = axis, .q_q8 = q_q8};
    if (axis < AXES && app.axes[axis].mode == TL_WIRE_MODE_OFF) {
        seen[axis].truly_referenced = true; // who says so is believed
        seen[axis].off_by = INT64_MIN;
    }
    say(TL_WIRE_SET_POSITION, &request);
}

static void say_settings(uint8_t axis) {
    tl_wire_settings_t own = tl_axis_default_settings(&fake_port, axis);
    own.key = TL_WIRE_KEY;
    own.q_low_q8 = between(-3000, -500) * TL_COUNT_ONE;
    own.q_high_q8 = between(500, 3000) * TL_COUNT_ONE;
    own.duty_q15 = between(12000, 32768);
    own.speed_q8_s = between(1000, 20000) * TL_COUNT_ONE;
    own.acceleration_q8_s2 = between(10000, 200000) * TL_COUNT_ONE;
    own.stall_ms = (uint16_t)between(50, 500);
    own.commissioned = (uint8_t)(one_in(4) ? 0U : 1U);
    if (one_in(3)) { // which no servo stands
        own.proportional = 32767;
        own.derivative = 32767;
    }
    say(TL_WIRE_SETTINGS, &own);
}

// What stops axes that are well; the rest of their settings stays.
static void say_stops(void) {
    const uint8_t estop = (uint8_t)(one_in(16) ? TL_WIRE_ESTOP_OPEN : TL_WIRE_ESTOP_CLOSED);
    for (uint8_t i = 0; i < AXES; i++) {
        tl_wire_settings_t own = app.axes[i].settings;
        own.key = TL_WIRE_KEY;
        own.group = (uint8_t)(one_in(8) ? 0U : 1U);
        own.estop = estop;
        own.hold_ms = one_in(4) ? 0U : (uint32_t)between(20, 500);
        say(TL_WIRE_SETTINGS, &own);
    }
}

// What a careless host does.
static void a_request(void) {
    const uint8_t axis = (uint8_t)(random_u32() % AXES);
    const tl_wire_safe_stop_t of_axis = {.axis = axis};
    switch (random_u32() % 24U) {
    case 0: {
        const tl_wire_enable_t request = {.axis = axis, .on = 0};
        say(TL_WIRE_ENABLE, &request);
        break;
    }
    case 1:
        say(one_in(4) ? TL_WIRE_SAFE_STOP : TL_WIRE_GET_STATUS, &of_axis);
        break;
    case 2:
        say_position(axis, between(-4000, 4000) * TL_COUNT_ONE);
        break;
    case 3: {
        tl_wire_limits_t limits = app.axes[axis].limits;
        limits.duty_q15 += between(-3000, 3000);
        limits.q_low_q8 += between(-500, 500) * TL_COUNT_ONE;
        limits.speed_q8_s += between(-500, 500) * TL_COUNT_ONE;
        limits.current_ma += between(-50, 50);
        say(TL_WIRE_LIMITS, &limits);
        break;
    }
    case 4:
        if (one_in(4)) {
            say_settings(axis);
        } else if (one_in(2)) {
            say_stops();
        }
        break;
    case 5: {
        const tl_wire_home_t request = {.axis = axis,
                                        .direction = one_in(2) ? 1 : -1,
                                        .reach_q8 = between(10, 5000) * TL_COUNT_ONE,
                                        .retreat_q8 = between(0, 300) * TL_COUNT_ONE,
                                        .silence_us = 300000U};
        say(TL_WIRE_HOME, &request);
        fake.blocked = one_in(2); // an end
        break;
    }
    case 6: {
        const tl_wire_jog_t request = {
            .axis = axis, .way_q8 = between(-500, 500) * TL_COUNT_ONE, .silence_us = 300000U};
        say(TL_WIRE_JOG, &request);
        break;
    }
    case 7:
        say(TL_WIRE_CHECK, &of_axis);
        break;
    case 8:
    case 9: {
        const tl_wire_follow_t request = {
            .axis = axis, .target = (uint8_t)(random_u32() % 2U), .compensation = 2, .silence_us = 200000U};
        say(TL_WIRE_FOLLOW, &request);
        break;
    }
    case 10:
    case 11:
    case 12:
    case 13: {
        const bool tip = app.axes[axis].mode == TL_WIRE_MODE_FOLLOW_TIP;
        const int32_t value = tip ? between(-70, 70) * TL_DEG_ONE : between(-4000, 4000) * TL_COUNT_ONE;
        const tl_wire_set_point_t request = {
            .axis = axis, .value = value, .at_us = one_in(2) ? 0 : fake.t_us + random_u32() % 1000000U};
        say(TL_WIRE_SET_POINT, &request);
        break;
    }
    case 14:
        if (one_in(8)) {
            const tl_wire_motion_start_t request = {.axis = axis,
                                                    .cycles = 2,
                                                    .low_q8 = COUNTS_LOW,
                                                    .high_q8 = -COUNTS_LOW,
                                                    .speed_q8_s = {2000 * TL_COUNT_ONE},
                                                    .transit_q8_s = 4000 * TL_COUNT_ONE,
                                                    .acceleration_q8_s2 = 40000 * TL_COUNT_ONE,
                                                    .approach_q8 = 20 * TL_COUNT_ONE,
                                                    .stroke_max_q8 = 200 * TL_COUNT_ONE,
                                                    .host_timeout_us = 300000U};
            say(TL_WIRE_MOTION_START, &request);
        }
        break;
    case 15: {
        const tl_wire_strength_t request = {.axis = axis, .strength_q15 = between(0, 32768)};
        say(TL_WIRE_STRENGTH, &request);
        break;
    }
    default: {
        const tl_wire_move_t request = {.axis = axis,
                                        .q_q8 = between(-3500, 3500) * TL_COUNT_ONE,
                                        .speed_q8_s = between(0, 8000) * TL_COUNT_ONE,
                                        .silence_us = 300000U};
        const bool moves = app.axes[axis].mode == TL_WIRE_MODE_MOVE; // a jog, or the retreat from an end
        say(TL_WIRE_MOVE, &request);
        TEST_ASSERT_TRUE_MESSAGE(moves || app.axes[axis].mode != TL_WIRE_MODE_MOVE || app.axes[axis].referenced,
                                 "referenced before a move");
        break;
    }
    }
}

static void see_again(void) {
    for (uint8_t i = 0; i < AXES; i++) {
        fake_drop(i, false);
    }
}

static void drop_out(uint8_t axis) {
    seen_t *s = &seen[axis];
    if (!fake.dropped[axis] && app.axes[axis].closed) {
        s->steady = s->steady_steps >= STEPS(60U);
        steady += s->steady ? 1U : 0U;
        s->gone_from = fake.position[axis];
        s->dropout_steps = (uint32_t)between(1, one_in(2) ? (int32_t)STEPS(100U) : (int32_t)STEPS(800U));
        fake_drop(axis, true);
    }
}

static void lose(uint8_t axis) {
    seen[axis].truly_referenced = false;
    seen[axis].off_by = INT64_MIN;
}

// With the power off somebody changes the wires.
static void rewire(uint8_t axis, double wiring) {
    see_again();
    fake.wiring[axis] = wiring;
    fake_start(AXES, TL_WIRE_BOOT_POWER); // where nothing is stored, nobody has commissioned it
    memset(seen, 0, sizeof(seen));        // another life
    for (uint8_t i = 0; i < AXES; i++) {
        lose(i);
    }
}

static void mend(void) {
    fake.blocked = false;
    fake.current_ma = 100;
    fake.supply_mv = 6000;
    fake.estop_closed = false;
    memset(fake.driver_fault, 0, sizeof(fake.driver_fault));
}

// And a helpful one, without whom nothing would ever move.
static void help(uint8_t axis) {
    if (one_in(3)) {
        mend();
    }
    if (fake.wiring[axis] < 0.0 && one_in(4)) {
        rewire(axis, 1.0);
    }
    if (app.axes[axis].fault != TL_WIRE_FAULT_NONE) {
        const tl_wire_clear_fault_t clear = {.axis = axis};
        say(TL_WIRE_CLEAR_FAULT, &clear);
    }
    if (app.axes[axis].mode == TL_WIRE_MODE_OFF) {
        if (!app.axes[axis].referenced && one_in(2)) {
            say_position(axis, between(-400, 400) * TL_COUNT_ONE);
        }
        const tl_wire_enable_t enable = {.axis = axis, .on = 1};
        say(TL_WIRE_ENABLE, &enable);
    }
}

// What happens to hardware.
static void a_mishap(void) {
    const uint8_t axis = (uint8_t)(random_u32() % AXES);
    see_again(); // what happens unseen is not known
    switch (random_u32() % 14U) {
    case 0:
        fake.blocked = true;
        break;
    case 1:
        fake.driver_fault[axis] = true;
        break;
    case 2:
        fake.supply_mv = (uint16_t)between(0, 5000);
        break;
    case 3:
        fake.current_ma = between(-3000, 3000);
        break;
    case 4: // the encoder jumps
        fake.position[axis] += one_in(2) ? 6000.0 : -6000.0;
        lose(axis);
        break;
    case 5:
        fake.slipped[axis] = true;
        lose(axis);
        break;
    case 6:
        rewire(axis, -1.0);
        break;
    case 7:
        tl_app_bus(&app, false);
        tl_app_bus(&app, true);
        break;
    case 8:
    case 10: { // no control step for a while; a motor that is off is turned meanwhile
        fake.t_us += (tl_us_t)between(10000, 100000);
        const bool free = app.axes[axis].mode == TL_WIRE_MODE_OFF && app.axes[axis].fault == TL_WIRE_FAULT_NONE;
        fake.position[axis] += free ? (one_in(2) ? 3000.0 : -3000.0) : 0.0;
        live();
        TEST_ASSERT_TRUE_MESSAGE(!free || app.axes[axis].fault == TL_WIRE_FAULT_NONE, "turned by hand is no fault");
        break;
    }
    case 9: // somebody pushes the motor
        fake.position[axis] += between(-250, 250);
        break;
    case 11: // somebody presses the stop button
        fake.estop_closed = true;
        break;
    default:
        mend();
        break;
    }
}

static void test_whatever_happens_an_axis_keeps_its_word(void) {
    uint32_t steps = 0;
    for (uint32_t run = 1; steps < RANDOM_STEPS; run++) {
        seed = run * 2654435761U;
        fake_new(AXES);
        memset(seen, 0, sizeof(seen));
        fake.current_ma = 100;
        static uint8_t blob[TL_TABLE_SIZE_MAX];
        fake_upload(0, blob, fake_table(blob, 0, run));
        for (int i = 0; i < 2000 && steps < RANDOM_STEPS; i++) {
            const uint32_t what = random_u32() % 64U;
            if (what == 0U) {
                a_mishap();
                live(); // so that none hides another: a jump after a pause is a motor turned by hand
            } else if (what < 12U) {
                help((uint8_t)(random_u32() % AXES));
            } else {
                a_request();
            }
            if (one_in(DROPOUT_ONE_IN)) {
                drop_out((uint8_t)(random_u32() % AXES));
            }
            const uint32_t most =
                one_in(400) ? STEPS(12000U) : (one_in(40) ? STEPS(2000U) : (one_in(4) ? 1000U : 100U));
            for (uint32_t left = random_u32() % most; left > 0U; left--) {
                live();
                steps++;
            }
            tl_outbox_open(&app.outbox, true); // who reads is another test's
        }
    }
    TEST_ASSERT_TRUE_MESSAGE(moved > RANDOM_STEPS / 20U && faults > RANDOM_STEPS / 100U, "it did something");
    TEST_ASSERT_TRUE_MESSAGE(arrived > RANDOM_STEPS / 100000U && homed > RANDOM_STEPS / 1000000U &&
                                 checked > RANDOM_STEPS / 1000000U,
                             "and got somewhere");
    TEST_ASSERT_TRUE_MESSAGE(stopped > RANDOM_STEPS / 1000000U && taken > RANDOM_STEPS / 1000000U &&
                                 sunk > RANDOM_STEPS / 20000000U,
                             "and was stopped in every way");
    TEST_ASSERT_TRUE_MESSAGE(dropped > RANDOM_STEPS / 30U && told > RANDOM_STEPS / 200000U &&
                                 steady > RANDOM_STEPS / 1000000U,
                             "and was in the dark");
}

int main(void) {
    fake_keeps_log = true;
    UNITY_BEGIN();
    RUN_TEST(test_whatever_happens_an_axis_keeps_its_word);
    return UNITY_END();
}
