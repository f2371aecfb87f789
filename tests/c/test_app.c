#include "fake_board.h"
#include "random_u32.h"

#include "tautline/tl_axis_ask.h"
#include "tautline/tl_command.h"

void setUp(void) {
    fake_new(3);
}
void tearDown(void) {}

static const uint8_t requests[] = {
    TL_WIRE_HELLO,        TL_WIRE_PING,        TL_WIRE_GET_STATUS, TL_WIRE_GET_COUNTERS, TL_WIRE_ENABLE,
    TL_WIRE_FOLLOW,       TL_WIRE_SET_POINT,   TL_WIRE_MOVE,       TL_WIRE_STRENGTH,     TL_WIRE_SET_POSITION,
    TL_WIRE_LIMITS,       TL_WIRE_GET_LIMITS,  TL_WIRE_SERVO,      TL_WIRE_GET_SERVO,    TL_WIRE_TELEMETRY,
    TL_WIRE_MARKER,       TL_WIRE_MOTION_STOP, TL_WIRE_SAFE_STOP,  TL_WIRE_CLEAR_FAULT,  TL_WIRE_CLEAR_TABLE,
    TL_WIRE_MOTION_START, TL_WIRE_REBOOT,      TL_WIRE_SETTINGS,   TL_WIRE_GET_SETTINGS, TL_WIRE_HOME,
    TL_WIRE_JOG,          TL_WIRE_CHECK,       TL_WIRE_ANY_TABLE};

static void test_hello_names_board_and_versions(void) {
    const tl_wire_hello_t hello = {.protocol_major = 99};
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_HELLO, &hello)); // answered whatever the version
    const tl_wire_identity_t *identity = &heard[TL_WIRE_IDENTITY].identity;
    TEST_ASSERT_EQUAL(TL_WIRE_MAJOR, identity->protocol_major);
    TEST_ASSERT_EQUAL(3, identity->axes);
    TEST_ASSERT_EQUAL(FAKE_HZ, identity->control_hz);
    TEST_ASSERT_EQUAL_STRING("fake", identity->port);
    TEST_ASSERT_EQUAL_STRING("TEST", identity->serial);
    TEST_ASSERT_EQUAL(TL_TABLE_FORMAT, identity->table_version);
}

static void test_unknown_short_and_misdirected_requests_are_refused_with_a_reason(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_ack_t ack = {0};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_UNKNOWN_TYPE, fake_ask(TL_WIRE_ACK, &ack)); // a board's own message
    const tl_wire_get_status_t status = {.axis = 3};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, fake_ask(TL_WIRE_GET_STATUS, &status));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, fake_enable(TL_WIRE_ALL_AXES, 1)); // off only
    TEST_ASSERT_EQUAL(0, fake_enable(TL_WIRE_ALL_AXES, 0));
    const tl_wire_reboot_t reboot = {.key = 1};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_KEY, fake_ask(TL_WIRE_REBOOT, &reboot));
    // A payload cut by one byte, under a right CRC.
    const tl_wire_ping_t ping = {0};
    const size_t size = tl_wire_frame(frame, TL_WIRE_GET_STATUS, 5, &ping);
    TEST_ASSERT_EQUAL(13, size);
    const tl_wire_frame_t cut = {.type = TL_WIRE_PING, .sequence = 77, .size = 7, .payload = frame};
    memset(heard_count, 0, sizeof(heard_count));
    tl_command(&app, &cut);
    fake_listen();
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_ERROR]);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_SHORT, heard[TL_WIRE_ERROR].error.reason);
    TEST_ASSERT_EQUAL(77, heard_sequence[TL_WIRE_ERROR]);
    const tl_wire_get_counters_t counters = {0};
    fake_ask(TL_WIRE_GET_COUNTERS, &counters);
    TEST_ASSERT_EQUAL(5, heard[TL_WIRE_COUNTERS].counters.requests_refused);
}

// Structs have padding: messages are equal where their frames are.
static void assert_same(uint8_t type, const void *expected, const void *got) {
    uint8_t frames[2][TL_WIRE_FRAME_MAX];
    const size_t size = tl_wire_frame(frames[0], type, 0, expected);
    tl_wire_frame(frames[1], type, 0, got);
    TEST_ASSERT_EQUAL_MEMORY(frames[0], frames[1], size);
}

// The control step comes whenever it is not kept out: what it writes is of one go, even while it is, odd before and
// after.
static uint32_t goes;

static void write_in_one_go(void) {
    app.axes[0].guard.fault_us = (tl_us_t)goes << 32 | goes;
    app.axes[0].guard.fault_value = (int32_t)goes;
    app.axes[0].q = app.axes[0].path.q = (tl_count_q8_t)goes;
}
static uint32_t lock_after_a_step(void *context) {
    (void)context;
    goes += 1U + (goes & 1U ? 0U : 1U);
    write_in_one_go();
    return 0;
}
static void unlock_before_a_step(void *context, uint32_t state) {
    (void)context;
    (void)state;
    goes += 1U;
    write_in_one_go();
}

static void test_a_status_is_of_one_moment(void) {
    fake_port.lock = lock_after_a_step;
    fake_port.unlock = unlock_before_a_step;
    goes = 1;
    for (int i = 0; i < 3; i++) {
        const tl_wire_status_t status = fake_status(0);
        const uint32_t go = (uint32_t)status.fault_value;
        TEST_ASSERT_EQUAL_MESSAGE(0, go & 1U, "read while the control step is kept out");
        TEST_ASSERT_EQUAL_UINT64((tl_us_t)go << 32 | go, status.fault_us);
        TEST_ASSERT_EQUAL(go, status.q_q8);
        TEST_ASSERT_EQUAL(go, status.q_ref_q8);
    }
}

// Where the task notes an event with the control step let in, one that comes meanwhile is lost.
static uint8_t let_in_with; // the events noted when the control step was last let in
static bool noted_outside;

static uint32_t lock_and_look(void *context) {
    (void)context;
    noted_outside = noted_outside || app.axes[0].events != let_in_with;
    return 0;
}
static void unlock_and_look(void *context, uint32_t state) {
    (void)context;
    (void)state;
    let_in_with = app.axes[0].events;
}

static void test_no_event_is_lost_to_the_control_step(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 1);
    fake_run_ms(2);
    fake_listen();
    let_in_with = app.axes[0].events;
    noted_outside = false;
    fake_port.lock = lock_and_look;
    fake_port.unlock = unlock_and_look;
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    const tl_wire_safe_stop_t stop = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &stop));
    TEST_ASSERT_EQUAL_MESSAGE(1U << TL_WIRE_EVENT_TABLE | 1U << TL_WIRE_EVENT_FAULT, app.axes[0].events, "both");
    tl_app_task(&app);
    TEST_ASSERT_FALSE(noted_outside);
    fake_listen();
    TEST_ASSERT_EQUAL(2, heard_count[TL_WIRE_EVENT]);
}

static void test_settings_read_back_as_set(void) {
    tl_wire_servo_t servo = {.axis = 1,
                             .proportional = 1,
                             .integral = 2,
                             .derivative = 3,
                             .feed_forward = 4,
                             .inertia = 5,
                             .friction_q15 = 6};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SERVO, &servo));
    const tl_wire_get_servo_t get = {.axis = 1};
    fake_ask(TL_WIRE_GET_SERVO, &get);
    assert_same(TL_WIRE_SERVO, &servo, &heard[TL_WIRE_SERVO]);
    servo.derivative = -1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_SERVO, &servo));
    const tl_wire_get_limits_t ask = {.axis = 2};
    fake_ask(TL_WIRE_GET_LIMITS, &ask);
    tl_wire_limits_t limits = heard[TL_WIRE_LIMITS].limits;
    limits.q_high_q8 = 1000 * TL_COUNT_ONE;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    fake_ask(TL_WIRE_GET_LIMITS, &ask);
    assert_same(TL_WIRE_LIMITS, &limits, &heard[TL_WIRE_LIMITS]);
    limits.q_low_q8 = limits.q_high_q8;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_LIMITS, &limits));
}

static void test_a_reboot_leaves_time_for_its_acknowledgement(void) {
    const tl_wire_reboot_t reboot = {.key = TL_WIRE_KEY, .bootloader = 1};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_REBOOT, &reboot));
    fake_run_ms(10);
    TEST_ASSERT_EQUAL(0, fake.rebooted);
    fake_run_ms(100);
    TEST_ASSERT_EQUAL(2, fake.rebooted);
}

static void test_a_reboot_brings_every_motor_to_rest_first(void) {
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(0, fake_enable(1, 1));
    const tl_wire_move_t move = {.axis = 1, .q_q8 = 3000 * TL_COUNT_ONE};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &move));
    fake_run_ms(50);
    const tl_wire_reboot_t reboot = {.key = TL_WIRE_KEY};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_REBOOT, &reboot));
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING_OFF, app.axes[0].mode);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING_OFF, app.axes[1].mode);
    for (uint32_t ms = 0; ms < 400U; ms++) {
        fake_run_ms(1);
        fake_listen();
    }
    TEST_ASSERT_EQUAL(0, fake.duty[1]);
    TEST_ASSERT_EQUAL(1, fake.rebooted);
}

static void test_replies_that_find_no_room_are_counted_and_input_goes_on(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_ping_t ping = {0};
    const size_t size = tl_wire_frame(frame, TL_WIRE_PING, 0, &ping);
    for (int i = 0; i < 5000; i++) {
        tl_app_receive(&app, frame, size);
    }
    TEST_ASSERT_TRUE(app.counters.replies_dropped > 1000);
    TEST_ASSERT_EQUAL(5000, app.counters.replies_dropped + app.counters.frames_out);
    const tl_wire_safe_stop_t stop = {.axis = 0}; // heard although its answer has no room
    tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_SAFE_STOP, 0, &stop));
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_STOPPED, app.axes[0].fault);
}

static void test_a_new_host_never_sees_what_the_last_one_left(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_ping_t ping = {.host_us = 1};
    const size_t size = tl_wire_frame(frame, TL_WIRE_PING, 1, &ping);
    const tl_wire_telemetry_t on = {.axis = 0, .divider = 1};
    fake_ask(TL_WIRE_TELEMETRY, &on);
    tl_app_receive(&app, frame, size);     // a reply that nobody takes
    tl_app_receive(&app, frame, size - 3); // a request broken off
    fake_run_ms(20);
    tl_app_bus(&app, false);
    fake_run_ms(20);
    tl_app_bus(&app, true);
    fake_run_ms(20);
    uint8_t byte;
    TEST_ASSERT_EQUAL(0, tl_app_transmit(&app, &byte, 1));
    const tl_wire_hello_t hello = {0};
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_HELLO, &hello));
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_IDENTITY]);
}

#define BIT(NAME) (1U << TL_WIRE_FAULT_##NAME)
// Those that this test's world causes in any case; the others are test_safety.c's.
#define FAULTS_EXPECTED                                                                                                \
    (BIT(NONE) | BIT(FOLLOWING) | BIT(CURRENT) | BIT(HOST_LOST) | BIT(TABLE) | BIT(WATCHDOG) | BIT(STOPPED) |          \
     BIT(ENCODER) | BIT(NO_END))
static uint32_t modes_seen;
static uint32_t faults_seen;

static void check_invariants(void) {
    for (uint8_t i = 0; i < fake_port.axes; i++) {
        const tl_axis_t *axis = &app.axes[i];
        modes_seen |= 1U << axis->mode;
        faults_seen |= 1U << axis->fault;
        if (axis->mode == TL_WIRE_MODE_OFF) {
            TEST_ASSERT_EQUAL(0, fake.duty[i]);
        }
        if (axis->fault != TL_WIRE_FAULT_NONE) {
            TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, axis->mode);
        }
        TEST_ASSERT_TRUE(abs(fake.duty[i]) <= axis->limits.duty_q15);
        TEST_ASSERT_TRUE(axis->plan.stream.used <= TL_STREAM_SIZE);
        TEST_ASSERT_TRUE((app.calibration.axis == axis) || axis->history == NULL);
    }
}

// A plausible value for most fields, any bytes for some: the low bytes of the payload are axis and small numbers.
static size_t random_request(uint8_t *frame) {
    uint8_t payload[TL_WIRE_PAYLOAD_MAX];
    const uint8_t type = requests[random_u32() % sizeof(requests)];
    const uint32_t kind = random_u32() % 4U; // 0: any bytes
    for (size_t i = 0; i < sizeof(payload); i++) {
        const uint8_t small = random_u32() % 3U == 0U ? (uint8_t)(random_u32() % 30U) : 0U;
        payload[i] = kind == 0U ? (uint8_t)random_u32() : small;
    }
    if (kind != 0U) {
        payload[0] = (uint8_t)(random_u32() % 8U == 0U ? 0xFFU : random_u32() % 4U);
    }
    tl_wire_message_t message;
    tl_wire_decode(type, payload, sizeof(payload), &message);
    if (type == TL_WIRE_MOTION_START && kind == 1U) {
        message.motion_start = (tl_wire_motion_start_t){.axis = payload[0],
                                                        .cycles = 2,
                                                        .low_q8 = -300000,
                                                        .high_q8 = 300000,
                                                        .speed_q8_s = {100000},
                                                        .transit_q8_s = 400000,
                                                        .acceleration_q8_s2 = 5000000,
                                                        .approach_q8 = 20000,
                                                        .stroke_max_q8 = 100000,
                                                        .host_timeout_us = 100000,
                                                        .delay_us = 50000};
    }
    if (type == TL_WIRE_HOME && kind == 1U) {
        message.home = (tl_wire_home_t){.axis = payload[0], .direction = 1, .reach_q8 = 1 << (random_u32() % 20U)};
    }
    if (type == TL_WIRE_FOLLOW && kind == 1U) {
        message.follow = (tl_wire_follow_t){.axis = payload[0], .target = 1, .compensation = 2, .silence_us = 50000};
    }
    if (type == TL_WIRE_SET_POINT && kind == 1U) {
        message.set_point = (tl_wire_set_point_t){
            .axis = payload[0], .value = (int32_t)random_u32() >> 9, .at_us = fake.t_us + random_u32() % 40000U};
    }
    if (type == TL_WIRE_SETTINGS && kind != 0U) {
        message.settings = tl_axis_default_settings(&fake_port, payload[0]);
        message.settings.key = TL_WIRE_KEY;
    }
    if (type == TL_WIRE_REBOOT && kind == 2U) {
        message.reboot.key = TL_WIRE_KEY;
    }
    if (type == TL_WIRE_MARKER) {
        message.marker.arrival_us = fake.t_us;
    }
    return tl_wire_frame(frame, type, (uint16_t)random_u32(), &message);
}

static void random_upload(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX + 100];
    const uint8_t axis = (uint8_t)(random_u32() % 5U);
    uint32_t size = fake_table(blob, axis % 4U, random_u32());
    if (random_u32() % 2U == 0U) {
        blob[random_u32() % size] ^= (uint8_t)(1U << random_u32() % 8U);
    }
    if (random_u32() % 4U == 0U) {
        size = random_u32() % sizeof(blob);
    }
    fake_upload(axis, blob, size);
    if (random_u32() % 4U == 0U) {
        tl_app_table_data(&app, axis, random_u32() % 3000U, blob, random_u32() % 257U);
        tl_app_table_end(&app, (uint8_t)(random_u32() % 5U));
    }
    tl_app_table_read(&app, (uint8_t)(random_u32() % 5U), random_u32() % 3000U, blob, sizeof(blob));
}

// Requests in and out of order, with any content, between garbage, broken uploads, bus losses, blocked motors and power
// cuts: the board keeps its invariants and answers the next host.
static void test_nothing_that_a_host_sends_breaks_the_board(void) {
    uint32_t answered = 0;
    for (uint32_t run = 1; run <= 8; run++) {
        seed = run * 2654435761U;
        fake_new(1 + (uint8_t)(run % 4U));
        for (int i = 0; i < 4000; i++) {
            uint8_t frame[TL_WIRE_FRAME_MAX];
            const uint32_t what = random_u32() % 64U;
            if (random_u32() % 6U == 0U) { // else nearly everything would be refused
                const tl_wire_clear_fault_t clear = {.axis = TL_WIRE_ALL_AXES};
                tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_CLEAR_FAULT, 0, &clear));
                const uint8_t axis = (uint8_t)(random_u32() % 4U);
                const tl_wire_set_position_t here = {.axis = axis, .q_q8 = (int32_t)(random_u32() % 1000U)};
                tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_SET_POSITION, 0, &here));
                const tl_wire_enable_t enable = {.axis = axis, .on = 1};
                tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_ENABLE, 0, &enable));
            }
            if (what < 52U) {
                size_t size = random_request(frame);
                if (what == 0U) {
                    frame[random_u32() % size] ^= (uint8_t)random_u32();
                } else if (what == 1U) {
                    size = random_u32() % size;
                }
                tl_app_receive(&app, frame, size);
            } else if (what < 54U) {
                for (size_t k = 0; k < sizeof(frame); k++) {
                    frame[k] = (uint8_t)random_u32();
                }
                tl_app_receive(&app, frame, random_u32() % sizeof(frame));
            } else if (what < 56U) {
                random_upload();
            } else if (what == 57U) {
                tl_app_bus(&app, random_u32() % 2U == 0U);
            } else if (what == 58U) {
                fake.blocked = random_u32() % 8U == 0U;
                fake.current_ma = random_u32() % 8U == 0U ? -3000 : 100;
            } else if (what == 59U && random_u32() % 8U == 0U) {
                fake.cut_at = fake.operations + 1U + random_u32() % 20U;
                fake.cut_pattern = random_u32() % 4U;
            } else if (what == 60U && random_u32() % 8U == 0U) {
                fake.position[random_u32() % 4U] += 1e6 * ((double)(random_u32() % 3U) - 1.0);
            }
            if (what == 62U) {
                fake.flash[random_u32() % 1000U + random_u32() % 8U * TL_PORT_FLASH_SECTOR] ^= 1U; // ages badly
            }
            if (fake.dead || fake.rebooted != 0 || (what == 61U && random_u32() % 16U == 0U)) {
                fake_start(fake_port.axes, (tl_wire_boot_t)(random_u32() % 3U));
                random_upload();
            }
            for (uint32_t k = random_u32() % 100U; k > 0U; k--) {
                fake_step();
                check_invariants();
            }
            if (random_u32() % 4U == 0U) {
                fake_listen();
            }
        }
        fake_start(fake_port.axes, TL_WIRE_BOOT_POWER);
        for (unsigned bytes = 0; bytes < TL_WIRE_FRAME_MAX; bytes++) { // ends whatever fake_listen still waits for
            fake_listen();
        }
        const tl_wire_hello_t hello = {0};
        fake_ask(TL_WIRE_HELLO, &hello);
        fake_ask(TL_WIRE_HELLO, &hello);
        answered += heard_count[TL_WIRE_IDENTITY];
    }
    TEST_ASSERT_EQUAL(8, answered);
    TEST_ASSERT_EQUAL_HEX32(0x3FF, modes_seen); // it went everywhere
    TEST_ASSERT_EQUAL_HEX32(FAULTS_EXPECTED, faults_seen & FAULTS_EXPECTED);
}

// What ends with the session ends for each axis that the board has, and for no other.
static void test_the_end_of_a_session_is_for_the_board_s_axes_alone(void) {
    fake_new(TL_APP_AXES - 1);
    app.axes[TL_APP_AXES - 1].telemetry.divider = 7;
    tl_app_bus(&app, true);
    for (uint8_t i = 0; i < TL_APP_AXES - 1; i++) {
        const tl_wire_telemetry_t telemetry = {.axis = i, .divider = 5};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TELEMETRY, &telemetry));
        TEST_ASSERT_EQUAL(5, app.axes[i].telemetry.divider);
    }
    tl_app_bus(&app, false);
    for (uint8_t i = 0; i < TL_APP_AXES - 1; i++) {
        TEST_ASSERT_EQUAL(0, app.axes[i].telemetry.divider);
    }
    TEST_ASSERT_EQUAL(7, app.axes[TL_APP_AXES - 1].telemetry.divider);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_hello_names_board_and_versions);
    RUN_TEST(test_unknown_short_and_misdirected_requests_are_refused_with_a_reason);
    RUN_TEST(test_a_status_is_of_one_moment);
    RUN_TEST(test_no_event_is_lost_to_the_control_step);
    RUN_TEST(test_settings_read_back_as_set);
    RUN_TEST(test_a_reboot_leaves_time_for_its_acknowledgement);
    RUN_TEST(test_a_reboot_brings_every_motor_to_rest_first);
    RUN_TEST(test_replies_that_find_no_room_are_counted_and_input_goes_on);
    RUN_TEST(test_a_new_host_never_sees_what_the_last_one_left);
    RUN_TEST(test_nothing_that_a_host_sends_breaks_the_board);
    RUN_TEST(test_the_end_of_a_session_is_for_the_board_s_axes_alone);
    return UNITY_END();
}
