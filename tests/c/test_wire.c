#include "tautline/tl_wire.h"

#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "random_u32.h"

void setUp(void) {}
void tearDown(void) {}

static const uint8_t types[] = {
#define TYPE(code, NAME, name, doc) code,
    TL_WIRE_MESSAGES(TYPE)};

static void random_payload(uint8_t *payload, size_t size) {
    for (size_t i = 0; i < size; i++) {
        payload[i] = (uint8_t)random_u32();
    }
}

// Random payload -> struct -> frame -> parser -> the same payload, for every message.
static void test_every_message_survives_the_round_trip(void) {
    seed = 1;
    for (size_t i = 0; i < sizeof(types); i++) {
        const size_t size = tl_wire_size(types[i]);
        uint8_t payload[TL_WIRE_PAYLOAD_MAX];
        random_payload(payload, size);
        tl_wire_message_t message;
        TEST_ASSERT_TRUE(tl_wire_decode(types[i], payload, size, &message));
        uint8_t frame[TL_WIRE_FRAME_MAX];
        const size_t length = tl_wire_frame(frame, types[i], 0xBEEF, &message);
        TEST_ASSERT_EQUAL(size + TL_WIRE_HEADER_SIZE + TL_WIRE_CRC_SIZE, length);
        tl_wire_parser_t parser = {0};
        const uint8_t *data = frame;
        size_t left = length;
        tl_wire_frame_t got;
        TEST_ASSERT_TRUE(tl_wire_parse(&parser, &data, &left, &got));
        TEST_ASSERT_EQUAL(types[i], got.type);
        TEST_ASSERT_EQUAL_HEX16(0xBEEF, got.sequence);
        TEST_ASSERT_EQUAL(size, got.size);
        TEST_ASSERT_EQUAL_MEMORY(payload, got.payload, size);
        TEST_ASSERT_FALSE(tl_wire_parse(&parser, &data, &left, &got));
        TEST_ASSERT_EQUAL(0, parser.bytes_bad);
    }
}

static void test_the_layout_is_little_endian_and_fixed(void) {
    const tl_wire_set_point_t set_point = {.axis = 2, .value = -2, .at_us = 0x0102030405060708ULL};
    uint8_t frame[TL_WIRE_FRAME_MAX];
    TEST_ASSERT_EQUAL(8 + 13 + 4, tl_wire_frame(frame, TL_WIRE_SET_POINT, 0x1234, &set_point));
    const uint8_t head[] = {0x54, 0x7E, 0x07};
    const uint8_t rest[] = {13, 0, 0x34, 0x12, 2, 0xFE, 0xFF, 0xFF, 0xFF, 8, 7, 6, 5, 4, 3, 2, 1};
    TEST_ASSERT_EQUAL_MEMORY(head, frame, sizeof(head));
    TEST_ASSERT_EQUAL_MEMORY(rest, frame + 4, sizeof(rest));
}

static void test_unknown_and_short_messages_are_refused(void) {
    tl_wire_message_t message;
    memset(&message, 0x55, sizeof(message));
    uint8_t frame[TL_WIRE_FRAME_MAX];
    TEST_ASSERT_EQUAL(0, tl_wire_frame(frame, 0x7F, 0, &message));
    TEST_ASSERT_EQUAL(0, tl_wire_size(0));
    const uint8_t payload[TL_WIRE_PAYLOAD_MAX] = {0};
    for (size_t i = 0; i < sizeof(types); i++) {
        TEST_ASSERT_FALSE(tl_wire_decode(types[i], payload, tl_wire_size(types[i]) - 1U, &message));
        TEST_ASSERT_TRUE(tl_wire_decode(types[i], payload, tl_wire_size(types[i]) + 1U, &message)); // a newer minor
    }
}

// A stream of good frames with garbage, damaged and truncated frames between them, fed in random pieces: every good
// frame comes out, in order, and no other.
static void test_no_whole_frame_is_lost_in_garbage(void) {
    for (uint32_t run = 1; run <= 300; run++) {
        seed = run * 2654435761U;
        static uint8_t stream[60000];
        size_t length = 0;
        uint32_t good = 0;
        uint32_t garbage = 0;
        while (length < sizeof(stream) - 2U * TL_WIRE_FRAME_MAX) {
            uint8_t frame[TL_WIRE_FRAME_MAX];
            tl_wire_message_t message = {0};
            message.ping.host_us = good;
            const size_t size = tl_wire_frame(frame, TL_WIRE_PING, (uint16_t)good, &message);
            switch (random_u32() % 5U) {
            case 0: { // noise, rich in magic numbers
                const size_t count = random_u32() % 40U;
                for (size_t i = 0; i < count; i++) {
                    const uint32_t r = random_u32() % 4U;
                    stream[length++] = r == 0U ? 0x54U : (r == 1U ? 0x7EU : (uint8_t)random_u32());
                }
                garbage += (uint32_t)count;
                break;
            }
            case 1: { // one bit flipped
                const uint32_t bit = random_u32() % (uint32_t)(8U * size);
                frame[bit / 8U] ^= (uint8_t)(1U << (bit % 8U));
                memcpy(stream + length, frame, size);
                length += size;
                garbage += (uint32_t)size;
                break;
            }
            case 2: {                                                        // cut short
                const size_t cut = random_u32() % (size - TL_WIRE_CRC_SIZE); // else noise may complete it
                memcpy(stream + length, frame, cut);
                length += cut;
                garbage += (uint32_t)cut;
                break;
            }
            default:
                memcpy(stream + length, frame, size);
                length += size;
                good++;
                break;
            }
        }
        memset(stream + length, 0, TL_WIRE_FRAME_MAX); // whatever a false length still waits for
        length += TL_WIRE_FRAME_MAX;
        tl_wire_parser_t parser = {0};
        uint32_t found = 0;
        for (size_t at = 0; at < length;) {
            size_t piece = 1U + random_u32() % 100U;
            piece = piece < length - at ? piece : length - at;
            const uint8_t *data = stream + at;
            at += piece;
            tl_wire_frame_t frame;
            while (tl_wire_parse(&parser, &data, &piece, &frame)) {
                tl_wire_ping_t ping;
                TEST_ASSERT_TRUE(tl_wire_decode(frame.type, frame.payload, frame.size, &ping));
                TEST_ASSERT_EQUAL(found, ping.host_us);
                found++;
            }
        }
        TEST_ASSERT_EQUAL(good, found);
        TEST_ASSERT_EQUAL(garbage + TL_WIRE_FRAME_MAX, parser.bytes_bad + parser.fill);
    }
}

static void test_a_false_length_is_dropped_at_its_header(void) {
    uint8_t stream[TL_WIRE_HEADER_SIZE + TL_WIRE_FRAME_MAX] = {0x54, 0x7E, 0x01, 0x00, 0xFF, 0x00, 0x00, 0x00};
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR};
    const uint8_t *data = stream;
    size_t size = TL_WIRE_HEADER_SIZE + tl_wire_frame(stream + TL_WIRE_HEADER_SIZE, TL_WIRE_HELLO, 7, &hello);
    tl_wire_parser_t parser = {0};
    tl_wire_frame_t frame;
    TEST_ASSERT_TRUE(tl_wire_parse(&parser, &data, &size, &frame));
    TEST_ASSERT_EQUAL(7, frame.sequence);
    TEST_ASSERT_EQUAL(TL_WIRE_HEADER_SIZE, parser.bytes_bad);
}

static void test_what_follows_a_skip_after_a_whole_frame_is_read(void) {
    static tl_wire_parser_t parser;
    const tl_wire_ping_t ping = {0};
    uint8_t bytes[TL_WIRE_FRAME_MAX];
    tl_wire_frame_t frame;
    for (uint16_t sequence = 1; sequence <= 3; sequence++) {
        size_t size = tl_wire_frame(bytes, TL_WIRE_PING, sequence, &ping);
        const uint8_t *data = bytes;
        TEST_ASSERT_TRUE(tl_wire_parse(&parser, &data, &size, &frame));
        TEST_ASSERT_EQUAL(sequence, frame.sequence);
        TEST_ASSERT_FALSE(tl_wire_skip(&parser)); // nothing is left to skip
    }
    TEST_ASSERT_EQUAL(0, parser.bytes_bad);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_message_survives_the_round_trip);
    RUN_TEST(test_the_layout_is_little_endian_and_fixed);
    RUN_TEST(test_unknown_and_short_messages_are_refused);
    RUN_TEST(test_no_whole_frame_is_lost_in_garbage);
    RUN_TEST(test_a_false_length_is_dropped_at_its_header);
    RUN_TEST(test_what_follows_a_skip_after_a_whole_frame_is_read);
    return UNITY_END();
}
