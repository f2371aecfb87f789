// What a request does and what is answered: to each axis that it names what the axis' own function does, with the
// control step kept out; to the counters what tl_wire.h says of them; to nothing else anything. The axes' functions
// have tests of their own (test_ask_model.c, test_safety.c).
#include "draws.h"
#include "fake_board.h"

#include "tautline/tl_axis_watch.h"
#include "tautline/tl_command.h"

#define LIVES    40
#define REQUESTS 250
#define AXES     3U

static tl_app_t before, after; // the app as it was, and as the model leaves it
static fake_t board;

void setUp(void) {
    seed = 8675309U;
}
void tearDown(void) {}

// -- what is asked ----------------------------------------------------------------------------------------------------

// Those that name an axis first.
static const uint8_t of_axes[] = {
    TL_WIRE_ENABLE,       TL_WIRE_TELEMETRY,   TL_WIRE_SAFE_STOP, TL_WIRE_CLEAR_FAULT,  TL_WIRE_MOVE,
    TL_WIRE_JOG,          TL_WIRE_HOME,        TL_WIRE_CHECK,     TL_WIRE_STRENGTH,     TL_WIRE_ADAPT,
    TL_WIRE_LOAD,         TL_WIRE_ANY_TABLE,   TL_WIRE_SET_POINT, TL_WIRE_FOLLOW,       TL_WIRE_LIMITS,
    TL_WIRE_SET_POSITION, TL_WIRE_MOTION_STOP, TL_WIRE_SERVO,     TL_WIRE_MOTION_START,
};
static const uint8_t others[] = {
    TL_WIRE_HELLO,        TL_WIRE_PING,         TL_WIRE_GET_COUNTERS, TL_WIRE_REBOOT,
    TL_WIRE_ANY_FIRMWARE, TL_WIRE_GET_FIRMWARE, TL_WIRE_GET_LOGGED,   TL_WIRE_GET_STATUS,
    TL_WIRE_GET_LIMITS,   TL_WIRE_GET_SERVO,    TL_WIRE_GET_SETTINGS, TL_WIRE_MARKER,
};

static void draw_request(uint8_t type, uint8_t axis, tl_wire_message_t *m) {
    memset(m, 0, sizeof(*m));
    m->get_status.axis = axis; // the first field of each that has one
    const int32_t somewhere = between(-6000, 6000) * TL_COUNT_ONE;
    const uint32_t key = once_in(4) ? random_u32() : TL_WIRE_KEY;
    switch (type) {
    case TL_WIRE_ENABLE:
        m->enable.on = (uint8_t)between(0, 2);
        break;
    case TL_WIRE_TELEMETRY:
        m->telemetry.divider = (uint8_t)(once_in(4) ? between(59, 62) : between(0, 4));
        break;
    case TL_WIRE_MOVE:
        m->move = (tl_wire_move_t){.axis = axis, .q_q8 = somewhere, .speed_q8_s = between(0, 1) * 300000};
        break;
    case TL_WIRE_JOG:
        m->jog = (tl_wire_jog_t){.axis = axis, .way_q8 = somewhere / 8};
        break;
    case TL_WIRE_HOME:
        m->home = (tl_wire_home_t){.axis = axis, .direction = (int8_t)between(-1, 1), .reach_q8 = abs(somewhere)};
        break;
    case TL_WIRE_STRENGTH:
        m->strength.strength_q15 = between(-2, 40000);
        break;
    case TL_WIRE_ADAPT:
        m->adapt = (tl_wire_adapt_t){.axis = axis, .scale_q15 = between(30000, 36000), .within_ms = 20};
        break;
    case TL_WIRE_LOAD:
        m->load.load_q8 = between(-300, 300);
        break;
    case TL_WIRE_SET_POINT:
        m->set_point = (tl_wire_set_point_t){.axis = axis,
                                             .value = between(-40, 40) * TL_DEG_ONE,
                                             .at_us = once_in(2) ? 0U : fake.t_us + (tl_us_t)between(-3000, 90000)};
        break;
    case TL_WIRE_FOLLOW:
        m->follow = (tl_wire_follow_t){.axis = axis,
                                       .target = (uint8_t)between(0, 2),
                                       .compensation = (uint8_t)between(0, 3),
                                       .silence_us = (uint32_t)between(0, 1) * 300000U};
        break;
    case TL_WIRE_LIMITS:
        m->limits = app.axes[axis % AXES].limits;
        m->limits.axis = axis;
        m->limits.speed_q8_s = once_in(4) ? 0 : between(1000, 16000) * TL_COUNT_ONE;
        break;
    case TL_WIRE_SET_POSITION:
        m->set_position.q_q8 = once_in(4) ? TL_AXIS_RANGE_MAX + 1 : somewhere;
        break;
    case TL_WIRE_SERVO:
        m->servo = (tl_wire_servo_t){axis, between(-1, 900), between(0, 12000), between(0, 600), 1640, 4900, 1300};
        break;
    case TL_WIRE_MOTION_START:
        m->motion_start = fake_calibration();
        m->motion_start.axis = axis;
        m->motion_start.cycles = (uint8_t)between(0, 3);
        break;
    case TL_WIRE_REBOOT:
        m->reboot = (tl_wire_reboot_t){.key = key, .bootloader = (uint8_t)between(0, 1)};
        break;
    case TL_WIRE_ANY_FIRMWARE:
        m->any_firmware.key = key;
        break;
    case TL_WIRE_PING:
        m->ping.host_us = random_u32();
        break;
    case TL_WIRE_GET_COUNTERS:
        m->get_counters.clear = (uint8_t)between(0, 1);
        break;
    case TL_WIRE_GET_LOGGED:
        m->get_logged.index = (uint8_t)between(0, 2);
        break;
    case TL_WIRE_MARKER:
        m->marker = (tl_wire_marker_t){.valid = 1,
                                       .arrival_us = fake.t_us + (tl_us_t)(once_in(3) ? between(-9000, 1) : 0),
                                       .u_q12 = between(0, 4000000)};
        break;
    default:
        break;
    }
}

// -- what is to come of it --------------------------------------------------------------------------------------------

static struct {
    uint8_t reason, type; // why it is refused; what else is answered, 0: nothing
    tl_wire_message_t message;
    bool told; // something that nobody asked for came with it
} answer;

static uint8_t telemetry(tl_axis_telemetry_t *to, uint8_t divider) {
    if (divider > 60U) {
        return TL_WIRE_REASON_RANGE;
    }
    to->divider = divider;
    to->skipped = 0;
    to->tail = to->head;
    return 0;
}

static uint8_t calibration(const tl_axis_t *axis) { // its stop
    if (app.calibration.axis != axis) {
        return TL_WIRE_REASON_NOT_CALIBRATING;
    }
    tl_calibration_stop(&app.calibration, false);
    return 0;
}

static uint8_t set_point(tl_axis_t *axis, const tl_wire_set_point_t *of) {
    bool late = false;
    const uint8_t reason = tl_axis_set_point(axis, of, fake.t_us, &late);
    app.counters.set_points_late += late;
    *(reason == 0 ? &app.counters.set_points : &app.counters.set_points_dropped) += 1U;
    return reason;
}

static uint8_t enable(tl_axis_t *axis, uint8_t on) {
    if (on == 0U) {
        tl_axis_stop(axis, true);
        return 0;
    }
    return on == 1U ? tl_axis_enable(axis) : TL_WIRE_REASON_RANGE;
}

static uint8_t stop(tl_axis_t *axis) {
    tl_axis_fail(axis, TL_WIRE_FAULT_STOPPED, 0, fake.t_us);
    return 0;
}

static uint8_t any_table(uint8_t index) {
    app.tables.in_use[index].any = true;
    return 0;
}

static uint8_t by_itself(uint8_t type, const tl_wire_message_t *m, uint8_t index) {
    tl_axis_t *axis = &app.axes[index];
    switch (type) {
#define ONE(NAME, does)                                                                                                \
    case TL_WIRE_##NAME:                                                                                               \
        return does;
        ONE(ENABLE, enable(axis, m->enable.on))
        ONE(TELEMETRY, telemetry(&axis->telemetry, m->telemetry.divider))
        ONE(SAFE_STOP, stop(axis))
        ONE(CLEAR_FAULT, tl_axis_clear_fault(axis, fake.t_us))
        ONE(MOVE, tl_axis_move(axis, &m->move))
        ONE(JOG, tl_axis_jog(axis, &m->jog))
        ONE(HOME, tl_axis_home(axis, &m->home))
        ONE(CHECK, tl_axis_check(axis))
        ONE(STRENGTH, tl_axis_set_strength(axis, m->strength.strength_q15))
        ONE(ADAPT, tl_axis_adapt(axis, &m->adapt))
        ONE(LOAD, tl_axis_load(axis, &m->load))
        ONE(ANY_TABLE, any_table(index))
        ONE(SET_POINT, set_point(axis, &m->set_point))
        ONE(FOLLOW, tl_axis_follow(axis, &m->follow, fake.t_us))
        ONE(LIMITS, tl_axis_set_limits(axis, &m->limits))
        ONE(SET_POSITION, tl_axis_set_position(axis, m->set_position.q_q8))
        ONE(MOTION_STOP, calibration(axis))
        ONE(SERVO, tl_axis_set_servo(axis, &m->servo))
        ONE(MOTION_START, tl_calibration_start(&app.calibration, axis, &m->motion_start))
    default:
        TEST_FAIL_MESSAGE("a request without a model");
        return 0;
    }
}

static void axes_do(uint8_t type, const tl_wire_message_t *m, uint8_t index) {
    const bool may_be_all = (type == TL_WIRE_ENABLE && m->enable.on == 0U) || type == TL_WIRE_TELEMETRY ||
                            type == TL_WIRE_SAFE_STOP || type == TL_WIRE_CLEAR_FAULT;
    const bool all = index == TL_WIRE_ALL_AXES && may_be_all;
    if (!all && index >= AXES) {
        answer.reason = TL_WIRE_REASON_AXIS;
        return;
    }
    for (uint8_t i = 0; i < AXES; i++) {
        const uint8_t reason = all || i == index ? by_itself(type, m, i) : 0U;
        answer.reason = answer.reason != 0 ? answer.reason : reason; // the first
    }
    answer.type = type == TL_WIRE_SET_POINT ? 0U : TL_WIRE_ACK;
}

static void status(uint8_t index, tl_wire_status_t *out) {
    const tl_axis_t *axis = &app.axes[index];
    const tl_table_in_use_t *table = &app.tables.in_use[index];
    uint32_t ends = 0;
    *out = (tl_wire_status_t){
        .axis = index,
        .mode = axis->mode,
        .fault = axis->fault,
        .flags = (uint16_t)(tl_axis_flags(axis) | (axis->settings.commissioned ? TL_WIRE_FLAG_COMMISSIONED : 0)),
        .table = table->state,
        .table_reason = table->reason,
        .table_sequence = table->sequence,
        .table_crc = table->crc,
        .t_us = fake.t_us,
        .fault_us = axis->guard.fault_us,
        .fault_value = axis->guard.fault_value,
        .q_q8 = axis->q,
        .q_ref_q8 = axis->path.q,
        .c_ref_q16 = axis->tip.c_ref,
        .c_est_q16 = axis->has_table ? tl_lookup_angle(&axis->tip.lookup, axis->tip.play.p, &ends) : 0,
        .duty_q15 = axis->motor.duty,
        .current_ma = axis->guard.current_ma,
        .supply_mv = axis->guard.supply_mv,
        .strength_q15 = axis->tip.strength_q15,
        .settings = app.settings,
    };
}

static void counters(bool clear, tl_wire_counters_t *out) {
    *out = app.counters;
    out->t_us = fake.t_us;
    for (uint8_t i = 0; i < AXES; i++) {
        out->telemetry_dropped += app.axes[i].telemetry.dropped;
        app.axes[i].telemetry.dropped = clear ? 0U : app.axes[i].telemetry.dropped;
    }
    if (clear) {
        app.counters = (tl_wire_counters_t){0};
    }
}

static void gets(uint8_t type, uint8_t index) {
    if (index >= AXES) {
        answer.reason = TL_WIRE_REASON_AXIS;
        return;
    }
    const tl_servo_gains_t *gains = &app.axes[index].motor.servo.gains;
    switch (type) {
    case TL_WIRE_GET_LIMITS:
        answer.type = TL_WIRE_LIMITS;
        answer.message.limits = app.axes[index].limits;
        break;
    case TL_WIRE_GET_SERVO:
        answer.type = TL_WIRE_SERVO;
        answer.message.servo = (tl_wire_servo_t){
            index,          gains->proportional, gains->integral, gains->derivative, gains->feed_forward,
            gains->inertia, gains->friction};
        break;
    case TL_WIRE_GET_SETTINGS:
        answer.type = TL_WIRE_SETTINGS;
        answer.message.settings = app.axes[index].settings;
        break;
    default:
        answer.type = TL_WIRE_STATUS;
        status(index, &answer.message.status);
        break;
    }
}

static void marks(const tl_wire_marker_t *marker) {
    if (app.calibration.axis == NULL || marker->arrival_us > fake.t_us) {
        app.counters.markers_dropped++;
        answer.reason = app.calibration.axis == NULL ? TL_WIRE_REASON_NOT_CALIBRATING : TL_WIRE_REASON_RANGE;
        return;
    }
    tl_calibration_frame(&app.calibration);
    const uint32_t ignored = app.calibration.work.detector.ignored;
    tl_onset_t onset;
    answer.told = tl_calibration_marker(&app.calibration, marker, &onset);
    *(app.calibration.work.detector.ignored != ignored ? &app.counters.markers_dropped : &app.counters.markers) += 1U;
}

static void board_does(uint8_t type, const tl_wire_message_t *m) {
    tl_wire_message_t *out = &answer.message;
    switch (type) {
    case TL_WIRE_HELLO:
        app.update.heard = true;
        answer.type = TL_WIRE_IDENTITY;
        out->identity = (tl_wire_identity_t){.protocol_major = TL_WIRE_MAJOR,
                                             .protocol_minor = TL_WIRE_MINOR,
                                             .firmware = TL_APP_VERSION,
                                             .axes = AXES,
                                             .table_version = 2,
                                             .table_nodes_max = 257,
                                             .control_hz = FAKE_HZ,
                                             .t_us = fake.t_us,
                                             .boot = TL_WIRE_BOOT_POWER,
                                             .driver_ma = FAKE_CHOP,
                                             .port = "fake",
                                             .serial = "TEST",
                                             .build = TL_APP_BUILD};
        break;
    case TL_WIRE_PING:
        answer.type = TL_WIRE_PONG;
        out->pong = (tl_wire_pong_t){.host_us = m->ping.host_us, .t_us = fake.t_us};
        break;
    case TL_WIRE_GET_COUNTERS:
        answer.type = TL_WIRE_COUNTERS;
        counters(m->get_counters.clear != 0U, &out->counters);
        break;
    case TL_WIRE_GET_FIRMWARE:
        answer.type = TL_WIRE_FIRMWARE;
        tl_update_tell(&app.update, &out->firmware);
        break;
    case TL_WIRE_GET_LOGGED:
        answer.type = TL_WIRE_LOGGED;
        tl_fault_log_read(&app.fault_log, m->get_logged.index, &out->logged);
        break;
    case TL_WIRE_ANY_FIRMWARE:
        answer.type = TL_WIRE_ACK;
        app.update.any = m->any_firmware.key == TL_WIRE_KEY;
        answer.reason = app.update.any ? 0U : TL_WIRE_REASON_KEY;
        break;
    case TL_WIRE_MARKER:
        marks(&m->marker);
        break;
    case TL_WIRE_REBOOT:
        answer.type = TL_WIRE_ACK;
        answer.reason = m->reboot.key == TL_WIRE_KEY ? 0U : TL_WIRE_REASON_KEY;
        for (uint8_t i = 0; i < AXES && answer.reason == 0U; i++) {
            tl_axis_stop(&app.axes[i], true);
            app.reboot = m->reboot.bootloader != 0U ? 2U : 1U;
            app.reboot_us = fake.t_us;
        }
        break;
    default:
        gets(type, m->get_status.axis);
        break;
    }
}

// -- both side by side ------------------------------------------------------------------------------------------------

static void same_message(uint8_t type, const void *expected, const void *got) { // structs have padding
    uint8_t frames[2][TL_WIRE_FRAME_MAX];
    const size_t size = tl_wire_frame(frames[0], type, 0, expected);
    tl_wire_frame(frames[1], type, 0, got);
    TEST_ASSERT_EQUAL_MEMORY(frames[0], frames[1], size);
}

#define SAME(field) TEST_ASSERT_EQUAL_MESSAGE(is->field, got->field, #field)

static void same_axis(const tl_axis_t *is, const tl_axis_t *got) {
    SAME(mode);
    SAME(fault);
    SAME(events);
    SAME(closed);
    SAME(silent);
    SAME(referenced);
    SAME(checked);
    SAME(q);
    SAME(path.q);
    SAME(plan.target);
    SAME(plan.stream.used);
    SAME(plan.stream.end);
    SAME(plan.stream.end_us);
    SAME(plan.travel.speed);
    SAME(plan.low);
    SAME(plan.high);
    SAME(plan.motion);
    SAME(guard.fault_us);
    SAME(guard.fault_value);
    SAME(guard.patience);
    SAME(guard.silence_ms);
    SAME(guard.alone_ms);
    SAME(trial.phase);
    SAME(trial.reach);
    SAME(trial.way);
    SAME(history);
    SAME(motor.servo.gains.proportional);
    SAME(motor.servo.gains.integral);
    SAME(tip.strength_q15);
    SAME(tip.compensator.mode);
    SAME(tip.compensator.p);
    SAME(telemetry.divider);
    SAME(telemetry.skipped);
    SAME(telemetry.head);
    SAME(telemetry.tail);
    SAME(telemetry.dropped);
    same_message(TL_WIRE_LIMITS, &is->limits, &got->limits);
    same_message(TL_WIRE_SETTINGS, &is->settings, &got->settings);
}

static void same_board(const tl_app_t *is, const tl_app_t *got) {
    for (uint8_t i = 0; i < AXES; i++) {
        same_axis(&is->axes[i], &got->axes[i]);
        TEST_ASSERT_EQUAL(board.duty[i], fake.duty[i]);
        SAME(tables.in_use[i].any);
    }
    SAME(calibration.axis);
    SAME(calibration.host_lost);
    SAME(calibration.work.motion.state);
    SAME(calibration.work.detector.ignored);
    SAME(update.heard);
    SAME(update.any);
    SAME(reboot);
    SAME(reboot_us);
    SAME(outbox.open);
    same_message(TL_WIRE_COUNTERS, &is->counters, &got->counters);
}

static void ask(uint8_t type, uint8_t index) {
    tl_wire_message_t m;
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const uint16_t sequence = (uint16_t)random_u32();
    draw_request(type, index, &m);
    fake_listen();
    const bool open = !once_in(25);
    app.outbox.open = open;
    const uint32_t room = once_in(10) ? (uint32_t)between(12, 140) : TL_APP_QUEUE;
    app.outbox.head = app.outbox.tail + TL_APP_QUEUE - room;
    before = app;
    board = fake;
    memset(&answer, 0, sizeof(answer));
    app.counters.frames_in++;
    for (uint8_t i = 0; i < AXES; i++) {
        tl_axis_hear(&app.axes[i]);
    }
    if (!open) {
        answer.reason = TL_WIRE_REASON_SESSION;
    } else if (memchr(of_axes, type, sizeof(of_axes)) != NULL) {
        axes_do(type, &m, index);
    } else {
        board_does(type, &m);
    }
    app.counters.requests_refused += answer.reason != 0 ? 1U : 0U;
    answer.type = answer.reason != 0 ? TL_WIRE_ERROR : answer.type;
    if (answer.reason != 0) {
        answer.message.error = (tl_wire_error_t){.request = type, .reason = answer.reason};
    } else if (answer.type == TL_WIRE_ACK) {
        answer.message.ack.request = type;
    }
    const bool sent = answer.type != 0U && tl_wire_size(answer.type) + 12U <= room;
    app.counters.frames_out += sent ? 1U : 0U;
    app.counters.replies_dropped += answer.type != 0U && !sent ? 1U : 0U;
    after = app;
    const fake_t expected = fake;
    app = before;
    fake = board;
    board = expected;
    memset(heard_count, 0, sizeof(heard_count));
    tl_app_receive(&app, frame, tl_wire_frame(frame, type, sequence, &m));
    fake_let_in();
    if (!answer.told) { // else what was found goes out, too
        same_board(&after, &app);
        app.outbox.tail += TL_APP_QUEUE - room; // what was in the way
        fake_listen();
        uint32_t heard_all = 0;
        for (uint32_t i = 0; i < 256U; i++) {
            heard_all += heard_count[i];
        }
        TEST_ASSERT_EQUAL(sent ? 1 : 0, heard_all);
        if (sent) {
            TEST_ASSERT_EQUAL(1, heard_count[answer.type]);
            TEST_ASSERT_EQUAL(sequence, heard_sequence[answer.type]);
            same_message(answer.type, &answer.message, &heard[answer.type]);
        }
    }
    app.outbox.tail = app.outbox.head;
    app.outbox.open = true;
    app.reboot = 0;
}

static void test_a_request_does_what_it_says_and_nothing_else(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    uint32_t done = 0, refused = 0;
    for (uint32_t life = 0; life < LIVES; life++) {
        fake_new(AXES);
        TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(1, blob, fake_table(blob, 1, life)));
        if (!once_in(5)) {
            fake_ready();
        }
        app.axes[2].settings.commissioned = (uint8_t)(life % 3U != 0U);
        for (uint8_t i = 0; i < AXES && life % 2U == 0U; i++) { // some that an open contact stops: nothing is wired
            app.axes[i].settings.estop = once_in(2) ? TL_WIRE_ESTOP_CLOSED : TL_WIRE_ESTOP_OPEN;
        }
        for (uint32_t i = 0; i < REQUESTS; i++) {
            const bool one = !once_in(3);
            const uint8_t index = (uint8_t)(once_in(5) ? 255 - (once_in(6) ? 1 : 0) : between(0, once_in(6) ? 3 : 2));
            ask(one ? of_axes[between(0, sizeof(of_axes) - 1)] : others[between(0, sizeof(others) - 1)], index);
            *(answer.reason == 0 ? &done : &refused) += 1U;
            for (int32_t steps = between(0, 12); steps > 0; steps--) {
                fake_step();
            }
            if (once_in(4)) { // else nearly all would be refused
                const tl_wire_clear_fault_t clear = {.axis = TL_WIRE_ALL_AXES};
                (void)fake_ask(TL_WIRE_CLEAR_FAULT, &clear);
                fake_ready();
                (void)fake_enable((uint8_t)between(0, 2), 1);
            }
            fake.estop_closed = once_in(20) || (fake.estop_closed && !once_in(4));
            if (once_in(20)) {
                app.axes[between(0, 2)].telemetry.dropped += (uint32_t)between(0, 9);
                app.parser.bytes_bad = app.counters.bytes_bad = (uint32_t)between(0, 9);
            }
        }
    }
    TEST_ASSERT_TRUE(done > refused / 2U && refused > done / 4U);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_request_does_what_it_says_and_nothing_else);
    return UNITY_END();
}
