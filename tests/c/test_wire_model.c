// Frames in any stream of bytes, in any pieces, with skips: what tl_wire.h says of them, byte by byte. And every
// message field by field.
#include "draws.h"
#include "tautline/tl_wire.h"
#include "words.h"

#include <string.h>
#include <unity.h>

#define STREAMS  1000
#define MESSAGES 20 // of each type
#define LONGEST  1500U

void setUp(void) {
    seed = 577215U;
}
void tearDown(void) {}

// -- frames -----------------------------------------------------------------------------------------------------------

static uint8_t check_of(const uint8_t *header) { // of all bytes of a header but itself
    static const uint8_t places[] = {0, 1, 2, 4, 5, 6, 7};
    uint32_t check = 0x5AU;
    for (unsigned i = 0; i < sizeof(places); i++) {
        check = (((check << 1 | check >> 7) & 0xFFU) + header[places[i]]) & 0xFFU;
    }
    return (uint8_t)check;
}

static size_t payload_of(const uint8_t *header) {
    return header[4] | (size_t)header[5] << 8;
}

static size_t finish(uint8_t *frame, uint8_t type, uint16_t sequence, size_t size) {
    const uint8_t header[] = {
        0x54, 0x7E, type, 0, (uint8_t)size, (uint8_t)(size >> 8), (uint8_t)sequence, (uint8_t)(sequence >> 8)};
    memcpy(frame, header, sizeof(header));
    frame[3] = check_of(frame);
    const uint32_t crc = crc_of(frame, 8U + size);
    for (unsigned i = 0; i < 4U; i++) {
        frame[8U + size + i] = (uint8_t)(crc >> 8U * i);
    }
    return 12U + size;
}

// What a parser has not yet made a frame of, or given up.
static struct {
    uint8_t bytes[2U * LONGEST];
    size_t fill, returned; // bytes of the frame that was returned last
    uint32_t bad;
} m;

static void give_up(size_t count, bool bad) {
    m.fill -= count;
    m.bad += bad ? (uint32_t)count : 0U;
    memmove(m.bytes, m.bytes + count, m.fill);
}

static bool may_begin(void) { // a frame, as far as its bytes have come
    return (m.fill < 1U || m.bytes[0] == 0x54U) && (m.fill < 2U || m.bytes[1] == 0x7EU) &&
           (m.fill < 8U || (m.bytes[3] == check_of(m.bytes) && payload_of(m.bytes) <= TL_WIRE_PAYLOAD_MAX));
}

static size_t whole(void) { // bytes of the frame in front; 0: none is whole
    for (;;) {
        while (!may_begin()) {
            give_up(1, true);
        }
        const size_t size = m.fill < 8U ? LONGEST : 12U + payload_of(m.bytes);
        if (m.fill < size) {
            return 0;
        }
        uint8_t right[TL_WIRE_FRAME_MAX];
        memcpy(right, m.bytes, size);
        finish(right, m.bytes[2], (uint16_t)(m.bytes[6] | m.bytes[7] << 8), size - 12U);
        if (memcmp(right, m.bytes, size) == 0) {
            return size;
        }
        give_up(1, true);
    }
}

static size_t take(const uint8_t **data, size_t *size) {
    give_up(m.returned, false);
    while ((m.returned = whole()) == 0U && *size > 0U) {
        m.bytes[m.fill++] = *(*data)++;
        (*size)--;
    }
    return m.returned;
}

static size_t any_stream(uint8_t *stream) {
    size_t length = 0;
    while (length < LONGEST - TL_WIRE_FRAME_MAX) {
        uint8_t frame[TL_WIRE_FRAME_MAX];
        const size_t longest = once_in(3) ? TL_WIRE_PAYLOAD_MAX : 20U;
        for (unsigned i = 0; i < TL_WIRE_PAYLOAD_MAX; i++) { // rich in what frames begin with, or in whole frames
            const int32_t what = between(0, 5);
            frame[8U + i] = what < 2 ? 0x54U : (what < 4 ? 0x7EU : (uint8_t)random_u32());
        }
        size_t payload = once_in(4) ? longest : (size_t)between(0, (int32_t)longest);
        if (payload > 40U && once_in(2)) {
            finish(frame + 8U + between(0, 10), (uint8_t)random_u32(), 7, (size_t)between(0, 12));
        }
        size_t size = finish(frame, (uint8_t)random_u32(), (uint16_t)random_u32(), payload), from = 0;
        switch (between(0, 7)) {
        case 0:
            frame[between(0, (int32_t)size - 1)] ^= (uint8_t)(1U << between(0, 7));
            break;
        case 1:
            size = (size_t)between(1, (int32_t)size);
            break;
        case 2:
            from = (size_t)between(0, (int32_t)size - 1);
            break;
        case 3: // longer than there are
            payload = TL_WIRE_PAYLOAD_MAX + (size_t)between(0, 1);
            frame[4] = (uint8_t)payload;
            frame[5] = (uint8_t)(payload >> 8);
            frame[3] = check_of(frame);
            break;
        default:
            break;
        }
        memcpy(stream + length, frame + from, size - from);
        length += size - from;
    }
    return length;
}

static void test_frames_of_any_stream_in_any_pieces(void) {
    static uint8_t stream[LONGEST];
    uint32_t frames = 0, skips = 0;
    for (uint32_t life = 0; life < STREAMS; life++) {
        tl_wire_parser_t parser = {0};
        const size_t length = any_stream(stream), longest = once_in(3) ? 3U : (once_in(2) ? 70U : 600U);
        memset(&m, 0, sizeof(m));
        for (size_t at = 0; at < length;) {
            const size_t left = length - at, piece = (size_t)between(0, (int32_t)longest);
            const uint8_t *data = stream + at, *own = data;
            size_t size = piece < left ? piece : left, own_size = size;
            at += size;
            for (bool on = true; on;) {
                tl_wire_frame_t frame = {.type = 0};
                on = tl_wire_parse(&parser, &data, &size, &frame);
                const size_t expected = take(&own, &own_size);
                TEST_ASSERT_EQUAL(expected != 0U, on);
                TEST_ASSERT_EQUAL_PTR(own, data);
                TEST_ASSERT_EQUAL(own_size, size);
                TEST_ASSERT_EQUAL(m.bad, parser.bytes_bad);
                if (on) {
                    TEST_ASSERT_EQUAL_HEX8(m.bytes[2], frame.type);
                    TEST_ASSERT_EQUAL_HEX16(m.bytes[6] | m.bytes[7] << 8, frame.sequence);
                    TEST_ASSERT_EQUAL(expected - 12U, frame.size);
                    TEST_ASSERT_TRUE(memcmp(m.bytes + 8, frame.payload, frame.size) == 0);
                    frames++;
                }
                if (once_in(12)) {
                    give_up(m.returned, false);
                    m.returned = 0;
                    while (!may_begin()) {
                        give_up(1, true);
                    }
                    const bool waits = m.fill > 0U;
                    TEST_ASSERT_EQUAL(waits, tl_wire_skip(&parser));
                    give_up(waits ? 1U : 0U, true);
                    while (!may_begin()) {
                        give_up(1, true);
                    }
                    TEST_ASSERT_EQUAL(m.bad, parser.bytes_bad);
                    TEST_ASSERT_EQUAL(m.fill, parser.fill);
                    TEST_ASSERT_TRUE(memcmp(m.bytes, parser.buffer, m.fill) == 0);
                    skips += waits ? 1U : 0U;
                    on = true; // what came with it may be whole
                }
            }
        }
    }
    TEST_ASSERT_TRUE(frames > 5U * STREAMS && skips > STREAMS);
}

// -- messages ---------------------------------------------------------------------------------------------------------

// A struct's fields one after the other, on a machine whose integers are little-endian.
#define PACK_F(kind, name, doc)        memcpy(at, &of->name, sizeof(of->name)), at += sizeof(of->name);
#define PACK_A(kind, name, count, doc) PACK_F(kind, name, doc)
#define PACK(code, NAME, name, doc)                                                                                    \
    static size_t pack_##name(uint8_t *payload, const void *message) {                                                 \
        const tl_wire_##name##_t *of = message;                                                                        \
        uint8_t *at = payload;                                                                                         \
        TL_WIRE_FIELDS_##NAME(PACK_F, PACK_A) return (size_t)(at - payload);                                           \
    }
TL_WIRE_MESSAGES(PACK)

static size_t pack(uint8_t type, uint8_t *payload, const void *message) {
    switch (type) {
#define CASE(code, NAME, name, doc)                                                                                    \
    case code:                                                                                                         \
        return pack_##name(payload, message);
        TL_WIRE_MESSAGES(CASE)
    default:
        return 0;
    }
}

static void test_every_message_is_its_fields_one_after_the_other(void) {
    uint32_t types = 0;
    for (uint32_t type = 0; type < 256U; type++) {
        for (uint32_t i = 0; i < MESSAGES; i++) {
            union {
                tl_wire_message_t message;
                uint8_t bytes[sizeof(tl_wire_message_t)];
            } of, got, untouched;
            uint8_t expected[TL_WIRE_FRAME_MAX], frame[TL_WIRE_FRAME_MAX], again[TL_WIRE_PAYLOAD_MAX];
            for (size_t at = 0; at < sizeof(of); at++) {
                of.bytes[at] = (uint8_t)random_u32();
                got.bytes[at] = untouched.bytes[at] = 0x77U;
            }
            memset(frame, 0x77, sizeof(frame));
            memset(expected, 0x77, sizeof(expected));
            const uint16_t sequence = (uint16_t)random_u32();
            const size_t size = pack((uint8_t)type, expected + 8, &of), more = (size_t)between(0, 3);
            const size_t length = size == 0U ? 0U : finish(expected, (uint8_t)type, sequence, size);
            TEST_ASSERT_EQUAL(size, tl_wire_size((uint8_t)type));
            TEST_ASSERT_EQUAL(length, tl_wire_frame(frame, (uint8_t)type, sequence, &of));
            TEST_ASSERT_EQUAL_MEMORY(expected, frame, sizeof(frame));
            TEST_ASSERT_EQUAL(size != 0U, tl_wire_decode((uint8_t)type, frame + 8, size + more, &got));
            TEST_ASSERT_EQUAL(size, pack((uint8_t)type, again, &got));
            TEST_ASSERT_TRUE(memcmp(frame + 8, again, size) == 0);
            got = untouched;
            const size_t less = size == 0U ? 0U : (size_t)between(0, (int32_t)size - 1);
            TEST_ASSERT_FALSE(tl_wire_decode((uint8_t)type, frame + 8, less, &got));
            TEST_ASSERT_EQUAL_MEMORY(&untouched, &got, sizeof(got));
            types += size != 0U && i == 0U ? 1U : 0U;
        }
    }
    TEST_ASSERT_TRUE(types > 40U);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_frames_of_any_stream_in_any_pieces);
    RUN_TEST(test_every_message_is_its_fields_one_after_the_other);
    return UNITY_END();
}
