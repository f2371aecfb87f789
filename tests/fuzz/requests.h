// What a host may ask a board for, as a frame: requests that mean something, of which some bytes are any.
#ifndef REQUESTS_H
#define REQUESTS_H

#include "fuzz.h"

#include "../c/table_fixture.h"

#include "tautline/tl_app.h"
#include "tautline/tl_crc.h"

static inline bool one_in(int32_t n) {
    return between(1, n) == 1;
}

static inline tl_wire_message_t likely(uint8_t type, const tl_app_t *app, tl_us_t now_us) {
    const uint8_t axis = (uint8_t)between(0, 15);
    tl_wire_message_t m;
    memset(&m, 0, sizeof(m));
    m.get_status.axis = axis == 15U ? TL_WIRE_ALL_AXES : axis % app->port->axes; // each request's first field
    const tl_axis_t *own = &app->axes[axis % app->port->axes];
    const int32_t somewhere = between(-4000, 4000) * TL_COUNT_ONE;
    switch (type) {
    case TL_WIRE_ENABLE:
        m.enable.on = (uint8_t)between(0, 3) != 0U;
        break;
    case TL_WIRE_FOLLOW:
        m.follow.target = (uint8_t)between(0, 1);
        m.follow.compensation = (uint8_t)between(0, 2);
        m.follow.silence_us = one_in(2) ? 0U : 300000U;
        break;
    case TL_WIRE_SET_POINT:
        m.set_point.value = own->mode == TL_WIRE_MODE_FOLLOW_TIP ? between(-80, 80) * TL_DEG_ONE : somewhere;
        m.set_point.at_us = one_in(2) ? 0U : now_us + (tl_us_t)between(0, 200000);
        break;
    case TL_WIRE_MOVE:
        m.move.q_q8 = somewhere;
        m.move.speed_q8_s = between(0, 8000) * TL_COUNT_ONE;
        m.move.silence_us = 300000U;
        break;
    case TL_WIRE_LIMITS:
        m.limits = own->limits;
        break;
    case TL_WIRE_SETTINGS:
        m.settings = own->settings;
        m.settings.key = TL_WIRE_KEY;
        m.settings.commissioned = 1U;
        break;
    case TL_WIRE_HOME:
        m.home.direction = (int8_t)(one_in(2) ? 1 : -1);
        m.home.reach_q8 = between(1, 5000) * TL_COUNT_ONE;
        m.home.silence_us = 300000U;
        break;
    case TL_WIRE_JOG:
        m.jog.way_q8 = somewhere / 8;
        m.jog.silence_us = 300000U;
        break;
    case TL_WIRE_ADAPT:
        m.adapt.scale_q15 = between(16384, 49152);
        m.adapt.within_ms = (uint16_t)between(0, 200);
        break;
    case TL_WIRE_MARKER:
        m.marker.valid = 1U;
        m.marker.arrival_us = now_us;
        m.marker.u_q12 = somewhere / 16;
        break;
    case TL_WIRE_MOTION_START:
        m.motion_start.cycles = 2;
        m.motion_start.low_q8 = -400 * TL_COUNT_ONE;
        m.motion_start.high_q8 = 400 * TL_COUNT_ONE;
        m.motion_start.speed_q8_s[0] = between(1, 4000) * TL_COUNT_ONE;
        m.motion_start.transit_q8_s = 4000 * TL_COUNT_ONE;
        m.motion_start.acceleration_q8_s2 = 40000 * TL_COUNT_ONE;
        m.motion_start.approach_q8 = 20 * TL_COUNT_ONE;
        m.motion_start.stroke_max_q8 = 200 * TL_COUNT_ONE;
        m.motion_start.host_timeout_us = 300000U;
        break;
    case TL_WIRE_TELEMETRY:
        m.telemetry.divider = (uint8_t)between(0, 4);
        break;
    case TL_WIRE_REBOOT:
        m.reboot.key = TL_WIRE_KEY;
        break;
    case TL_WIRE_TABLE_WRITE:
        m.table_write.count = TL_WIRE_PART;
        break;
    default:
        break;
    }
    return m;
}

// Bytes of it.
static inline size_t any_request(uint8_t frame[TL_WIRE_FRAME_MAX], const tl_app_t *app, tl_us_t now_us) {
    const uint8_t type = (uint8_t)(one_in(32) ? between(0, 255) : between(TL_WIRE_HELLO, TL_WIRE_GET_LOGGED));
    const tl_wire_message_t message = likely(type, app, now_us);
    const size_t size = tl_wire_frame(frame, type, (uint16_t)fuzz_byte(), &message);
    if (size == 0) {
        return 0; // there is no such type
    }
    uint8_t *payload = frame + TL_WIRE_HEADER_SIZE;
    const size_t length = size - TL_WIRE_HEADER_SIZE - TL_WIRE_CRC_SIZE;
    for (int32_t changes = one_in(3) ? between(1, 8) : 0; changes > 0; changes--) {
        payload[between(0, (int32_t)length - 1)] = (uint8_t)fuzz_byte();
    }
    const uint32_t crc = tl_crc32(0, frame, TL_WIRE_HEADER_SIZE + length);
    for (size_t i = 0; i < TL_WIRE_CRC_SIZE; i++) {
        payload[length + i] = (uint8_t)(crc >> (8U * i));
    }
    return size;
}

// A table that is whole, or damaged.
static inline uint16_t any_table(uint8_t blob[TL_TABLE_SIZE_MAX], uint8_t axis) {
    static tl_table_t table;
    table = table_fixture(one_in(2) ? 1 : -1);
    table.axis = axis;
    table.created_s = fuzz_byte();
    const size_t size = tl_table_encode(&table, blob, TL_TABLE_SIZE_MAX);
    for (int32_t damage = one_in(2) ? between(1, 4) : 0; damage > 0; damage--) {
        blob[between(0, (int32_t)size - 1)] = (uint8_t)fuzz_byte();
    }
    return (uint16_t)size;
}

#endif
