// Runs the control step and the onset update over random valid tables, commands and plants, for measure.js to count
// their cycles: the very objects of the image, in RAM like there. BKPT 0xd0 begins a measurement of the kind in r0,
// 0xd1 ends it, 0xd2 ends the program.
#include <string.h>

#include "pico.h"
#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_guard.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_axis_step.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_onset.h"

enum {
    STEP_TIP,
    STEP_OTHER,
    WATCH,
    GUARD,
    MOTION,
    ONSET,
    STEP_PLAYS,
    WATCH_PLAYS,
    STEP_UNDOES,
    WATCH_UNDOES,
    LOOKUP,
    LOOKUP_YARDSTICK,
    EMPTY
};
enum { TABLES = 90, PLAY_TABLES = 45, TICKS = 300, RATE_HZ = 5000, MOTIONS = 600, REVERSALS = 500 };

#define BEGIN(kind)                                                                                                    \
    do {                                                                                                               \
        register uint32_t r0_ __asm__("r0") = (kind);                                                                  \
        __asm__ volatile("bkpt 0xd0" : : "r"(r0_) : "memory");                                                         \
    } while (0)
#define END() __asm__ volatile("bkpt 0xd1" : : : "memory")

static uint32_t seed = 1;

static uint32_t any(void) {
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed;
}

static int32_t between(int32_t low, int32_t high) {
    return low + (int32_t)(any() % ((uint32_t)(high - low) + 1u));
}

// -- a port without registers: what remains is the step itself
// ---------------------------------------------------------

static int32_t encoder_count;
static int32_t current;
static tl_duty_q15_t driven;

static tl_us_t __not_in_flash_func(no_time)(void *context) {
    (void)context;
    return 0;
}
static int32_t __not_in_flash_func(read_encoder)(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return encoder_count;
}
static void __not_in_flash_func(take_drive)(void *context, uint8_t axis, tl_duty_q15_t duty) {
    (void)context;
    (void)axis;
    driven = duty;
}
static int32_t __not_in_flash_func(read_current)(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return current;
}

static uint16_t __not_in_flash_func(read_supply)(void *context) {
    (void)context;
    return 6000;
}
static bool __not_in_flash_func(read_fault)(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return false;
}

static uint32_t keep_out(void *context) {
    (void)context;
    return 0;
}
static void let_in(void *context, uint32_t state) {
    (void)context;
    (void)state;
}

static const tl_port_t port = {.name = "cycles",
                               .axes = 1,
                               .control_hz = RATE_HZ,
                               .time_us = no_time,
                               .encoder = read_encoder,
                               .drive = take_drive,
                               .current_ma = read_current,
                               .supply_mv = read_supply,
                               .lock = keep_out,
                               .unlock = let_in,
                               .driver_fault = read_fault};

// -- random valid tables
// ---------------------------------------------------------------------------------------------------

static tl_axis_t axis;
static tl_motion_t motion;
static tl_history_t history;
static tl_onset_detector_t detector;

static void make_table(tl_table_t *table) {
    do {
        memset(table, 0, sizeof(*table));
        const int32_t log2 = between(0, 4) == 0 ? between(15, 21) : between(4, 14);
        const int32_t step = 1 << log2;
        const int32_t nodes = between(0, 9) == 0 ? 0 : (between(0, 3) == 0 ? between(2, 257) : between(129, 257));
        const bool falling = between(0, 1) == 1;
        table->nodes = (uint16_t)nodes;
        table->step_log2 = nodes > 0 ? (uint8_t)log2 : 0;
        table->strength_q15 = (uint16_t)(between(0, 1) == 0 ? 32768 : between(0, 32768));
        table->nano_units_per_count = 1000;
        table->q0 = nodes > 0 ? between(-1000000, 0) - (log2 > 14 ? nodes / 2 * step : 0) : 0;
        table->q_min = nodes > 0 ? table->q0 : -100000;
        table->q_max = nodes > 0 ? table->q0 + (nodes - 1) * step : 100000;
        if (between(0, 1) == 0 && nodes > 8) {
            table->q_min += between(0, step);
            table->q_max -= between(0, step);
        }
        table->speed_max_q8 = between(1000, 16000) * 256;
        table->takeup_speed_q8 = between(500, 16000) * 256;
        table->takeup_accel = between(10000, 200000);
        table->band = between(0, 1) == 0 ? 0 : between(0, 2000);
        table->flat_speed_q8 = between(100, 2000) * 256;
        table->slope_min_q28 = between(0, 1) == 0 ? 0 : between(0, 1 << 20);
        const int32_t steepest = between(0, 3) == 0 ? 1 << between(15, 21) : 20000;
        int32_t width = between(0, 500000);
        int32_t angle = between(-3000000, 3000000);
        const int32_t first = angle;
        for (int32_t i = 0; i < nodes; i++) {
            table->width[i] = width;
            table->angle[i] = angle;
            width += between(-step / 10 * 17, step / 10 * 17);
            width = tl_clamp(width, 0, 600000);
            const int32_t rise = between(0, 6) == 0 ? between(1, 3) : between(1, steepest);
            angle += falling ? -rise : rise;
        }
        table->coarse_c_min = first;
        table->coarse_c_max = nodes > 0 ? angle : first + (falling ? -1000000 : 1000000);
    } while (tl_table_check(table, 0) != TL_TABLE_OK);
}

// The same with several plays: a width that varies little, so that 1 / B adds up to a warp.
static void add_plays(tl_table_t *table) {
    const int32_t step = 1 << table->step_log2, width = between(step / 2, 20 * step) + 1;
    uint32_t weights[TL_TABLE_PLAYS_MAX], widths[TL_TABLE_PLAYS_MAX], rises = 0;
    uint64_t weight = 0, mean = 0;
    table->plays = (uint8_t)(between(0, 2) == 0 ? between(2, TL_TABLE_PLAYS_MAX) : TL_TABLE_PLAYS_MAX);
    for (uint32_t i = 0; i < table->plays; i++) {
        weights[i] = (uint32_t)between(1000, 3000);
        rises += (uint32_t)between(i == 0 ? 0 : 1, 1000);
        widths[i] = rises;
        weight += weights[i];
        mean += (uint64_t)weights[i] * widths[i];
    }
    uint32_t left = 65536;
    for (uint32_t i = 0; i < table->plays; i++) {
        const uint32_t share = (uint32_t)(((uint64_t)weights[i] << 16) / weight);
        table->play_weight_q16[i] = i + 1U < table->plays ? share : left;
        left -= share;
        table->play_width_q28[i] = (uint32_t)(((uint64_t)widths[i] * weight << 28) / mean);
    }
    table->narrow = between(0, 1) == 0 ? 0 : width + between(0, 8) * (step / 256);
    table->period_log2 = (uint8_t)(between(0, 1) == 0 ? between(16, 20) : 20);
    int64_t y = -((int64_t)1 << 27);
    for (uint32_t i = 0; i < table->nodes; i++) {
        table->width[i] = width + (int32_t)(i % 64U < 32U ? i % 32U : 32U - i % 32U) * (step / 256);
        table->centre[i] = (int32_t)y;
        y += ((int64_t)step << table->period_log2) / table->width[i];
    }
}

static void make_plays(tl_table_t *table) {
    do {
        make_table(table);
        if (table->nodes > 1) {
            add_plays(table);
        }
    } while (table->plays == 0 || tl_lookup_derive(&axis.tip.lookup, table, 0) != TL_TABLE_OK);
}

static void small_table(int32_t values[TL_TABLE_LAST + 1U], int32_t most) {
    values[0] = between(0, most);
    for (uint32_t i = 1; i <= TL_TABLE_LAST; i++) {
        values[i] = values[i - 1U] - between(0, values[i - 1U] < 16 ? values[i - 1U] : 16);
    }
}

// What goes with the place as B does, as far as a table may say it.
static void add_pressed(tl_table_t *table) {
    int64_t sum = 0;
    for (uint32_t i = 0; i < table->nodes; i++) {
        sum += table->width[i];
    }
    table->pressed.mean = (int32_t)(sum / table->nodes) + 1;
    table->pressed.sides_q16 = (table->has & TL_TABLE_HAS_sides) != 0 ? between(0, 2 << 16) : 0;
    table->pressed.speed_q16 = (table->has & TL_TABLE_HAS_speed) != 0 ? between(0, 2 << 16) : 0;
    table->has |= TL_TABLE_HAS_pressed;
    if (tl_table_check(table, 0) == TL_TABLE_BAD_PRESSED) {
        table->pressed.sides_q16 = table->pressed.speed_q16 = 0; // taken once all the same, and as long
    }
    if (tl_table_check(table, 0) == TL_TABLE_BAD_PRESSED) {
        table->has &= ~(uint32_t)TL_TABLE_HAS_pressed;
        table->pressed = (tl_table_pressed_t){.mean = 0};
    }
}

// All that is undone beside plays and curve, or some of it.
static void add_sections(tl_table_t *table) {
    const bool all = between(0, 1) == 0;
    for (uint32_t i = 2; i <= 8; i++) {
        table->has |= all || between(0, 1) == 0 ? 1U << i : 0;
    }
    table->has |= (table->has & TL_TABLE_HAS_sides) != 0 ? (uint32_t)TL_TABLE_HAS_anew : 0;
    table->has |= (table->has & TL_TABLE_HAS_joints) != 0 ? (uint32_t)TL_TABLE_HAS_before : 0;
    table->encoder = (tl_table_encoder_t){.period_q12 = between(1 << 20, 1 << 26)};
    const int32_t most = table->encoder.period_q12 / 2000 < 20000 ? table->encoder.period_q12 / 2000 : 20000;
    table->encoder.sine = between(-most, most);
    table->encoder.cosine = between(-most, most);
    table->encoder.sine2 = between(0, 3) == 0 ? 0 : between(-most, most);
    table->sides.side = between(0, 1) == 0 ? 1 : -1;
    table->sides.step_log2 = between(4, 12);
    small_table(table->sides.late, 20000);
    table->anew.rest_us = 1; // after a tick already: as often as may be
    table->speed.step_log2 = between(8, 16);
    table->speed.time_us = between(0, 200000);
    table->speed.held = between(0, 1);
    small_table(table->speed.extra, 20000);
    const int32_t followers = between(0, 1) == 0 ? (int32_t)TL_TABLE_LATE_MAX : between(0, TL_TABLE_LATE_MAX);
    for (int32_t i = 0; i < followers; i++) {
        table->late.gain_q16[i] = between(-400000, 1000000);
        table->late.time_us[i] = between(1000, between(0, 1) == 0 ? 10000 : 5000000);
    }
    table->load = (tl_table_load_t){.reference = between(-2560, 2560),
                                    .width = between(-50000, 50000),
                                    .gain = between(-50000, 50000),
                                    .offset = between(-200000, 200000),
                                    .middle = table->angle[table->nodes / 2U]};
    const int32_t joints = between(0, 1) == 0 ? (int32_t)TL_TABLE_JOINTS : between(0, TL_TABLE_JOINTS);
    for (int32_t i = 0; i < joints; i++) {
        table->joints.axis[i] = 2 + i;
        table->joints.play[i] = between(0, 10000);
        const bool before = (table->has & TL_TABLE_HAS_before) != 0 && between(0, 1) == 0; // the motor instead
        *(before ? &table->before.slope_q20[i] : &table->joints.slope[i]) = between(-100000, 100000);
    }
    add_pressed(table);
    table->adapt = (tl_table_adapt_t){.offset = 100000, .width_least_q15 = 8192, .width_most_q15 = 65536};
}

// Of what moves the tables while they are in use.
static void move_tables(void) {
    tl_compensator_t *k = &axis.tip.compensator;
    const uint32_t ticks = (uint32_t)between(1, 500);
    if (between(0, 1) == 0) {
        tl_compensator_load(k, between(-25600, 25600), ticks);
    } else {
        tl_compensator_adapt(k, between(-100000, 100000), between(8192, 65536), ticks);
    }
    for (uint32_t i = 0; i < TL_TABLE_JOINTS; i++) {
        k->undo.moved.joint[i] = between(-1000000, 1000000);
    }
    tl_undo_join(&k->undo, k->lookup);
}

// -- a motor that follows well enough, and sometimes does not
// -----------------------------------------------------------------

static int64_t plant_q16;
static int32_t quickness; // counts a tick at full drive, Q3

static void turn_motor(void) {
    if (between(0, 2000) == 0) {
        plant_q16 += (int64_t)between(-2500, 2500) * 65536; // a glitch of the encoder
    }
    plant_q16 += (int64_t)driven * quickness / 4;
    plant_q16 += between(-30000, 30000);
    encoder_count = (int32_t)(plant_q16 >> 16);
    current = between(0, 600);
}

static uint8_t follow(bool tip, uint8_t compensation, uint32_t silence_us, tl_us_t now_us) {
    const tl_wire_follow_t request = {.target = tip, .compensation = compensation, .silence_us = silence_us};
    return tl_axis_follow(&axis, &request, now_us);
}

static void set_point(int32_t value, tl_us_t at_us, tl_us_t now_us, bool *late) {
    const tl_wire_set_point_t request = {.value = value, .at_us = at_us};
    tl_axis_set_point(&axis, &request, now_us, late);
}

static void move(tl_count_q8_t q, int32_t speed_q8_s) {
    const tl_wire_move_t request = {.q_q8 = q, .speed_q8_s = speed_q8_s, .silence_us = 50000000U};
    tl_axis_move(&axis, &request);
}

static void __no_inline_not_in_flash_func(step)(uint32_t kind, tl_us_t now_us) {
    turn_motor();
    BEGIN(kind);
    tl_axis_step(&axis);
    END();
    if (axis.slot == 0) {
        BEGIN(axis.tip.lookup.table.has != 0 ? WATCH_UNDOES : (axis.tip.lookup.plays > 0 ? WATCH_PLAYS : WATCH));
        tl_axis_watch(&axis, now_us);
        END();
    } else if (axis.slot == 2) {
        BEGIN(GUARD);
        tl_axis_guard(&axis, now_us);
        END();
    }
    if (axis.telemetry.head - axis.telemetry.tail > (uint32_t)between(0, 31)) {
        axis.telemetry.tail = axis.telemetry.head;
    }
}

static void start_axis(bool plays, bool sections) {
    tl_axis_init(&axis, &port, 0);
    tl_wire_settings_t settings = axis.settings; // the widest
    settings.speed_q8_s = TL_REFERENCE_SPEED_MAX;
    settings.acceleration_q8_s2 = TL_REFERENCE_ACCELERATION_MAX;
    settings.following_error_q8 = TL_AXIS_RANGE_MAX;
    settings.current_ma = 0;
    settings.stall_ms = (uint16_t)between(20, 5000);
    settings.commissioned = 1U;
    tl_axis_use_settings(&axis, &settings);
    axis.telemetry.divider = (uint8_t)between(0, 3);
    quickness = between(0, 2) == 0 ? 1 << between(3, 9) : 32;
    (plays ? make_plays : make_table)(&axis.tip.lookup.table);
    if (sections && axis.tip.lookup.table.nodes > 0) {
        add_sections(&axis.tip.lookup.table);
    }
    if (tl_lookup_derive(&axis.tip.lookup, &axis.tip.lookup.table, 0) != TL_TABLE_OK) {
        panic("a table that was checked is refused");
    }
    const tl_table_t *table = &axis.tip.lookup.table;
    const tl_count_q8_t begins[] = {table->q_min, table->q_max, between(table->q_min, table->q_max),
                                    between(table->q_min, table->q_max), table->q_min - between(0, 100000)};
    tl_axis_set_position(&axis, begins[between(0, 4)]);
    tl_axis_use_table(&axis, true);
    const tl_servo_gains_t *before = &axis.motor.servo.gains;
    tl_wire_servo_t gains = {.proportional = before->proportional,
                             .integral = before->integral,
                             .derivative = before->derivative,
                             .feed_forward = before->feed_forward,
                             .inertia = before->inertia,
                             .friction_q15 = before->friction};
    if (between(0, 2) == 0) {
        gains = (tl_wire_servo_t){.proportional = between(0, TL_WIRE_GAIN_MAX),
                                  .integral = between(0, TL_WIRE_GAIN_MAX),
                                  .derivative = between(0, TL_WIRE_GAIN_MAX),
                                  .feed_forward = between(0, TL_WIRE_GAIN_MAX),
                                  .inertia = between(0, TL_WIRE_GAIN_MAX),
                                  .friction_q15 = between(0, TL_WIRE_GAIN_MAX)};
    }
    if (tl_axis_set_servo(&axis, &gains) != 0) {
        panic("gains within their range are refused");
    }
    tl_wire_limits_t limits = axis.limits;
    limits.following_error_q8 = between(0, 4) == 0 ? between(256, 20000) : 1000 * 256;
    limits.current_ma = between(0, 9) == 0 ? 200 : 1000;
    limits.duty_q15 = between(0, 3) == 0 ? between(0, 32768) : 32768;
    limits.speed_q8_s = between(1000, 30000) * 256;
    limits.acceleration_q8_s2 = between(50000, 2000000) * 256;
    tl_axis_set_limits(&axis, &limits);
    axis.history = between(0, 1) == 0 ? &history : NULL;
    tl_history_init(&history);
}

static tl_deg_q16_t any_angle(void) {
    const tl_lookup_t *lookup = &axis.tip.lookup;
    const int32_t span = lookup->c_high / 2 - lookup->c_low / 2;
    return tl_add_sat(lookup->c_low / 2 + lookup->c_high / 2,
                      between(-span, span) + between(-span / 4 - 1, span / 4 + 1));
}

// Motor on, at rest, no fault: from there every mode begins.
static void hold(tl_us_t *now_us) {
    axis.fault = 0;
    axis.checked = axis.referenced = true;
    tl_axis_enable(&axis);
    tl_axis_stop(&axis, false);
    for (int i = 0; i < 5 * TICKS && axis.mode != TL_WIRE_MODE_HOLD; i++) {
        *now_us += 1000000 / RATE_HZ;
        step(STEP_OTHER, *now_us);
        axis.fault = 0;
        tl_axis_enable(&axis);
    }
}

static void follow_tip(tl_us_t *now_us) {
    hold(now_us);
    const uint32_t silence_us = between(0, 5) == 0 ? (uint32_t)between(5000, 60000) : 50000000U;
    if (follow(true, (uint8_t)between(0, 5) % 3u, silence_us, *now_us) != 0) {
        return;
    }
    const int32_t often = between(5, 60); // a set-point in so many ticks
    const int32_t jitter = between(0, 2) * between(1, 30000);
    bool late;
    for (int i = 0; i < TICKS; i++) {
        *now_us += 1000000 / RATE_HZ;
        if (between(0, often) == 0) {
            const tl_us_t at = between(0, 1) == 0 ? 0 : *now_us + (tl_us_t)between(1000, 60000);
            set_point(any_angle(), at, *now_us, &late);
        } else if (between(0, 5) == 0) {
            set_point(axis.plan.c_next + between(-jitter, jitter), 0, *now_us, &late);
        }
        if (between(0, 40) == 0) {
            tl_axis_set_strength(&axis, between(0, 32768));
        }
        if (axis.tip.lookup.table.has != 0 && between(0, 200) == 0) {
            move_tables();
        }
        const bool undoes = axis.tip.lookup.table.has != 0;
        const uint32_t kind = undoes ? STEP_UNDOES : (axis.tip.lookup.plays > 0 ? STEP_PLAYS : STEP_TIP);
        step(axis.mode == TL_WIRE_MODE_FOLLOW_TIP ? kind : STEP_OTHER, *now_us);
    }
}

// Moves that arrive, and set-points beyond the ends of the range, without a table: far ways.
static void move_far(tl_us_t *now_us) {
    tl_axis_fail(&axis, TL_WIRE_FAULT_STOPPED, 0, *now_us);
    axis.fault = 0;
    tl_axis_use_table(&axis, false);
    tl_wire_limits_t limits = axis.limits;
    limits.q_low_q8 = -TL_AXIS_RANGE_MAX;
    limits.q_high_q8 = TL_AXIS_RANGE_MAX;
    limits.following_error_q8 = TL_AXIS_RANGE_MAX;
    limits.acceleration_q8_s2 = between(0, 1) == 0 ? TL_REFERENCE_ACCELERATION_MIN : 1 << between(18, 30);
    limits.speed_q8_s = 1 << (between(0, 1) == 0 ? 22 : between(12, 22));
    tl_axis_set_limits(&axis, &limits);
    const int32_t from_end = 1 << (between(0, 1) == 0 ? between(23, 24) : between(4, 27));
    tl_axis_set_position(&axis, between(0, 1) == 0 ? axis.plan.low + from_end : axis.plan.high - from_end);
    hold(now_us);
    bool late;
    for (int i = 0; i < 12; i++) {
        const tl_count_q8_t target = tl_clamp(
            axis.q + between(-1, 1) * (1 << (between(0, 1) == 0 ? 12 : between(0, 28))), axis.plan.low, axis.plan.high);
        const bool follows = between(0, 1) == 0 && follow(false, 0, 50000000, *now_us) == 0;
        if (!follows) {
            move(target, between(0, 1) * (1 << between(8, 22)));
        }
        for (int32_t left = between(50, 600); left > 0; left--) {
            *now_us += 1000000 / RATE_HZ;
            if (follows && left % 40 == 0) {
                set_point(axis.plan.target + between(-1, 1) * (1 << between(0, 24)), *now_us + 8000, *now_us, &late);
            }
            step(STEP_OTHER, *now_us);
        }
    }
}

static void calibrate(tl_us_t *now_us) {
    hold(now_us);
    const int32_t stroke = between(20, 800) * 256;
    const int32_t q = tl_reference_q(&axis.plan.reference);
    tl_motion_config_t config = {.low = q - between(-stroke, 3 * stroke),
                                 .speed_count = (uint8_t)between(1, TL_MOTION_SPEEDS),
                                 .cycles = (uint8_t)between(1, 4),
                                 .transit = between(2000, 16000) * 256,
                                 .acceleration = between(100000, 4000000) * 256,
                                 .approach = between(256, stroke / 2),
                                 .stroke_max = stroke,
                                 .host_timeout_us = between(0, 2) == 0 ? (uint32_t)between(5000, 60000) : 0U,
                                 .rate_hz = TL_AXIS_PLAN_HZ};
    config.high = config.low + 2 * stroke + between(1, 4000) * 256;
    for (uint8_t i = 0; i < TL_MOTION_SPEEDS; i++) {
        config.speed[i] = between(0, 1) == 0 ? config.transit : between(64, config.transit);
    }
    if (tl_motion_start(&motion, &config, q) != TL_MOTION_OK) {
        return;
    }
    tl_axis_calibrate(&axis, &motion, &history);
    for (int i = 0; i < 5 * TICKS; i++) {
        *now_us += 1000000 / RATE_HZ;
        if (between(0, 30) == 0) {
            tl_motion_onset(&motion, (int8_t)(2 * between(0, 1) - 1));
        }
        if (between(0, 150) == 0) {
            tl_motion_frame(&motion);
        }
        if (between(0, 4000) == 0) {
            tl_motion_stop(&motion);
        }
        step(STEP_OTHER, *now_us);
    }
    axis.plan.motion = NULL;
    tl_axis_stop(&axis, false);
}

static void other_modes(tl_us_t *now_us) {
    hold(now_us);
    bool late;
    for (int i = 0; i < TICKS; i++) {
        *now_us += 1000000 / RATE_HZ;
        switch (between(0, 60)) {
        case 0:
            axis.fault = 0;
            tl_axis_enable(&axis);
            move(between(axis.plan.low, axis.plan.high), between(0, 1) * between(1, 5000 * 256));
            break;
        case 1:
            tl_axis_stop(&axis, between(0, 1) == 0);
            break;
        case 2:
            axis.fault = 0;
            tl_axis_enable(&axis);
            if (follow(false, 0, (uint32_t)between(1000, 50000), *now_us) == 0) {
                set_point(axis.q + between(-30000, 30000), *now_us + 20000, *now_us, &late);
            }
            break;
        case 3:
            axis.fault = 0;
            axis.referenced = true;
            tl_axis_enable(&axis);
            tl_axis_home(&axis, &(tl_wire_home_t){.direction = 1, .reach_q8 = 1 << 20});
            break;
        case 4:
            axis.fault = 0;
            tl_axis_stop(&axis, true);
            tl_axis_check(&axis);
            break;
        default:
            break;
        }
        step(STEP_OTHER, *now_us);
    }
    axis.referenced = true;
    tl_axis_admit(&axis);
}

// -- whole calibration motions of short strokes, each tick of the plan
// ---------------------------------------------------------------------------------

static void __no_inline_not_in_flash_func(move_on)(void) {
    BEGIN(MOTION);
    tl_motion_tick(&motion);
    END();
}

static void motions(void) {
    for (int i = 0; i < MOTIONS; i++) {
        const int32_t stroke = between(2 * 256, 60 * 256);
        const int32_t transit = between(1000, 16000) * 256;
        tl_motion_config_t config = {.low = between(-50000, 50000),
                                     .speed_count = (uint8_t)between(1, TL_MOTION_SPEEDS),
                                     .cycles = (uint8_t)between(1, 3),
                                     .transit = transit,
                                     .acceleration = between(20000, 40000000) * 16,
                                     .approach = between(256, stroke / 2),
                                     .stroke_max = stroke,
                                     .host_timeout_us = between(0, 3) == 0 ? (uint32_t)between(5000, 600000) : 0U,
                                     .rate_hz = between(0, 1) == 0 ? TL_AXIS_PLAN_HZ : RATE_HZ};
        config.high = config.low + 2 * stroke + between(1, 1 << between(1, 13));
        for (uint8_t j = 0; j < TL_MOTION_SPEEDS; j++) {
            config.speed[j] = between(0, 1) == 0 ? transit : between(64 * 256, transit);
        }
        const int32_t begin = between(config.low - 5000, config.high + 5000);
        if (tl_motion_start(&motion, &config, between(0, 3) == 0 ? config.low : begin) != TL_MOTION_OK) {
            continue;
        }
        const int32_t seldom = 1 << between(2, 9); // onsets
        for (int tick = 0; tick < 3000 && (tl_motion_state(&motion) == TL_MOTION_RUNNING ||
                                           tl_motion_state(&motion) == TL_MOTION_STOPPING);
             tick++) {
            if (between(0, seldom) == 0) {
                tl_motion_onset(&motion, between(0, 9) == 0 ? (int8_t)-motion.direction : motion.direction);
            }
            if (between(0, 50) == 0) {
                tl_motion_frame(&motion);
            }
            if (between(0, 3000) == 0) {
                tl_motion_stop(&motion);
            }
            move_on();
        }
    }
}

// -- frames of a tip with play: steady strokes, dithering, pauses, lost and late frames, wrong settings
// ---------------------------------------------------------------------------------

static tl_onset_config_t any_onset_config(bool wild) {
    tl_onset_config_t config = tl_onset_defaults();
    if (between(0, 2) > 0) {
        config.delay_us = (uint32_t)between(0, 400) * 1000U;
        config.guard_us = (uint32_t)between(0, 40) * 1000U;
        config.lost_us = (uint32_t)between(50, 2000) * 1000U;
        config.timeout_us = (uint32_t)between(1, 30) * 1000000U;
        config.turn = between(1, 64) * 256;
        config.sigma_wanted = between(1, 2000);
        config.sigma_usable = config.sigma_wanted * between(1, 30);
        config.noise_px = 1 << between(0, wild ? 15 : 11);
        config.curvature = (uint32_t)between(0, wild ? 1 << between(0, 19) : 4000);
        config.threshold = (uint16_t)(between(4, 60) * 16);
        config.frames_min = (uint8_t)between(3, 8);
        config.frames_max = (uint8_t)between(config.frames_min, TL_ONSET_WINDOW - 2);
    }
    return config;
}

static void __no_inline_not_in_flash_func(sample)(const tl_marker_t *marker) {
    tl_onset_t onset;
    BEGIN(ONSET);
    tl_onset_sample(&detector, &history, marker, &onset);
    END();
}

static void onsets(void) {
    tl_us_t now_us = 0;
    int32_t q = 0, tip = 0, way = 1;
    bool wild = false; // far beyond what a camera and a motor do
    for (int32_t i = 0; i < REVERSALS; i++) {
        if (i % 6 == 0) {
            wild = between(0, 2) == 0;
            const tl_onset_config_t config = any_onset_config(wild);
            // The board has just begun, or the high word of its time will change on the way.
            now_us = between(0, 7) == 0 ? 1000 : (1ULL << 32) - (tl_us_t)between(0, 8000000);
            q = wild && between(0, 1) == 0 ? 2 * between(-1000000000, 1000000000) : 0;
            tip = q;
            tl_history_init(&history);
            if (!tl_onset_init(&detector, &config)) {
                const tl_onset_config_t defaults = tl_onset_defaults();
                tl_onset_init(&detector, &defaults);
            }
        }
        const int32_t width = between(0, 1500) * 256;
        const bool still = i % 25 == 7; // for long
        const int32_t frames = still ? 200 : (between(0, 5) == 0 ? between(0, 5) : between(3, 110));
        const int32_t speed = between(0, 9) == 0 ? 0 : between(1, wild ? 1 << between(1, 13) : 2000); // Q8 counts/ms
        const int32_t dither = between(0, 5) == 0 ? between(1, 40) * 256 : 0;
        const int32_t noise = between(0, 3) == 0 ? between(0, 100000) : between(0, 1) * 400;
        const int32_t gain = still || between(1, 5) == 1 ? 0 : between(-6, 6); // of the image, 1/16 of q
        const int32_t offset = wild && between(0, 3) == 0 ? 2 * between(-(1 << 28), 1 << 28) : 0;
        way = -way;
        for (int32_t frame = 0; frame < frames; frame++) {
            const int32_t late = between(0, 40) == 0 || (frame == 0 && i % 6 == 0) ? between(-200, 700) : 40; // ms
            for (int32_t ms = 0; ms < late; ms++) {
                now_us += 1000;
                q = tl_add_sat(q, way * speed + (dither > 0 ? between(-dither, dither) : 0));
                tl_history_push(&history, now_us, q);
            }
            tip = tl_clamp(tip, tl_sub_sat(q, width / 2), tl_add_sat(q, width / 2));
            const tl_us_t ago_us = between(0, 9) > 0 ? (tl_us_t)between(0, 20) * 500U : 0U - (tl_us_t)between(0, 5000);
            const tl_marker_t marker = {.arrival_us = (int64_t)(now_us - ago_us) > 0 ? now_us - ago_us : 0,
                                        .u = tl_add_sat(offset, tip / 16 * gain + between(-noise, noise)),
                                        .v = tl_add_sat(offset, tip / 64 * gain + between(-noise, noise)),
                                        .sigma = between(0, 1) * (wild ? 1 << between(0, 20) : between(1, 4000)),
                                        .valid = between(0, 30) != 0,
                                        .other_motion = between(0, 300) == 0};
            sample(&marker);
            if (between(0, 60) == 0) {
                sample(&marker); // the same again
            }
        }
    }
}

#ifdef TAUTLINE_CMSIS_DSP
#include "dsp/interpolation_functions.h"
#else
// The plainest way of one look-up: linear interpolation between y[index] and the next, x is Q12.20.
static int32_t __not_in_flash_func(arm_linear_interp_q31)(const int32_t *y, int32_t x, uint32_t nodes) {
    const int32_t index = x >> 20;
    if (index >= (int32_t)nodes - 1) {
        return y[nodes - 1];
    }
    if (index < 0) {
        return y[0];
    }
    const int32_t fraction = (x & 0xfffff) << 11;
    return (int32_t)(((int64_t)y[index] * (0x7fffffff - fraction) + (int64_t)y[index + 1] * fraction) >> 31);
}
#endif

static void lookups(void) {
    volatile int32_t sink;
    uint32_t flags = 0;
    for (int i = 0; i < TICKS; i++) {
        const tl_table_t *table = &axis.tip.lookup.table;
        const tl_count_q8_t p = between(table->q_min, table->q_max);
        BEGIN(LOOKUP);
        sink = tl_lookup_width(&axis.tip.lookup, p, &flags);
        END();
        const int32_t x = between(0, (table->nodes << 20) - 1);
        BEGIN(LOOKUP_YARDSTICK);
        sink = arm_linear_interp_q31(table->width, x, table->nodes);
        END();
        BEGIN(EMPTY);
        END();
    }
    (void)sink;
}

int main(void) {
    for (uint32_t table = 1; table <= TABLES; table++) {
        seed = table * 2654435761u;
        tl_us_t now_us = (1ULL << 32) - 1000000U; // the high word of the time changes on the way
        start_axis(false, false);
        follow_tip(&now_us);
        other_modes(&now_us);
        calibrate(&now_us);
        follow_tip(&now_us);
        if (axis.tip.lookup.table.nodes > 1) {
            lookups();
        }
        move_far(&now_us);
    }
    motions();
    onsets();
    for (uint32_t table = 1; table <= PLAY_TABLES; table++) {
        seed = table * 2246822519u;
        tl_us_t now_us = 1000000U;
        start_axis(true, false);
        follow_tip(&now_us);
        start_axis(between(0, 2) != 0, true);
        follow_tip(&now_us);
    }
    __asm__ volatile("bkpt 0xd2");
    for (;;) {
    }
}
