// When the app does what, to the microsecond and the tick (docs/safety.md and the numbers of tl_app.c): late steps, the
// watchdog, half frames, restarts, which axis is watched in which tick, and what a session's end takes with it.
#include "fake_board.h"

static uint32_t guarded[TL_WIRE_AXES_MAX], stops_watched;

static int32_t counting_current(void *context, uint8_t axis) {
    (void)context;
    guarded[axis]++;
    return 0;
}

static bool counting_estop(void *context) {
    (void)context;
    stops_watched++;
    return false;
}

void setUp(void) {
    fake_new(2);
    fake_ready();
}
void tearDown(void) {}

// -- the control step -------------------------------------------------------------------------------------------------

static uint32_t sum_of(const uint32_t *counts) {
    uint32_t sum = 0;
    for (uint32_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        sum += counts[i];
    }
    return sum;
}

static void test_each_axis_is_watched_and_guarded_once_a_millisecond_in_ticks_of_its_own(void) {
    for (uint8_t axes = 1; axes <= TL_WIRE_AXES_MAX; axes++) {
        uint32_t watched[TL_WIRE_AXES_MAX] = {0};
        fake_new(axes);
        fake_port.current_ma = counting_current;
        fake_port.estop_closed = counting_estop;
        fake_step();
        memset(guarded, 0, sizeof guarded);
        stops_watched = 0;
        for (uint32_t tick = 0; tick < 50U; tick++) {
            const uint32_t before = sum_of(watched), guards = sum_of(guarded), stops = stops_watched, steps = app.steps;
            for (uint8_t i = 0; i < axes; i++) {
                app.axes[i].plan.stream.now_us = 0;
            }
            fake.t_us += 200U;
            tl_app_control(&app);
            TEST_ASSERT_EQUAL(steps + 1U, app.steps);
            for (uint8_t i = 0; i < axes; i++) { // the watch sets what is planned for
                watched[i] += app.axes[i].plan.stream.now_us == fake.t_us + app.axes[i].plan.lead_us ? 1U : 0U;
            }
            TEST_ASSERT_TRUE(sum_of(watched) - before <= 1U && sum_of(guarded) - guards <= 1U);
            TEST_ASSERT_TRUE(stops_watched == stops || axes < TL_WIRE_AXES_MAX || sum_of(watched) == before);
        }
        for (uint8_t i = 0; i < axes; i++) { // of ten milliseconds
            TEST_ASSERT_EQUAL(10, watched[i]);
            TEST_ASSERT_EQUAL(10, guarded[i]);
        }
        TEST_ASSERT_EQUAL(10, stops_watched);
    }
}

static void step_after(uint32_t us) {
    fake.t_us += us;
    tl_app_control(&app);
}

static void test_a_step_is_late_after_two_periods_and_a_fault_after_20_ms(void) {
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(2);
    app.counters.overruns = 0;
    step_after(400);
    TEST_ASSERT_EQUAL(0, app.counters.overruns);
    step_after(401);
    TEST_ASSERT_EQUAL(1, app.counters.overruns);
    step_after(20000);
    TEST_ASSERT_EQUAL(2, app.counters.overruns);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
    step_after(20001);
    TEST_ASSERT_EQUAL(3, app.counters.overruns);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_OVERRUN, app.axes[0].fault);
    TEST_ASSERT_EQUAL(20001, app.axes[0].guard.fault_value);
    TEST_ASSERT_TRUE(app.axes[0].guard.fault_us == fake.t_us);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[1].fault); // it was off
}

// -- the task ---------------------------------------------------------------------------------------------------------

static void task_after(uint32_t us) {
    fake.t_us += us;
    tl_app_task(&app);
}

static void test_the_watchdog_is_fed_once_a_millisecond_while_steps_go_on(void) {
    task_after(1000);
    step_after(200);
    task_after(800);
    const uint32_t fed = fake.fed;
    step_after(200);
    task_after(799);
    TEST_ASSERT_EQUAL(fed, fake.fed);
    task_after(1);
    TEST_ASSERT_EQUAL(fed + 1U, fake.fed);
    task_after(1000); // no step since
    TEST_ASSERT_EQUAL(fed + 1U, fake.fed);
    step_after(200);
    task_after(1000);
    TEST_ASSERT_EQUAL(fed + 2U, fake.fed);
}

static void test_the_rest_of_a_frame_is_waited_for_20_ms(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_ping_t ping = {.host_us = 5};
    for (uint32_t late = 0; late < 2U; late++) {
        setUp();
        fake_listen();
        memset(heard_count, 0, sizeof heard_count);
        const size_t size = tl_wire_frame(frame, TL_WIRE_PING, 1, &ping);
        tl_app_receive(&app, frame, 10);
        task_after(19999U);
        TEST_ASSERT_EQUAL(10, app.parser.fill);
        task_after(late != 0U ? 1001U : 0U); // the task looks each millisecond
        tl_app_receive(&app, frame + 10, size - 10);
        fake_listen();
        TEST_ASSERT_EQUAL(late != 0U ? 0 : 1, heard_count[TL_WIRE_PONG]);
        TEST_ASSERT_EQUAL(late != 0U ? 10 + (size - 10) : 0,
                          app.parser.bytes_bad + (late != 0U ? app.parser.fill : 0U));
    }
}

static void asks_to_reboot(void) {
    const tl_wire_reboot_t reboot = {.key = TL_WIRE_KEY};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_REBOOT, &reboot));
}

static void test_a_restart_waits_for_its_answer_to_leave(void) {
    asks_to_reboot(); // and has read the answer
    task_after(49999);
    TEST_ASSERT_EQUAL(0, fake.rebooted);
    task_after(1);
    TEST_ASSERT_EQUAL(1, fake.rebooted);
    setUp();
    asks_to_reboot();
    const tl_wire_get_status_t status = {.axis = 0};
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_GET_STATUS, 9, &status)); // nobody reads this one
    task_after(499999);
    TEST_ASSERT_EQUAL(0, fake.rebooted);
    task_after(1);
    TEST_ASSERT_EQUAL(1, fake.rebooted);
}

static void test_a_restart_waits_for_axes_for_10_seconds_at_most(void) {
    asks_to_reboot();
    app.axes[1].mode = TL_WIRE_MODE_HOLD;
    task_after(9999999);
    TEST_ASSERT_EQUAL(0, fake.rebooted);
    task_after(1);
    TEST_ASSERT_EQUAL(1, fake.rebooted);
}

// -- sessions and starts ----------------------------------------------------------------------------------------------

static void test_a_session_s_end_takes_telemetry_and_motion_with_it(void) {
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    const tl_wire_move_t move = {.q_q8 = 3000 * TL_COUNT_ONE};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &move));
    for (uint8_t i = 0; i < 2U; i++) {
        app.axes[i].telemetry.divider = 3;
        app.axes[i].telemetry.head = 9;
        app.axes[i].telemetry.tail = 4;
    }
    app.counters.bus_losses = 0;
    tl_app_bus(&app, false);
    TEST_ASSERT_EQUAL(1, app.counters.bus_losses);
    TEST_ASSERT_FALSE(app.outbox.open);
    for (uint8_t i = 0; i < 2U; i++) {
        TEST_ASSERT_EQUAL(0, app.axes[i].telemetry.divider);
        TEST_ASSERT_EQUAL(9, app.axes[i].telemetry.tail);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING_OFF, app.axes[0].mode);
    TEST_ASSERT_TRUE(app.axes[0].silent);
    tl_app_bus(&app, false); // it was gone already
    TEST_ASSERT_EQUAL(1, app.counters.bus_losses);
    tl_app_bus(&app, true);
    TEST_ASSERT_TRUE(app.outbox.open);
    TEST_ASSERT_EQUAL(1, app.counters.bus_losses);
}

static void test_a_session_begins_with_nothing_of_the_last_one(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 1);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_data(&app, 0, 0, blob, 256));
    tl_app_receive(&app, blob, 1);
    app.parser.bytes_bad = 7;
    app.parser.fill = 3;
    tl_app_bus(&app, true);
    TEST_ASSERT_EQUAL(0, app.parser.fill);
    TEST_ASSERT_EQUAL(0, app.parser.consumed);
    TEST_ASSERT_EQUAL(7, app.parser.bytes_bad);
    TEST_ASSERT_TRUE(tl_app_table_data(&app, 0, 256, blob + 256, 256) != TL_UPLOAD_OK);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
}

static void test_a_session_s_end_ends_a_calibration(void) {
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    tl_app_bus(&app, false);
    TEST_ASSERT_TRUE(app.calibration.host_lost);
    TEST_ASSERT_EQUAL(TL_MOTION_STOPPING, tl_motion_state(&app.calibration.work.motion));
}

static void test_each_axis_hears_each_frame(void) {
    const tl_wire_ping_t ping = {.host_us = 5};
    app.axes[0].guard.alone_ms = app.axes[1].guard.alone_ms = 9;
    (void)fake_ask(TL_WIRE_PING, &ping);
    TEST_ASSERT_EQUAL(0, app.axes[0].guard.alone_ms + app.axes[1].guard.alone_ms);
}

static void test_a_start_by_the_watchdog_is_a_fault_of_each_axis(void) {
    fake.t_us = 123;
    fake_start(3, TL_WIRE_BOOT_WATCHDOG);
    for (uint8_t i = 0; i < 3U; i++) {
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_WATCHDOG, app.axes[i].fault);
        TEST_ASSERT_EQUAL(0, app.axes[i].guard.fault_value);
        TEST_ASSERT_TRUE(app.axes[i].guard.fault_us == 123U);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[3].fault);
}

static void test_a_lost_edge_is_a_fault_of_its_axis_at_its_speed(void) {
    app.axes[1].motor.servo.velocity = 3 << 24; // 3 counts a tick
    fake.slipped[1] = true;
    task_after(999);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[1].fault);
    task_after(1);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_EDGES, app.axes[1].fault);
    TEST_ASSERT_EQUAL(15000, app.axes[1].guard.fault_value);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
}

// What finds no room in the queue is counted.
static void test_events_without_room_are_counted(void) {
    fake_listen();
    app.counters = (tl_wire_counters_t){0};
    uint32_t told = 0;
    while (app.counters.events_dropped == 0U) {
        tl_axis_event(&app.axes[0], TL_WIRE_EVENT_ARRIVED);
        tl_axis_event(&app.axes[0], TL_WIRE_EVENT_SILENT);
        tl_app_task(&app);
        told += 2U;
        TEST_ASSERT_EQUAL(told / 2U, app.counters.silences);
        TEST_ASSERT_EQUAL(told, app.counters.frames_out + app.counters.events_dropped);
    }
    tl_axis_event(&app.axes[0], TL_WIRE_EVENT_ARRIVED);
    const uint32_t dropped = app.counters.events_dropped;
    tl_app_task(&app);
    TEST_ASSERT_EQUAL(dropped + 1U, app.counters.events_dropped);
    TEST_ASSERT_EQUAL(0, app.axes[0].events);
}

static void test_a_sample_is_told_field_by_field(void) {
    tl_axis_t *axis = &app.axes[1];
    fake_listen();
    memset(heard_count, 0, sizeof heard_count);
    axis->telemetry.divider = 2;
    axis->guard.supply_mv = 4321;
    axis->telemetry.head = axis->telemetry.tail = TL_AXIS_SAMPLES - 2U; // around the ring's end
    for (uint32_t i = 0; i < TL_WIRE_BATCH_SAMPLES; i++) {
        const int32_t n = (int32_t)i;
        TEST_ASSERT_EQUAL(0, heard_count[TL_WIRE_BATCH]);
        axis->telemetry.samples[axis->telemetry.head % TL_AXIS_SAMPLES] = (tl_sample_t){(uint32_t)fake.t_us - 5000U + i,
                                                                                        10 + n,
                                                                                        20 + n,
                                                                                        30 + n,
                                                                                        40 + n,
                                                                                        50 + n,
                                                                                        (int16_t)(60 + n),
                                                                                        (uint16_t)(70 + n)};
        axis->telemetry.head++;
        tl_app_task(&app);
        fake_listen();
    }
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_BATCH]);
    TEST_ASSERT_EQUAL(axis->telemetry.head, axis->telemetry.tail);
    const tl_wire_batch_t *batch = &heard[TL_WIRE_BATCH].batch;
    TEST_ASSERT_EQUAL(1, batch->axis);
    TEST_ASSERT_EQUAL(TL_WIRE_BATCH_SAMPLES, batch->count);
    TEST_ASSERT_EQUAL(2000, batch->period_us);
    TEST_ASSERT_EQUAL(4321, batch->supply_mv);
    TEST_ASSERT_TRUE(batch->t_us == fake.t_us - 5000U);
    for (int32_t i = 0; i < (int32_t)TL_WIRE_BATCH_SAMPLES; i++) {
        TEST_ASSERT_EQUAL(10 + i, batch->q_q8[i]);
        TEST_ASSERT_EQUAL(20 + i, batch->q_ref_q8[i]);
        TEST_ASSERT_EQUAL(30 + i, batch->p_q8[i]);
        TEST_ASSERT_EQUAL(40 + i, batch->c_ref_q16[i]);
        TEST_ASSERT_EQUAL(50 + i, batch->c_est_q16[i]);
        TEST_ASSERT_EQUAL(60 + i, batch->duty_q15[i]);
        TEST_ASSERT_EQUAL(70 + i, batch->flags[i]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_axis_is_watched_and_guarded_once_a_millisecond_in_ticks_of_its_own);
    RUN_TEST(test_a_step_is_late_after_two_periods_and_a_fault_after_20_ms);
    RUN_TEST(test_the_watchdog_is_fed_once_a_millisecond_while_steps_go_on);
    RUN_TEST(test_the_rest_of_a_frame_is_waited_for_20_ms);
    RUN_TEST(test_a_restart_waits_for_its_answer_to_leave);
    RUN_TEST(test_a_restart_waits_for_axes_for_10_seconds_at_most);
    RUN_TEST(test_a_session_s_end_takes_telemetry_and_motion_with_it);
    RUN_TEST(test_a_session_begins_with_nothing_of_the_last_one);
    RUN_TEST(test_a_session_s_end_ends_a_calibration);
    RUN_TEST(test_each_axis_hears_each_frame);
    RUN_TEST(test_a_start_by_the_watchdog_is_a_fault_of_each_axis);
    RUN_TEST(test_a_lost_edge_is_a_fault_of_its_axis_at_its_speed);
    RUN_TEST(test_events_without_room_are_counted);
    RUN_TEST(test_a_sample_is_told_field_by_field);
    return UNITY_END();
}
