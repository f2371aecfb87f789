// Any bytes, in parts of any size: what the parser finds are whole frames, whatever it is fed a whole frame is found
// behind it, and every message comes back as it was read.
#include "fuzz.h"

#include "tautline/tl_crc.h"
#include "tautline/tl_wire.h"

#include <string.h>

static uint32_t pings; // of those that are looked for

static void take(const tl_wire_frame_t *frame) {
    PROMISE(frame->size <= TL_WIRE_PAYLOAD_MAX);
    const uint8_t *start = frame->payload - TL_WIRE_HEADER_SIZE, *crc = frame->payload + frame->size;
    const uint32_t told = crc[0] | (uint32_t)crc[1] << 8 | (uint32_t)crc[2] << 16 | (uint32_t)crc[3] << 24;
    PROMISE(told == tl_crc32(0, start, TL_WIRE_HEADER_SIZE + frame->size));
    tl_wire_message_t message;
    const bool decoded = tl_wire_decode(frame->type, frame->payload, frame->size, &message);
    PROMISE(decoded == (tl_wire_size(frame->type) != 0 && frame->size >= tl_wire_size(frame->type)));
    if (decoded) {
        uint8_t again[TL_WIRE_FRAME_MAX];
        const size_t size = tl_wire_frame(again, frame->type, frame->sequence, &message);
        PROMISE(size == TL_WIRE_HEADER_SIZE + tl_wire_size(frame->type) + TL_WIRE_CRC_SIZE);
        PROMISE(memcmp(again + TL_WIRE_HEADER_SIZE, frame->payload, tl_wire_size(frame->type)) == 0);
        pings += frame->type == TL_WIRE_PING && message.ping.host_us == 0x1122334455667788U ? 1U : 0U;
    }
}

static void feed(tl_wire_parser_t *parser, const uint8_t *data, size_t size) {
    tl_wire_frame_t frame;
    while (tl_wire_parse(parser, &data, &size, &frame)) {
        take(&frame);
    }
    PROMISE(size == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    tl_wire_parser_t parser = {.fill = 0};
    // The input is frames whose check and CRC are made right where a byte says so, in parts.
    fuzz_from(data, size);
    while (fuzz_left > 0) {
        uint8_t part[TL_WIRE_FRAME_MAX];
        const size_t most = (size_t)between(1, TL_WIRE_FRAME_MAX), count = most < fuzz_left ? most : fuzz_left;
        if (between(0, 3) != 0) {
            tl_wire_message_t message = {.batch = {.axis = 0}};
            const uint8_t type = (uint8_t)fuzz_byte();
            for (size_t i = 0; i < count && i < sizeof(message); i++) {
                ((uint8_t *)&message)[i] = (uint8_t)fuzz_byte();
            }
            const size_t whole = tl_wire_frame(part, type, (uint16_t)fuzz_byte(), &message);
            const size_t sent = between(0, 7) == 0 && whole > 0 ? (size_t)between(0, (int32_t)whole) : whole;
            feed(&parser, part, sent);
        } else {
            for (size_t i = 0; i < count; i++) {
                part[i] = (uint8_t)fuzz_byte();
            }
            feed(&parser, part, count);
        }
    }
    while (tl_wire_skip(&parser)) { // the rest of a frame does not come
        feed(&parser, NULL, 0);
    }
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_ping_t ping = {.host_us = 0x1122334455667788U};
    const uint32_t before = pings;
    feed(&parser, frame, tl_wire_frame(frame, TL_WIRE_PING, 7, &ping));
    PROMISE(pings == before + 1U);
    return 0;
}
