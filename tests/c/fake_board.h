// A board for tests: motors that obey at once or are blocked, flash that counts and can lose power, time by hand.
#ifndef FAKE_BOARD_H
#define FAKE_BOARD_H

#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "tautline/tl_app.h"
#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"

#define FAKE_HZ    5000U
#define FAKE_SPEED 20000.0 // counts/s at full duty
#define FAKE_LAG   0.02    // s
#define FAKE_FLASH (TL_PORT_FLASH_REGION + TL_PORT_FLASH_LOG)
#define FAKE_CHOP  1200 // mA

typedef struct {
    tl_us_t t_us;
    double position[TL_WIRE_AXES_MAX]; // counts
    double speed[TL_WIRE_AXES_MAX];
    tl_duty_q15_t duty[TL_WIRE_AXES_MAX];
    int32_t current_ma;
    bool slipped[TL_WIRE_AXES_MAX]; // until the app has asked
    bool blocked;
    bool stuck;                     // the encoders,
    int32_t shown;                  // at this
    bool dropped[TL_WIRE_AXES_MAX]; // an encoder, which shows `held` meanwhile and has `missed` afterwards
    int32_t held[TL_WIRE_AXES_MAX], missed[TL_WIRE_AXES_MAX];
    bool driver_fault[TL_WIRE_AXES_MAX];
    bool estop_closed;
    uint16_t supply_mv;
    double lag_s;                     // of a motor's speed, by its inertia
    double winding_s;                 // of its current; 0: at once
    double load, friction;            // of full drive: what pulls at the motors, and what rubs
    double current[TL_WIRE_AXES_MAX]; // that speeds a motor up, of what full duty brings
    double wiring[TL_WIRE_AXES_MAX]; // counts that the encoder shows for one of the motor's: -1 where wires are swapped
    uint8_t flash[FAKE_FLASH];
    uint32_t operations;
    uint32_t cut_at;      // the operation in which the power goes; 0 never
    unsigned cut_pattern; // which part of it is done
    bool dead;
    bool keeps, sticks; // flash that says it was erased, and was not; of which a byte of each page cannot be programmed
    uint32_t fed;
    uint32_t kept_out; // the control step: by a lock that is not yet undone
    int rebooted;      // 1 restart, 2 boot loader
} fake_t;

static fake_t fake;
static tl_port_t fake_port;
static tl_app_t app;
static bool fake_keeps_log;                 // of the next start
static const tl_port_update_t *fake_update; // of the next start; NULL: the board takes no firmware

static tl_us_t fake_time(void *context) {
    return ((fake_t *)context)->t_us;
}
static int32_t fake_encoder(void *context, uint8_t axis) {
    const fake_t *f = context;
    const double position = f->position[axis] * f->wiring[axis];
    if (f->stuck) {
        return f->shown;
    }
    return f->dropped[axis] ? f->held[axis] : (int32_t)(position < 0.0 ? position - 1.0 : position) - f->missed[axis];
}
static inline void fake_drop(uint8_t axis, bool drops) {
    const int32_t held = fake_encoder(&fake, axis);
    fake.held[axis] = held;
    fake.dropped[axis] = false;
    fake.missed[axis] += fake_encoder(&fake, axis) - held;
    fake.dropped[axis] = drops;
}
static void fake_drive(void *context, uint8_t axis, tl_duty_q15_t duty) {
    ((fake_t *)context)->duty[axis] = duty;
}
static bool fake_edges_lost(void *context, uint8_t axis) {
    bool *slipped = &((fake_t *)context)->slipped[axis];
    const bool lost = *slipped;
    *slipped = false;
    return lost;
}
static int32_t fake_current(void *context, uint8_t axis) {
    (void)axis;
    return ((fake_t *)context)->current_ma;
}

static uint16_t fake_supply(void *context) {
    return ((fake_t *)context)->supply_mv;
}
static bool fake_driver_fault(void *context, uint8_t axis) {
    return ((fake_t *)context)->driver_fault[axis];
}

static bool fake_estop_closed(void *context) {
    return ((fake_t *)context)->estop_closed;
}

static bool fake_operate(fake_t *f) {
    TEST_ASSERT_EQUAL_MESSAGE(0, f->kept_out, "flash takes longer than a control step may be kept out");
    f->operations++;
    f->dead = f->dead || f->operations == f->cut_at;
    return !f->dead;
}

// Whether byte i of an operation of this size was done when the power went.
static bool fake_reached(const fake_t *f, uint32_t i, uint32_t size) {
    switch (f->cut_pattern) {
    case 0:
        return i < size / 2U;
    case 1:
        return i >= size / 2U;
    case 2:
        return false;
    default:
        return (i * 2654435761U >> 16 & 1U) != 0U;
    }
}

static void fake_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    TEST_ASSERT_TRUE(offset <= FAKE_FLASH && size <= FAKE_FLASH - offset);
    memcpy(out, ((fake_t *)context)->flash + offset, size);
}

static bool fake_erase(void *context, uint32_t offset) {
    fake_t *f = context;
    TEST_ASSERT_EQUAL(0, offset % TL_PORT_FLASH_SECTOR);
    TEST_ASSERT_TRUE(offset < FAKE_FLASH);
    const bool before = f->dead;
    const bool whole = fake_operate(f);
    for (uint32_t i = 0; i < TL_PORT_FLASH_SECTOR && !before && !f->keeps; i++) {
        if (whole || fake_reached(f, i, TL_PORT_FLASH_SECTOR)) {
            f->flash[offset + i] = 0xFF;
        }
    }
    return whole;
}

static bool fake_program(void *context, uint32_t offset, const uint8_t *page) {
    fake_t *f = context;
    TEST_ASSERT_EQUAL(0, offset % TL_PORT_FLASH_PAGE);
    TEST_ASSERT_TRUE(offset < FAKE_FLASH);
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        TEST_ASSERT_EQUAL_MESSAGE(0, f->duty[i], "flash is written with every motor off");
    }
    const bool before = f->dead;
    const bool whole = fake_operate(f);
    for (uint32_t i = 0; i < TL_PORT_FLASH_PAGE && !before; i++) {
        if (whole || fake_reached(f, i, TL_PORT_FLASH_PAGE)) {
            f->flash[offset + i] &= f->sticks && i == 100U ? 0xFFU : page[i];
        }
    }
    return whole;
}

static void fake_feed(void *context) {
    ((fake_t *)context)->fed++;
}
// Locks never nest, and each is undone with the state that it gave.
#define FAKE_LOCKED 0x10C8EDU
static uint32_t fake_lock(void *context) {
    TEST_ASSERT_EQUAL_MESSAGE(0, ((fake_t *)context)->kept_out, "a lock within a lock");
    ((fake_t *)context)->kept_out = 1U;
    return FAKE_LOCKED;
}
static void fake_unlock(void *context, uint32_t state) {
    TEST_ASSERT_EQUAL_MESSAGE(1, ((fake_t *)context)->kept_out, "an unlock without a lock");
    TEST_ASSERT_EQUAL_HEX32(FAKE_LOCKED, state);
    ((fake_t *)context)->kept_out = 0U;
}
static inline void fake_let_in(void) { // whoever may be interrupted is
    TEST_ASSERT_EQUAL_MESSAGE(0, fake.kept_out, "the control step is kept out for good");
}
static void fake_reboot(void *context, bool bootloader) {
    ((fake_t *)context)->rebooted = bootloader ? 2 : 1;
}

// Powers the board up over whatever its flash holds.
static inline void fake_start(uint8_t axes, tl_wire_boot_t boot) {
    fake.dead = false;
    fake.cut_at = 0;
    fake.operations = 0;
    fake.rebooted = 0;
    fake_port = (tl_port_t){.context = &fake,
                            .name = "fake",
                            .serial = "TEST",
                            .axes = axes,
                            .boot = (uint8_t)boot,
                            .control_hz = FAKE_HZ,
                            .driver_ma = FAKE_CHOP,
                            .supply_low_mv = 4000,
                            .time_us = fake_time,
                            .encoder = fake_encoder,
                            .edges_lost = fake_edges_lost,
                            .drive = fake_drive,
                            .current_ma = fake_current,
                            .supply_mv = fake_supply,
                            .driver_fault = fake_driver_fault,
                            .estop_closed = fake_estop_closed,
                            .flash_read = fake_read,
                            .flash_erase = fake_erase,
                            .flash_program = fake_program,
                            .watchdog_feed = fake_feed,
                            .lock = fake_lock,
                            .unlock = fake_unlock,
                            .reboot = fake_reboot,
                            .update = fake_update,
                            .keeps_log = fake_keeps_log};
    tl_app_init(&app, &fake_port);
    tl_app_bus(&app, true);
    fake_let_in();
}

// Every axis as 'taut commission' leaves it, but for flash, which holds nothing yet.
static inline void fake_commission(void) {
    for (uint8_t i = 0; i < fake_port.axes; i++) {
        tl_wire_settings_t own = app.axes[i].settings;
        own.commissioned = 1U;
        tl_axis_use_settings(&app.axes[i], &own);
    }
}

static inline void fake_new(uint8_t axes) {
    memset(&fake, 0, sizeof(fake));
    memset(fake.flash, 0xFF, sizeof(fake.flash));
    fake.supply_mv = 6000;
    fake.lag_s = FAKE_LAG;
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        fake.wiring[i] = 1.0;
    }
    fake_start(axes, TL_WIRE_BOOT_POWER);
    fake_commission();
}

// Every axis as it is after its check and its homing, at its present position.
static inline void fake_ready(void) {
    for (uint8_t i = 0; i < fake_port.axes; i++) {
        app.axes[i].checked = app.axes[i].referenced = true;
        tl_axis_admit(&app.axes[i]);
    }
}

static inline void fake_turn(uint8_t i, double dt) {
    const double drive = fake.duty[i] / 32768.0 - fake.speed[i] / FAKE_SPEED;
    fake.current[i] = fake.winding_s > 0.0 ? fake.current[i] + (drive - fake.current[i]) * dt / fake.winding_s : drive;
    const double pull = fake.current[i] - fake.load, way = fake.speed[i] != 0.0 ? fake.speed[i] : pull;
    const bool sticks = fake.speed[i] == 0.0 && pull <= fake.friction && pull >= -fake.friction;
    const double rubs = sticks ? pull : way < 0.0 ? -fake.friction : fake.friction;
    const double speed = fake.speed[i] + (pull - rubs) * FAKE_SPEED * dt / fake.lag_s;
    fake.speed[i] = fake.blocked || (fake.friction > 0.0 && speed * way < 0.0) ? 0.0 : speed; // it stops, never turns
    fake.position[i] += fake.speed[i] * dt;
}

static inline void fake_step(void) {
    const double dt = 1.0 / FAKE_HZ;
    fake.t_us += 1000000U / FAKE_HZ;
    for (uint8_t i = 0; i < fake_port.axes; i++) {
        const unsigned parts = fake.winding_s > 0.0 ? 20U : 1U;
        for (unsigned part = 0; part < parts; part++) {
            fake_turn(i, dt / parts);
        }
    }
    fake_let_in();
    tl_app_control(&app);
    tl_app_task(&app);
    fake_let_in();
}

static inline void fake_run_ms(uint32_t ms) {
    for (uint32_t i = 0; i < ms * FAKE_HZ / 1000U; i++) {
        fake_step();
    }
}

// What the board sent: the last message of each type, and how many of it.
static tl_wire_message_t heard[256];
static uint32_t heard_count[256];
static uint16_t heard_sequence[256];

static inline void fake_listen(void) {
    static tl_wire_parser_t parser;
    uint8_t bytes[100];
    size_t size;
    while ((size = tl_app_transmit(&app, bytes, sizeof(bytes))) > 0) {
        const uint8_t *data = bytes;
        tl_wire_frame_t frame;
        while (tl_wire_parse(&parser, &data, &size, &frame)) {
            TEST_ASSERT_TRUE(tl_wire_decode(frame.type, frame.payload, frame.size, &heard[frame.type]));
            TEST_ASSERT_EQUAL(tl_wire_size(frame.type), frame.size);
            heard_count[frame.type]++;
            heard_sequence[frame.type] = frame.sequence;
        }
    }
}

// Sends a request; returns 0 when it was done, the reason when refused, -1 without an answer.
static inline int fake_ask(uint8_t type, const void *message) {
    static uint16_t sequence;
    uint8_t frame[TL_WIRE_FRAME_MAX];
    fake_listen();
    memset(heard_count, 0, sizeof(heard_count));
    tl_app_receive(&app, frame, tl_wire_frame(frame, type, ++sequence, message));
    fake_let_in();
    fake_listen();
    if (heard_count[TL_WIRE_ERROR] > 0) {
        TEST_ASSERT_EQUAL(type, heard[TL_WIRE_ERROR].error.request);
        TEST_ASSERT_EQUAL(sequence, heard_sequence[TL_WIRE_ERROR]);
        return heard[TL_WIRE_ERROR].error.reason;
    }
    if (heard_count[TL_WIRE_ACK] > 0) {
        TEST_ASSERT_EQUAL(type, heard[TL_WIRE_ACK].ack.request);
        TEST_ASSERT_EQUAL(sequence, heard_sequence[TL_WIRE_ACK]);
        return 0;
    }
    return -1;
}

static inline tl_wire_status_t fake_status(uint8_t axis) {
    const tl_wire_get_status_t request = {.axis = axis};
    fake_ask(TL_WIRE_GET_STATUS, &request);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_STATUS]);
    return heard[TL_WIRE_STATUS].status;
}

static inline int fake_enable(uint8_t axis, uint8_t on) {
    const tl_wire_enable_t request = {.axis = axis, .on = on};
    return fake_ask(TL_WIRE_ENABLE, &request);
}

// A valid table for an axis over +-5000 counts with a bump of backlash; `variant` makes it another one.
static inline uint16_t fake_table(uint8_t *blob, uint8_t axis, uint32_t variant) {
    static tl_table_t table;
    memset(&table, 0, sizeof(table));
    table.axis = axis;
    table.step_log2 = 14;
    table.nodes = 161;
    table.strength_q15 = 32768;
    table.nano_units_per_count = 1000000;
    table.q0 = -80 * 16384;
    table.q_min = -5000 * TL_COUNT_ONE;
    table.q_max = 5000 * TL_COUNT_ONE;
    table.coarse_c_min = -60 * TL_DEG_ONE;
    table.coarse_c_max = 60 * TL_DEG_ONE;
    table.speed_max_q8 = 10000 * TL_COUNT_ONE;
    table.takeup_speed_q8 = 5000 * TL_COUNT_ONE;
    table.takeup_accel = 100000;
    table.band = 2 * TL_COUNT_ONE;
    table.flat_speed_q8 = 5000 * TL_COUNT_ONE;
    table.created_s = variant;
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = (int32_t)(300U + variant % 100U + (i < 80U ? i : 160U - i)) * TL_COUNT_ONE;
        table.angle[i] = ((int32_t)i - 80) * (TL_DEG_ONE * 3 / 4);
    }
    return (uint16_t)tl_table_encode(&table, blob, TL_TABLE_SIZE_MAX);
}

// A calibration of three cycles over two thousand counts to either side.
static inline tl_wire_motion_start_t fake_calibration(void) {
    return (tl_wire_motion_start_t){.axis = 0,
                                    .cycles = 3,
                                    .low_q8 = -2000 * TL_COUNT_ONE,
                                    .high_q8 = 2000 * TL_COUNT_ONE,
                                    .speed_q8_s = {700 * TL_COUNT_ONE},
                                    .transit_q8_s = 2000 * TL_COUNT_ONE,
                                    .acceleration_q8_s2 = 20000 * TL_COUNT_ONE,
                                    .approach_q8 = 100 * TL_COUNT_ONE,
                                    .stroke_max_q8 = 800 * TL_COUNT_ONE,
                                    .host_timeout_us = 200000,
                                    .delay_us = 80000};
}

static inline tl_upload_t fake_upload(uint8_t axis, const uint8_t *blob, uint32_t size) {
    for (uint32_t at = 0; at < size; at += 256U) {
        const uint32_t left = size - at;
        const tl_upload_t result = tl_app_table_data(&app, axis, at, blob + at, left < 256U ? left : 256U);
        if (result != TL_UPLOAD_OK) {
            return result;
        }
    }
    const tl_upload_t result = tl_app_table_end(&app, axis);
    fake_let_in();
    return result;
}

#endif
