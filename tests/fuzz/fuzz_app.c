// The whole app on a fake clock: any messages in any order, any table, cut power, motors and encoders that fail. After
// each control step every axis keeps its word, and at the end the board answers and lets itself be stopped.
#include "requests.h"

#include "../c/fake_board.h"

#define AXES  2U
#define STEPS 240 // control steps of an input, at most

// What was seen of an axis a step ago, and for how long.
typedef struct {
    uint8_t mode;
    bool closed;
    tl_count_q8_t path_q, began_q;
    int32_t ill, stopped;
} seen_t;

static seen_t seen[AXES];
static uint32_t hz;
static int steps;
static uint8_t blob[TL_TABLE_SIZE_MAX];

static int32_t ms(int32_t control_steps) {
    return control_steps * 1000 / (int32_t)hz;
}

// docs/safety.md, its last row but two, and the times of driver, supply and stop input.
static void check(uint8_t i) {
    const tl_axis_t *axis = &app.axes[i];
    const tl_wire_settings_t *own = &axis->settings;
    const tl_duty_q15_t duty = fake.duty[i];
    const bool off = axis->mode == TL_WIRE_MODE_OFF;
    seen_t *s = &seen[i];
    PROMISE(abs(duty) <= own->duty_q15 && abs(duty) <= axis->limits.duty_q15);
    const bool weak = axis->mode == TL_WIRE_MODE_CHECK || axis->mode == TL_WIRE_MODE_HOME || !axis->referenced ||
                      own->commissioned == 0U;
    PROMISE(!weak || abs(duty) <= own->low_duty_q15);
    PROMISE(off || axis->fault == TL_WIRE_FAULT_NONE);
    PROMISE(!off || duty == 0);
    PROMISE(off || axis->mode == TL_WIRE_MODE_CHECK || axis->checked);
    PROMISE(axis->referenced || !(tl_axis_is_following(axis) || axis->mode == TL_WIRE_MODE_CALIBRATE));
    if (axis->closed && s->closed && axis->mode != TL_WIRE_MODE_HOME && s->mode != TL_WIRE_MODE_HOME) {
        PROMISE(abs(axis->path.q - s->path_q) <= own->speed_q8_s / (int32_t)hz + 2);
    }
    if (axis->closed && (!s->closed || (s->mode == TL_WIRE_MODE_HOME && axis->mode != TL_WIRE_MODE_HOME))) {
        s->began_q = axis->path.q; // outside of the range it may stay, and come back
    }
    if (axis->closed && axis->referenced && axis->mode != TL_WIRE_MODE_HOME) {
        PROMISE(axis->path.q >= (own->q_low_q8 < s->began_q ? own->q_low_q8 : s->began_q) - 1);
        PROMISE(axis->path.q <= (own->q_high_q8 > s->began_q ? own->q_high_q8 : s->began_q) + 1);
    }
    const bool ill = fake.driver_fault[i] || (own->supply_low_mv > 0U && fake.supply_mv < own->supply_low_mv);
    s->ill = ill && !off ? s->ill + 1 : 0;
    PROMISE(ms(s->ill) <= 25);
    const bool stops = fake.estop_closed != (own->estop == TL_WIRE_ESTOP_OPEN);
    s->stopped = stops ? s->stopped + 1 : 0;
    PROMISE(ms(s->stopped) <= 6 || (off && axis->fault != TL_WIRE_FAULT_NONE));
    s->mode = axis->mode;
    s->closed = axis->closed;
    s->path_q = axis->path.q;
}

static void live(int32_t count) {
    for (int32_t i = 0; i < count && steps < STEPS; i++, steps++) {
        fake.t_us += 1000000U / hz;
        for (uint8_t axis = 0; axis < AXES; axis++) {
            fake_turn(axis, 1.0 / hz);
        }
        tl_app_control(&app);
        for (uint8_t axis = 0; axis < AXES; axis++) {
            check(axis);
        }
        tl_app_task(&app);
    }
}

static void start(void) {
    const bool ready = fuzz_byte() % 4U != 0U;
    fake_start(AXES, one_in(8) ? TL_WIRE_BOOT_WATCHDOG : TL_WIRE_BOOT_POWER);
    fake_port.control_hz = hz;
    tl_app_init(&app, &fake_port);
    tl_app_bus(&app, true);
    if (ready) {
        fake_commission();
        fake_ready();
    }
    memset(seen, 0, sizeof(seen));
}

static void say(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const size_t size = any_request(frame, &app, fake.t_us);
    for (uint8_t i = 0; i < AXES; i++) {
        seen[i].closed = false; // off and on again, or other settings
    }
    tl_app_receive(&app, frame, size);
}

static void load(void) {
    const uint8_t axis = (uint8_t)between(0, (int32_t)AXES - 1);
    (void)fake_upload(axis, blob, any_table(blob, axis));
}

static void suffer(void) {
    const uint8_t axis = (uint8_t)between(0, (int32_t)AXES - 1);
    switch (between(0, 11)) {
    case 0:
        fake.blocked = !fake.blocked;
        break;
    case 1:
        fake.driver_fault[axis] = !fake.driver_fault[axis];
        break;
    case 2:
        fake.supply_mv = (uint16_t)between(0, 6000);
        break;
    case 3:
        fake.current_ma = between(-3000, 3000);
        break;
    case 4:
        fake.position[axis] += between(-30000, 30000);
        break;
    case 5:
        fake.slipped[axis] = true;
        break;
    case 6:
        fake.stuck = !fake.stuck;
        fake.shown = (int32_t)fake.position[axis];
        break;
    case 7:
        fake.estop_closed = !fake.estop_closed;
        break;
    case 8:
        tl_app_bus(&app, false);
        tl_app_bus(&app, true);
        break;
    case 9: // no control step for a while
        fake.t_us += (tl_us_t)between(0, 200000);
        break;
    case 10:
        fake.cut_at = fake.operations + (uint32_t)between(1, 16);
        fake.cut_pattern = (unsigned)between(0, 3);
        break;
    default:
        start();
        break;
    }
}

static void listen(void) {
    static tl_wire_parser_t parser;
    uint8_t bytes[64];
    for (size_t size; (size = tl_app_transmit(&app, bytes, sizeof(bytes))) > 0;) {
        const uint8_t *data = bytes;
        for (tl_wire_frame_t frame; tl_wire_parse(&parser, &data, &size, &frame);) {
            PROMISE(tl_wire_size(frame.type) == frame.size);
            PROMISE(tl_wire_decode(frame.type, frame.payload, frame.size, &heard[frame.type]));
            heard_count[frame.type]++;
        }
    }
    PROMISE(parser.fill == 0); // whole frames alone
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    fuzz_from(data, size);
    hz = between(0, 1) == 0 ? 1000U : FAKE_HZ;
    steps = 0;
    memset(&fake, 0, sizeof(fake));
    memset(fake.flash, 0xFF, sizeof(fake.flash));
    memset(heard_count, 0, sizeof(heard_count));
    fake.supply_mv = 6000;
    fake.lag_s = FAKE_LAG;
    fake.wiring[0] = 1.0;
    fake.wiring[1] = one_in(16) ? -1.0 : 1.0;
    start();
    if (one_in(2)) {
        load();
    }
    while (fuzz_left > 0 && steps < STEPS) {
        const uint32_t what = fuzz_byte();
        if (what < 160U) {
            say();
        } else if (what < 176U) {
            suffer();
        } else if (what < 180U) {
            load();
        } else {
            live(between(1, 60));
        }
        listen();
    }
    if (fake.dead || app.reboot != 0U) {
        start(); // from what is left in flash
        listen();
    }
    const tl_wire_safe_stop_t stop = {.axis = TL_WIRE_ALL_AXES};
    const tl_wire_ping_t ping = {.host_us = 7};
    uint8_t frame[TL_WIRE_FRAME_MAX];
    fake.t_us += 30000U; // the rest of a frame does not come
    tl_app_task(&app);
    listen();
    const uint32_t pongs = heard_count[TL_WIRE_PONG];
    tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_SAFE_STOP, 1, &stop));
    tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_PING, 2, &ping));
    listen();
    PROMISE(heard_count[TL_WIRE_PONG] == pongs + 1U && heard[TL_WIRE_PONG].pong.host_us == 7U);
    for (uint8_t i = 0; i < AXES; i++) {
        PROMISE(app.axes[i].mode == TL_WIRE_MODE_OFF);
    }
    return 0;
}
