// TinyUSB with the whole app on the desktop board's bus: control transfers of any kind that end anywhere, bulk packets
// of any size, resets, pulled plugs, cut power, ills. A fault is off and off is no drive; and whatever was before, the
// next host finds a device that enumerates and answers.
#include "requests.h"

#include <tusb.h>

#include "board.h"
#include "bus.h"
#include "tautline/tl_usb.h"

#define AXES       2U
#define STEPS_MOST 2000 // of MOTOR_STEP_US, of an input
#define DFU        1U   // its interface

static uint8_t blob[TL_TABLE_SIZE_MAX];
static int32_t steps;

static void check(void) {
    for (uint8_t i = 0; i < AXES; i++) {
        const tl_axis_t *axis = &board_app()->axes[i];
        const bool off = axis->mode == TL_WIRE_MODE_OFF;
        PROMISE(off || axis->fault == TL_WIRE_FAULT_NONE);
        PROMISE(!off || axis->motor.duty == 0);
        PROMISE(abs(axis->motor.duty) <= axis->settings.duty_q15);
    }
}

static void live(int32_t count) {
    for (int32_t i = 0; i < count && steps < STEPS_MOST; i++, steps++) {
        board_step();
    }
    check();
}

// A whole transfer, or as much of one as the host stays for; the bytes of the data stage.
static size_t control(const uint8_t setup[8], uint8_t *data, size_t size, int32_t packets) {
    const bool in = (setup[0] & TUSB_DIR_IN_MASK) != 0;
    bus_setup(setup);
    size_t done = 0;
    for (bool more = size > 0; more && packets > 0; packets--) {
        uint8_t packet[BUS_PACKET];
        const size_t left = size - done, most = left < BUS_PACKET ? left : BUS_PACKET;
        const int moved = in ? bus_in(0, packet) : bus_out(0, data + done, most);
        if (moved < 0) {
            return done;
        }
        const size_t kept = (size_t)moved < most ? (size_t)moved : most;
        if (in) {
            memcpy(data + done, packet, kept);
        }
        done += kept;
        more = moved == BUS_PACKET && done < size;
    }
    if (packets > 0) {
        uint8_t packet[BUS_PACKET];
        (void)(in && size > 0 ? bus_out(0, NULL, 0) : bus_in(0, packet));
    }
    return done;
}

static size_t request(uint8_t type, uint8_t code, uint16_t value, uint16_t index, uint8_t *data, uint16_t size) {
    const uint8_t setup[8] = {type,           code,
                              (uint8_t)value, (uint8_t)(value >> 8),
                              (uint8_t)index, (uint8_t)(index >> 8),
                              (uint8_t)size,  (uint8_t)(size >> 8)};
    return control(setup, data, size, size / BUS_PACKET + 2);
}

static void configure(void) {
    (void)request(0x00, TUSB_REQ_SET_CONFIGURATION, 1, 0, NULL, 0);
}

static void any_control(void) {
    static const uint8_t likely_ones[][4] = {
        {0x80, TUSB_REQ_GET_DESCRIPTOR, 0, 1},
        {0x80, TUSB_REQ_GET_DESCRIPTOR, 0, 2},
        {0x80, TUSB_REQ_GET_DESCRIPTOR, 4, 3},
        {0x80, TUSB_REQ_GET_DESCRIPTOR, 0, 15},
        {0x00, TUSB_REQ_SET_CONFIGURATION, 1},
        {0x00, TUSB_REQ_SET_CONFIGURATION, 0},
        {0x80, TUSB_REQ_GET_STATUS},
        {0x81, TUSB_REQ_GET_INTERFACE},
        {0x01, TUSB_REQ_SET_INTERFACE, 1},
        {0x02, TUSB_REQ_CLEAR_FEATURE},
        {0x02, TUSB_REQ_SET_FEATURE},
        {0xC0, 0x01},
        {0x21, DFU_REQUEST_DNLOAD},
        {0xA1, DFU_REQUEST_UPLOAD},
        {0xA1, DFU_REQUEST_GETSTATUS},
        {0x21, DFU_REQUEST_CLRSTATUS},
        {0xA1, DFU_REQUEST_GETSTATE},
        {0x21, DFU_REQUEST_ABORT},
        {0x21, DFU_REQUEST_DETACH},
        {0x00, TUSB_REQ_SET_ADDRESS, 2},
    };
    uint8_t setup[8] = {0}, data[1024];
    memcpy(setup, likely_ones[between(0, (int32_t)(sizeof(likely_ones) / sizeof(likely_ones[0])) - 1)], 4);
    const uint16_t size = (uint16_t)(one_in(3) ? 0 : between(0, (int32_t)sizeof(data)));
    setup[4] = (uint8_t)(setup[1] == 0x01 && setup[0] == 0xC0 ? 7U : (setup[0] & 0x1FU) == 1U ? DFU : fuzz_byte());
    setup[6] = (uint8_t)size;
    setup[7] = (uint8_t)(size >> 8);
    for (int32_t changes = one_in(4) ? between(1, 4) : 0; changes > 0; changes--) {
        setup[between(0, 5)] = (uint8_t)fuzz_byte();
    }
    memset(data, (int)fuzz_byte(), size);
    (void)control(setup, data, size, one_in(4) ? between(0, 5) : 100);
}

// A table, block by block as dfu-util sends it; it may end early.
static void download(void) {
    const uint8_t axis = (uint8_t)between(0, 3);
    const uint16_t size = any_table(blob, axis);
    uint8_t status[6];
    (void)request(0x01, TUSB_REQ_SET_INTERFACE, axis, DFU, NULL, 0);
    (void)request(0x21, DFU_REQUEST_CLRSTATUS, 0, DFU, NULL, 0);
    uint16_t block = 0;
    for (uint16_t at = 0; at < size && !one_in(64); at = (uint16_t)(at + CFG_TUD_DFU_XFER_BUFSIZE), block++) {
        const uint16_t left = (uint16_t)(size - at);
        const uint16_t part = left < CFG_TUD_DFU_XFER_BUFSIZE ? left : CFG_TUD_DFU_XFER_BUFSIZE;
        (void)request(0x21, DFU_REQUEST_DNLOAD, block, DFU, blob + at, part);
        (void)request(0xA1, DFU_REQUEST_GETSTATUS, 0, DFU, status, sizeof(status));
        board_task();
    }
    (void)request(0x21, DFU_REQUEST_DNLOAD, block, DFU, NULL, 0);
    (void)request(0xA1, DFU_REQUEST_GETSTATUS, 0, DFU, status, sizeof(status));
    board_task();
}

static void bulk_out(const uint8_t *bytes, size_t size) {
    for (size_t at = 0; at < size; at += BUS_PACKET) {
        const size_t left = size - at;
        if (bus_out(1, bytes + at, left < BUS_PACKET ? left : BUS_PACKET) < 0) {
            return;
        }
        board_task();
    }
}

static void say(void) {
    uint8_t bytes[TL_WIRE_FRAME_MAX];
    size_t size = 0;
    if (one_in(8)) {
        for (size = (size_t)between(0, BUS_PACKET + 8); size < BUS_PACKET && one_in(2); size++) {
        }
        for (size_t i = 0; i < size; i++) {
            bytes[i] = (uint8_t)fuzz_byte();
        }
    } else {
        size = any_request(bytes, board_app(), board_state()->t_us - board_state()->boot_us);
    }
    bulk_out(bytes, size);
}

static void listen(int32_t packets) {
    uint8_t packet[BUS_PACKET];
    for (; packets > 0 && bus_in(1, packet) >= 0; packets--) {
        board_task();
    }
}

static void suffer(void) {
    const uint8_t axis = (uint8_t)between(0, (int32_t)AXES - 1);
    switch (between(0, 7)) {
    case 0:
        board_inject(axis, (plant_ill_t)between(0, PLANT_ESTOP));
        break;
    case 1:
        board_cut((uint32_t)between(0, 12));
        break;
    case 2:
        bus_unplug();
        break;
    case 3:
        board_start(TL_WIRE_BOOT_POWER);
        break;
    case 4:
        board_place(axis, between(-4000, 4000) * TL_COUNT_ONE);
        break;
    default:
        bus_reset();
        configure();
        break;
    }
}

// The last word: a host comes, and finds a board.
static void meet(void) {
    uint8_t descriptor[18] = {0};
    board_start(TL_WIRE_BOOT_POWER);
    bus_reset();
    PROMISE(request(0x80, TUSB_REQ_GET_DESCRIPTOR, 0x0100, 0, descriptor, sizeof(descriptor)) == sizeof(descriptor));
    PROMISE(descriptor[0] == sizeof(descriptor) && descriptor[1] == TUSB_DESC_DEVICE);
    configure();
    PROMISE(tud_mounted());
    const tl_wire_ping_t ping = {.host_us = 0x1122334455667788U};
    uint8_t frame[TL_WIRE_FRAME_MAX], packet[BUS_PACKET];
    bulk_out(frame, tl_wire_frame(frame, TL_WIRE_PING, 7, &ping));
    tl_wire_parser_t parser = {.fill = 0};
    bool answered = false;
    for (int size; !answered && (size = bus_in(1, packet)) >= 0; board_task()) {
        const uint8_t *data = packet;
        size_t left = (size_t)size;
        tl_wire_message_t message;
        for (tl_wire_frame_t got; tl_wire_parse(&parser, &data, &left, &got);) {
            answered =
                answered || (got.type == TL_WIRE_PONG && tl_wire_decode(got.type, got.payload, got.size, &message) &&
                             message.pong.host_us == ping.host_us);
        }
    }
    PROMISE(answered);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const board_options_t options = {.axes = AXES, .control_hz = 5000U, .serial = "FUZZ"};
    fuzz_from(data, size);
    if (!board_open(&options)) {
        abort();
    }
    bus_reset();
    configure();
    steps = 0;
    while (fuzz_left > 0 && steps < STEPS_MOST) {
        const uint32_t what = fuzz_byte();
        if (what < 64U) {
            any_control();
        } else if (what < 160U) {
            say();
        } else if (what < 176U) {
            listen(between(1, 20));
        } else if (what < 192U) {
            suffer();
        } else if (what < 200U) {
            download();
        } else {
            live(between(1, 255));
        }
        board_task();
    }
    meet();
    return 0;
}
