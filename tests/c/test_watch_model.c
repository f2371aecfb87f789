// What is told of an axis, field by field: the flags of each state, a telemetry sample, a calibration's messages; and
// set-points joined by straight lines, the header of a frame.
#include "draws.h"
#include "silent_port.h"
#include "table_fixture.h"
#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_calibration.h"
#include "tautline/tl_crc.h"
#include "tautline/tl_stream.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

static tl_axis_t axes[3], *axis = &axes[1];

void setUp(void) {
    seed = 998877U;
}
void tearDown(void) {}

static bool pressed;
static bool is_pressed(void *context) {
    (void)context;
    return pressed;
}
static uint32_t lock(void *context) {
    (void)context;
    return 0;
}
static void unlock(void *context, uint32_t state) {
    (void)context;
    (void)state;
}
static const tl_port_t port = {.control_hz = 5000,
                               .axes = 3,
                               .time_us = no_time,
                               .encoder = no_encoder,
                               .drive = no_drive,
                               .estop_closed = is_pressed,
                               .lock = lock,
                               .unlock = unlock};

static const uint8_t modes[] = {TL_WIRE_MODE_OFF,        TL_WIRE_MODE_HOLD,         TL_WIRE_MODE_MOVE,
                                TL_WIRE_MODE_HOME,       TL_WIRE_MODE_CHECK,        TL_WIRE_MODE_FOLLOW_MOTOR,
                                TL_WIRE_MODE_FOLLOW_TIP, TL_WIRE_MODE_CALIBRATE,    TL_WIRE_MODE_STOPPING,
                                TL_WIRE_MODE_FOLLOW_TIP, TL_WIRE_MODE_STOPPING_OFF, TL_WIRE_MODE_FOLLOW_TIP};

static void any_axis(void) {
    for (uint8_t i = 0; i < 3U; i++) {
        tl_axis_init(&axes[i], &port, i);
        axes[i].q = any(28);
    }
    tl_axis_enter(axis, (tl_wire_mode_t)modes[between(0, (int32_t)sizeof modes - 1)]);
    axis->q = any(31);
    axis->path.q = any(28);
    axis->fault = once_in(4) ? TL_WIRE_FAULT_STALL : TL_WIRE_FAULT_NONE;
    axis->silent = once_in(2);
    axis->referenced = once_in(2);
    axis->checked = once_in(2);
    axis->guard.driver_ms = (uint8_t)between(0, 1);
    axis->guard.pushed = (uint8_t)between(0, 3);
    axis->motor.servo.pushed = (uint32_t)between(0, 3);
    axis->plan.reference.velocity = between(0, 1);
    axis->plan.reference.clamped = once_in(2);
    axis->plan.reference.behind = once_in(2);
    axis->trial.duty = once_in(2) ? 0 : any(3);
    axis->motor.duty = any(16);
    axis->tip.compensator.flags = random_u32() & 0x7FU;
    axis->tip.c_ref = any(30);
    axis->plan.c_last[0] = any(30);
    axis->plan.c_last[1] = any(30);
    axis->plan.c_next = any(30);
}

// -- flags ------------------------------------------------------------------------------------------------------------

static uint32_t flag(bool is, uint32_t value) {
    return is ? value : 0U;
}

static uint32_t expected_flags(uint32_t pushed, bool clamped, bool behind) {
    const bool tip = axis->mode == TL_WIRE_MODE_FOLLOW_TIP, on = axis->mode != TL_WIRE_MODE_OFF;
    const uint32_t now = axis->tip.compensator.flags;
    const uint32_t beyond = TL_COMPENSATOR_BELOW | TL_COMPENSATOR_ABOVE | TL_COMPENSATOR_CLIPPED;
    const uint32_t slower = TL_COMPENSATOR_LIMITED | TL_COMPENSATOR_FLAT;
    return flag(on, 0x1U) | flag(axis->plan.reference.velocity == 0 && axis->trial.duty == 0, 0x2U) |
           flag(axis->fault != 0, 0x4U) | flag((on && clamped) || (tip && (now & beyond) != 0U), 0x8U) |
           flag((on && behind && axis->mode != TL_WIRE_MODE_MOVE) || (tip && (now & slower) != 0U), 0x10U) |
           flag(pushed != 0U, 0x20U) | flag(tip && (now & TL_COMPENSATOR_TAKE_UP) != 0U, 0x40U) | flag(tip, 0x80U) |
           flag(axis->silent, 0x100U) | flag(axis->referenced, 0x200U) | flag(axis->checked, 0x400U) |
           flag(axis->guard.driver_ms != 0U, 0x800U);
}

static void test_flags_sample_and_what_is_handed_on(void) {
    static tl_history_t history;
    for (uint32_t i = 0; i < 6000U; i++) {
        any_axis();
        tl_history_init(&history);
        axis->history = once_in(2) ? &history : NULL;
        const int32_t c_mean = (axis->plan.c_last[0] >> 1) + (axis->plan.c_last[1] >> 1), now = axis->plan.c_last[0];
        const uint32_t pushed = axis->motor.servo.pushed, before = axis->guard.pushed;
        axis->telemetry.divider = (uint8_t)between(0, 3);
        axis->telemetry.skipped = (uint8_t)between(0, axis->telemetry.divider > 0 ? axis->telemetry.divider - 1 : 0);
        axis->telemetry.head = random_u32();
        const uint32_t waiting = once_in(4) ? TL_AXIS_SAMPLES - (uint32_t)between(0, 1) : (uint32_t)between(0, 511);
        axis->telemetry.tail = axis->telemetry.head - waiting;
        const uint32_t head = axis->telemetry.head, skipped = axis->telemetry.skipped + 1U;
        const int32_t q = tl_clamp(axis->q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
        const tl_us_t now_us = UINT64_C(0x123456789) + random_u32();
        tl_axis_watch(axis, now_us);
        TEST_ASSERT_EQUAL_INT32(q, axis->q);
        TEST_ASSERT_EQUAL_INT32(c_mean, axis->tip.c_ref);
        TEST_ASSERT_EQUAL_INT32(now, axis->plan.c_last[1]);
        TEST_ASSERT_EQUAL_INT32(axis->plan.c_next, axis->plan.c_last[0]);
        TEST_ASSERT_TRUE(axis->plan.stream.now_us == now_us + axis->plan.lead_us);
        TEST_ASSERT_EQUAL_UINT32(before | pushed, axis->guard.pushed);
        TEST_ASSERT_EQUAL_UINT32(0, axis->motor.servo.pushed);
        TEST_ASSERT_EQUAL_UINT32(axis->history != NULL ? 1U : 0U, history.kept);
        const tl_reference_t *reference = &axis->plan.reference;
        const uint32_t flags = expected_flags(pushed, reference->clamped, reference->behind);
        TEST_ASSERT_EQUAL_HEX32(flags, tl_axis_flags(axis));
        const tl_axis_telemetry_t *telemetry = &axis->telemetry;
        const bool due = telemetry->divider != 0U && skipped == telemetry->divider;
        const bool full = waiting == TL_AXIS_SAMPLES;
        TEST_ASSERT_EQUAL_UINT32(head + (due && !full ? 1U : 0U), telemetry->head);
        TEST_ASSERT_EQUAL_UINT32(due && full ? 1U : 0U, telemetry->dropped);
        TEST_ASSERT_EQUAL_UINT32(due ? 0U : (telemetry->divider != 0U ? skipped : skipped - 1U), telemetry->skipped);
        if (due && !full) {
            const tl_sample_t *s = &telemetry->samples[head % TL_AXIS_SAMPLES];
            const int32_t duty = axis->motor.duty;
            TEST_ASSERT_EQUAL_UINT32((uint32_t)now_us, s->t_us);
            TEST_ASSERT_EQUAL_INT32(q, s->q);
            TEST_ASSERT_EQUAL_INT32(axis->path.q, s->q_ref);
            TEST_ASSERT_EQUAL_INT32(q, s->p); // without a table nothing is known of the tip
            TEST_ASSERT_EQUAL_INT32(0, s->c_est);
            TEST_ASSERT_EQUAL_INT32(c_mean, s->c_ref);
            TEST_ASSERT_EQUAL_INT32(duty > 32767 ? 32767 : (duty < -32768 ? -32768 : duty), s->duty);
            TEST_ASSERT_EQUAL_HEX32(flags, s->flags);
        }
    }
}

// The forward play goes on with the motor, and knows where the axes are that move its angle, or the motor before it.
static void watch_the_tip(int32_t before_q20) {
    tl_table_t table = table_fixture(1);
    table.has = TL_TABLE_HAS_joints;
    table.axis = 1;
    table.joints.axis[0] = 3;
    table.joints.axis[2] = 1;
    table.joints.slope[0] = table.joints.slope[2] = 1000;
    if (before_q20 != 0) {
        table.has |= TL_TABLE_HAS_before;
        table.joints.slope[2] = 0;
        table.before.slope_q20[2] = before_q20;
    }
    any_axis();
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_lookup_derive(&axis->tip.lookup, &table, TL_TABLE_ANY_AXIS));
    axis->q = 0;
    axes[0].q = 7654321;
    tl_axis_use_table(axis, true);
    tl_play_t play = axis->tip.play;
    TEST_ASSERT_EQUAL_INT32((axes[0].q >> 4) * (before_q20 >> 10) / (1 << 6), play.p);
    axis->telemetry.divider = 1;
    for (uint32_t i = 0; i < 3000U; i++) {
        axis->q = tl_clamp(axis->q + any(15), -5000 * TL_COUNT_ONE, 5000 * TL_COUNT_ONE);
        axes[0].q = any(20);
        axes[2].q = any(20);
        axis->telemetry.tail = axis->telemetry.head;
        tl_axis_watch(axis, i);
        const int32_t *joint = axis->tip.compensator.undo.moved.joint;
        TEST_ASSERT_EQUAL_INT32(axes[2].q, joint[0]);
        TEST_ASSERT_EQUAL_INT32(0, joint[1]);
        TEST_ASSERT_EQUAL_INT32(axes[0].q, joint[2]);
        const int32_t p = tl_play_step(&play, axis->q + (axes[0].q >> 4) * (before_q20 >> 10) / (1 << 6));
        TEST_ASSERT_EQUAL_INT32(p, axis->tip.play.p);
        const tl_sample_t *s = &axis->telemetry.samples[(axis->telemetry.head - 1U) % TL_AXIS_SAMPLES];
        TEST_ASSERT_EQUAL_INT32(p, s->p);
        TEST_ASSERT_EQUAL_INT32(tl_play_angle(&play), s->c_est);
    }
}

static void test_the_tip_is_watched(void) {
    watch_the_tip(0);
    watch_the_tip(1 << 18); // a quarter of a count each
    watch_the_tip(1 << 19);
}

// -- a calibration's messages -----------------------------------------------------------------------------------------

static void test_an_onset_is_told_field_by_field(void) {
    static tl_calibration_t calibration;
    any_axis();
    calibration.axis = axis;
    calibration.reversals = 12;
    const tl_onset_t onset = {.turn_us = 1,
                              .start_us = 2,
                              .q1 = 3,
                              .q2 = 4,
                              .width = 5,
                              .sigma = 6,
                              .stop = 7,
                              .sigma_stop = 8,
                              .speed_stop = 9,
                              .speed_start = 10,
                              .slope = 11,
                              .noise = 12,
                              .direction = -1,
                              .reason = 13,
                              .started = true,
                              .frames = 14};
    tl_wire_onset_t m;
    tl_calibration_onset_message(&calibration, &onset, &m);
    const int64_t expected[] = {1, -1, 13, 11, 14, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
    const int64_t got[] = {m.axis,
                           m.direction,
                           m.reason,
                           m.index,
                           m.frames,
                           (int64_t)m.turn_us,
                           (int64_t)m.start_us,
                           m.q1_q8,
                           m.q2_q8,
                           m.width_q8,
                           m.sigma_q8,
                           m.stop_q8,
                           m.sigma_stop_q8,
                           m.speed_stop_q8_s,
                           m.speed_start_q8_s,
                           m.slope_q12,
                           m.noise_q12};
    TEST_ASSERT_EQUAL_INT64_ARRAY(expected, got, sizeof got / sizeof got[0]);
    tl_wire_progress_t progress;
    tl_calibration_progress_message(&calibration, axis, 3, 99, &progress);
    TEST_ASSERT_EQUAL(1, progress.axis);
    TEST_ASSERT_EQUAL(3, progress.state);
    TEST_ASSERT_EQUAL(12, progress.reversals);
    TEST_ASSERT_TRUE(progress.t_us == 99U);
}

// How it ends, by the motion's state, the axis' mode and its fault.
static void test_how_a_calibration_ends(void) {
    static tl_calibration_t calibration;
    for (uint32_t i = 0; i < 3000U; i++) {
        any_axis();
        memset(&calibration, 0, sizeof calibration);
        calibration.axis = once_in(9) ? NULL : axis;
        calibration.host_lost = once_in(4);
        const tl_motion_state_t motion = (tl_motion_state_t)between(TL_MOTION_RUNNING, TL_MOTION_HOST_LOST);
        calibration.work.motion.state = (uint8_t)motion;
        const bool calibrates = axis->mode == TL_WIRE_MODE_CALIBRATE, had_fault = axis->fault != TL_WIRE_FAULT_NONE;
        const bool goes_on = calibrates && (motion == TL_MOTION_RUNNING || motion == TL_MOTION_STOPPING);
        const bool ends = calibration.axis != NULL && !goes_on;
        const bool lost = motion == TL_MOTION_HOST_LOST || calibration.host_lost;
        const uint8_t mode = axis->mode;
        axis->history = &calibration.work.history;
        uint8_t how = 200;
        TEST_ASSERT_EQUAL(ends, tl_calibration_ended(&calibration, 5, &how));
        if (!ends) {
            TEST_ASSERT_EQUAL(200, how);
            TEST_ASSERT_NOT_NULL(axis->history);
            continue;
        }
        TEST_ASSERT_NULL(calibration.axis);
        TEST_ASSERT_NULL(axis->history);
        TEST_ASSERT_EQUAL(had_fault ? TL_WIRE_MOTION_FAILED
                                    : (lost ? TL_WIRE_MOTION_HOST_LOST
                                            : (calibrates ? (tl_wire_motion_t)motion : TL_WIRE_MOTION_STOPPED)),
                          how);
        TEST_ASSERT_EQUAL(!had_fault && lost ? TL_WIRE_MODE_OFF
                                             : (!had_fault && calibrates ? TL_WIRE_MODE_STOPPING : mode),
                          axis->mode);
        TEST_ASSERT_EQUAL(!had_fault && lost ? TL_WIRE_FAULT_HOST_LOST : (had_fault ? TL_WIRE_FAULT_STALL : 0),
                          axis->fault);
    }
}

// -- set-points -------------------------------------------------------------------------------------------------------

typedef struct {
    double at, value; // microseconds
} point_t;

static void test_set_points_are_joined_by_straight_lines(void) {
    for (uint32_t life = 0; life < 200U; life++) {
        const uint32_t ticks = once_in(2) ? 5U : 10U;
        const double tick_us = 1000.0 / ticks;
        tl_stream_t stream = {.first = (uint32_t)between(0, 31)};
        int32_t value = any(30);
        tl_stream_start(&stream, value, ticks);
        stream.now_us = 1000000U;
        point_t points[64] = {{1000000.0, value}};
        uint32_t count = 1, waiting = 0, gone = 0;
        for (uint32_t ms = 0; ms < 400U; ms++) {
            while (once_in(3) && count < 64U) {
                const uint32_t way = once_in(3) ? (uint32_t)between(0, 1500) : (uint32_t)between(0, 60000);
                const tl_us_t start = tl_stream_end(&stream);
                TEST_ASSERT_TRUE(start == (stream.end_us > stream.now_us ? stream.end_us : stream.now_us));
                value = any(30);
                const bool room = waiting < TL_STREAM_SIZE;
                TEST_ASSERT_EQUAL(room, tl_stream_add(&stream, value, start + way));
                if (!room) {
                    break;
                }
                const double whole = floor((way > 1000U ? way : 1000.0) / tick_us + 0.5) * tick_us;
                if ((double)start > points[count - 1U].at) { // it rested meanwhile
                    points[count] = points[count - 1U];
                    points[count++].at = (double)start;
                }
                points[count++] = (point_t){(double)start + whole, value};
                waiting++;
                if (count > 62U) {
                    break;
                }
            }
            stream.now_us += 1000U;
            const int32_t got = tl_stream_next(&stream);
            while (gone + 1U < count && points[gone + 1U].at <= (double)stream.now_us) {
                gone++;
            }
            waiting = stream.used;
            const point_t *a = &points[gone], *b = &points[gone + 1U < count ? gone + 1U : gone];
            const double share = b->at > a->at ? ((double)stream.now_us - a->at) / (b->at - a->at) : 0.0;
            TEST_ASSERT_TRUE(fabs(a->value + (b->value - a->value) * share - got) <= 2.0);
            if (a == b || a->at == (double)stream.now_us) { // at its end, and where it rests
                TEST_ASSERT_EQUAL_INT32((int32_t)a->value, got);
            }
        }
    }
}

// -- a frame's header -------------------------------------------------------------------------------------------------

// tl_wire.h: magic, type, check, length, sequence, little-endian; a sum that is rotated by a bit before each byte of
// the others, from 5A on; and CRC-32 over all before it.
static void test_a_frame_is_its_bytes(void) {
    for (uint32_t i = 0; i < 2000U; i++) {
        const tl_wire_ping_t ping = {.host_us = (uint64_t)random_u32() << 32 | random_u32()};
        const uint16_t sequence = (uint16_t)random_u32();
        uint8_t frame[TL_WIRE_FRAME_MAX];
        const size_t size = tl_wire_frame(frame, TL_WIRE_PING, sequence, &ping);
        TEST_ASSERT_EQUAL(20, size);
        uint8_t expected[20] = {(uint8_t)TL_WIRE_MAGIC, (uint8_t)(TL_WIRE_MAGIC >> 8), TL_WIRE_PING, 0, 8, 0,
                                (uint8_t)sequence,      (uint8_t)(sequence >> 8)};
        uint32_t sum = 0x5A;
        for (uint32_t k = 0; k < 8U; k++) {
            sum = k == 3U ? sum : ((sum << 1 | sum >> 7) + expected[k]) & 0xFFU;
        }
        expected[3] = (uint8_t)sum;
        for (uint32_t k = 0; k < 8U; k++) {
            expected[8U + k] = (uint8_t)(ping.host_us >> (8U * k));
        }
        const uint32_t crc = tl_crc32(0, expected, 16);
        for (uint32_t k = 0; k < 4U; k++) {
            expected[16U + k] = (uint8_t)(crc >> (8U * k));
        }
        TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, frame, 20);
    }
}

// A byte that cannot stand there is dropped with what came before it as soon as it comes.
static void test_what_is_no_frame_is_dropped_at_once(void) {
    const tl_wire_ping_t ping = {.host_us = 1};
    uint8_t frame[TL_WIRE_FRAME_MAX];
    (void)tl_wire_frame(frame, TL_WIRE_PING, 0x1234, &ping);
    for (uint32_t wrong = 0; wrong < TL_WIRE_HEADER_SIZE; wrong++) {
        tl_wire_parser_t parser = {.fill = 0};
        tl_wire_frame_t got;
        for (uint32_t i = 0; i < TL_WIRE_HEADER_SIZE; i++) {
            const uint8_t byte = (uint8_t)(frame[i] ^ (i == wrong ? 0x40U : 0U)), *bytes = &byte;
            size_t size = 1;
            TEST_ASSERT_FALSE(tl_wire_parse(&parser, &bytes, &size, &got));
            // of the magic's two bytes at once; of the others once the check can be made
            const bool known = wrong < 2U ? i >= wrong : i + 1U == TL_WIRE_HEADER_SIZE;
            TEST_ASSERT_EQUAL_UINT32(known ? i + 1U : 0U, parser.bytes_bad);
            if (known) {
                TEST_ASSERT_EQUAL_UINT32(0, parser.fill);
                break;
            }
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_flags_sample_and_what_is_handed_on);
    RUN_TEST(test_the_tip_is_watched);
    RUN_TEST(test_an_onset_is_told_field_by_field);
    RUN_TEST(test_how_a_calibration_ends);
    RUN_TEST(test_set_points_are_joined_by_straight_lines);
    RUN_TEST(test_a_frame_is_its_bytes);
    RUN_TEST(test_what_is_no_frame_is_dropped_at_once);
    return UNITY_END();
}
