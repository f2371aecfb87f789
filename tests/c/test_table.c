// The blob: its bytes, and every reason to refuse it.
#include "table_fixture.h"
#include "tautline/tl_crc.h"

#include <unity.h>

static uint8_t blob[4096];
static tl_table_t read;

void setUp(void) {
    memset(blob, 0xA5, sizeof blob);
}
void tearDown(void) {}

// Written down from the layout in tl_table.h; the CRC is zlib's.
static const uint8_t golden[] = {
    0x54, 0x4C, 0x54, 0x42, 0x01, 0x00, 0x6C, 0x00, // magic, format 1, 108 bytes
    0x02, 0x01, 0x01, 0x08, 0x02, 0x00, 0x00, 0x40, // axis 2, translation, deg, step 2^8, 2 nodes, strength 0.5
    0x40, 0x42, 0x0F, 0x00, 0x00, 0xFF, 0xFF, 0xFF, // 1000000 nano-units a count, q0 = -256
    0x80, 0xFF, 0xFF, 0xFF, 0x00, 0x00, 0x00, 0x00, // q -128 .. 0
    0x00, 0x00, 0xFF, 0xFF, 0x01, 0x00, 0x01, 0x00, // coarse c -65536 .. 65537
    0x04, 0x03, 0x02, 0x01, 0x03, 0x02, 0x01, 0x00, // speed_max 0x01020304, take-up speed 0x00010203
    0xE8, 0x03, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00, // take-up acceleration 1000, band 512
    0x00, 0x01, 0x00, 0x00, 0x80, 0x00, 0x00, 0x00, // least slope 256, flat speed 128
    0x80, 0x38, 0x01, 0x00, 0x78, 0x56, 0x34, 0x12, // 80000 us, created 0x12345678
    0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, // model id
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, // instrument: not said
    0x2C, 0x01, 0x00, 0x00, 0x2C, 0x00, 0x00, 0x00, // B 300, 44
    0xFF, 0xFF, 0xFF, 0xFF, 0x45, 0x23, 0x01, 0x00, // f -1, 0x12345
    0x8F, 0x1F, 0xCE, 0x70,                         // CRC-32
};

static tl_table_t golden_table(void) {
    tl_table_t t;
    memset(&t, 0, sizeof t);
    t.axis = 2;
    t.kind = TL_AXIS_TRANSLATION;
    t.unit = TL_UNIT_DEG;
    t.step_log2 = 8;
    t.nodes = 2;
    t.strength_q15 = 0x4000;
    t.nano_units_per_count = 1000000;
    t.q0 = -256;
    t.q_min = -128;
    t.q_max = 0;
    t.coarse_c_min = -65536;
    t.coarse_c_max = 65537;
    t.speed_max_q8 = 0x01020304;
    t.takeup_speed_q8 = 0x00010203;
    t.takeup_accel = 1000;
    t.band = 512;
    t.slope_min_q28 = 256;
    t.flat_speed_q8 = 128;
    t.delay_us = 80000;
    t.created_s = 0x12345678;
    memcpy(t.model_id, "ABCDEFGH", 8);
    t.width[0] = 300;
    t.width[1] = 44;
    t.angle[0] = -1;
    t.angle[1] = 0x12345;
    return t;
}

static void test_bytes_are_the_documented_ones(void) {
    const tl_table_t table = golden_table();
    TEST_ASSERT_EQUAL_UINT(sizeof golden, tl_table_encode(&table, blob, sizeof blob));
    TEST_ASSERT_EQUAL_HEX8_ARRAY(golden, blob, sizeof golden);
    TEST_ASSERT_EQUAL_HEX8(0xA5, blob[sizeof golden]);
}

static void test_the_documented_bytes_are_read(void) {
    const tl_table_t table = golden_table();
    memset(&read, 0, sizeof read);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(golden, sizeof golden, 2, &read));
    TEST_ASSERT_EQUAL_MEMORY(&table, &read, sizeof read);
}

static void test_a_blob_is_read_at_any_alignment(void) {
    for (size_t at = 1; at < 4; at++) {
        memcpy(blob + at, golden, sizeof golden);
        TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(blob + at, sizeof golden, TL_TABLE_ANY_AXIS, &read));
    }
}

static void test_the_largest_table_fits_a_flash_sector(void) {
    tl_table_t table = table_fixture(1);
    table.step_log2 = 13;
    table.nodes = TL_TABLE_NODES_MAX;
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = 0;
        table.angle[i] = (int32_t)i;
    }
    table.q_max = table.q0 + 1;
    const size_t size = tl_table_encode(&table, blob, 4096 - 64);
    TEST_ASSERT_EQUAL_UINT(TL_TABLE_SIZE(TL_TABLE_NODES_MAX), size);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(blob, size, 0, &read));
    TEST_ASSERT_EQUAL_UINT(0, tl_table_encode(&table, blob, size - 1));
    table.nodes++;
    TEST_ASSERT_EQUAL_UINT(0, tl_table_encode(&table, blob, sizeof blob));
}

// Blob-level refusals -----------------------------------------------------------------------------

static tl_table_reason_t decode_changed(size_t at, uint8_t value, bool mend_crc) {
    memcpy(blob, golden, sizeof golden);
    blob[at] = value;
    if (mend_crc) {
        const uint32_t crc = tl_crc32(0, blob, sizeof golden - 4);
        for (unsigned i = 0; i < 4; i++) {
            blob[sizeof golden - 4 + i] = (uint8_t)(crc >> 8 * i);
        }
    }
    return tl_table_decode(blob, sizeof golden, TL_TABLE_ANY_AXIS, &read);
}

static void test_damaged_blobs_are_refused_with_their_reason(void) {
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SHORT, tl_table_decode(golden, 0, TL_TABLE_ANY_AXIS, &read));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SHORT, tl_table_decode(golden, 91, TL_TABLE_ANY_AXIS, &read));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SIZE, tl_table_decode(golden, 92, TL_TABLE_ANY_AXIS, &read));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SIZE, tl_table_decode(golden, sizeof golden - 1, TL_TABLE_ANY_AXIS, &read));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_MAGIC, decode_changed(0, 'X', true));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_FORMAT, decode_changed(4, 3, true));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SIZE, decode_changed(6, 0x6D, true));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SIZE, decode_changed(12, 3, true)); // nodes that the size does not hold
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_NODES, decode_changed(13, 2, true));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_CRC, decode_changed(30, 1, false));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_RESERVED, decode_changed(80, 1, true));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_RESERVED, decode_changed(87, 'S', true));
}

static void test_any_flipped_bit_is_refused(void) {
    for (size_t bit = 0; bit < 8 * sizeof golden; bit++) {
        const uint8_t changed = (uint8_t)(golden[bit / 8] ^ 1U << bit % 8);
        TEST_ASSERT_NOT_EQUAL_INT(TL_TABLE_OK, decode_changed(bit / 8, changed, false));
    }
}

// Sections ----------------------------------------------------------------------------------------

static tl_table_t several(void) {
    tl_table_t t = golden_table();
    t.plays = 2;
    t.period_log2 = 20;
    t.narrow = 16;
    t.play_width_q28[0] = 1U << 27; // 0.5 and 1.5 of B, half of the motion each
    t.play_width_q28[1] = 3U << 27;
    t.play_weight_q16[0] = t.play_weight_q16[1] = 32768;
    t.centre[0] = -2000000;
    t.centre[1] = 0x12345678 & 0xFFFFFF;
    return t;
}

static void test_a_section_follows_the_nodes(void) {
    const tl_table_t table = several();
    const size_t at = sizeof golden - 4; // where format 1 has its CRC
    static const uint8_t head[] = {
        0x01, 0x00, 0x48, 0x00, // section 1, 64 + 4 * 2 bytes
        0x02, 0x14, 0x00, 0x00, // 2 plays, 2^20 a period
        0x10, 0x00, 0x00, 0x00, // narrow 16
        0x00, 0x00, 0x00, 0x08, 0x00, 0x80, 0x00, 0x00, 0x00, 0x00, 0x00, 0x18, 0x00, 0x80, 0x00, 0x00,
    };
    static const uint8_t centre[] = {0x80, 0x7B, 0xE1, 0xFF, 0x78, 0x56, 0x34, 0x00};
    TEST_ASSERT_EQUAL_UINT(at + 4 + 72 + 4, tl_table_encode(&table, blob, sizeof blob));
    TEST_ASSERT_EQUAL_UINT8(2, blob[4]);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(golden + 8, blob + 8, at - 8);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(head, blob + at, sizeof head);
    TEST_ASSERT_EACH_EQUAL_HEX8(0, blob + at + sizeof head, 4 + 64 - sizeof head);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(centre, blob + at + 68, sizeof centre);
    memset(&read, 0, sizeof read);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(blob, at + 80, 2, &read));
    TEST_ASSERT_EQUAL_MEMORY(&table, &read, sizeof read);
    TEST_ASSERT_EQUAL_UINT(0, tl_table_encode(&table, blob, at + 79));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(golden, sizeof golden, 2, &read));
    TEST_ASSERT_EQUAL_UINT8(0, read.plays); // of the table before nothing stays
}

// A blob of sections: `tail` bytes after the nodes, with sizes and CRC as they belong.
static tl_table_reason_t decode_tail(const uint8_t *tail, size_t size) {
    const size_t at = sizeof golden - 4, whole = at + size + 4;
    memcpy(blob, golden, at);
    memmove(blob + at, tail, size);
    blob[4] = 2;
    blob[6] = (uint8_t)whole;
    blob[7] = (uint8_t)(whole >> 8);
    const uint32_t crc = tl_crc32(0, blob, whole - 4);
    for (unsigned i = 0; i < 4; i++) {
        blob[whole - 4 + i] = (uint8_t)(crc >> 8 * i);
    }
    return tl_table_decode(blob, whole, TL_TABLE_ANY_AXIS, &read);
}

static void test_sections_that_are_none_are_refused(void) {
    const tl_table_t table = several();
    uint8_t tail[160];
    tl_table_encode(&table, blob, sizeof blob);
    memcpy(tail, blob + sizeof golden - 4, 76);
    memcpy(tail + 76, tail, 76);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, decode_tail(tail, 76));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, decode_tail(tail, 0));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, 152)); // twice
    for (uint32_t number = 10; number < 65536U; number++) {              // with what is right for plays
        tail[0] = (uint8_t)number;
        tail[1] = (uint8_t)(number >> 8);
        TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, 76));
    }
    tail[1] = 0;
    tail[0] = 1;
    for (size_t size = 1; size < 76; size++) {
        TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, size)); // cut off
    }
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, 77));
    tail[0] = 2; // unknown
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, 76));
    tail[0] = 1;
    tail[2] = 0x44; // of another size
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_SECTION, decode_tail(tail, 72));
    tail[2] = 0x48;
    static const struct {
        unsigned at;
        uint8_t value;
        tl_table_reason_t reason;
    } bad[] = {{4, 1, TL_TABLE_BAD_PLAYS},     {4, 8, TL_TABLE_BAD_PLAYS},     {6, 1, TL_TABLE_BAD_RESERVED},
               {7, 1, TL_TABLE_BAD_RESERVED},  {30, 1, TL_TABLE_BAD_RESERVED}, {67, 1, TL_TABLE_BAD_RESERVED},
               {16, 1, TL_TABLE_BAD_PLAYS},    {5, 27, TL_TABLE_BAD_WARP},     {5, 7, TL_TABLE_BAD_WARP},
               {11, 0x80, TL_TABLE_BAD_PLAYS}, {71, 0x7F, TL_TABLE_BAD_WARP},  {71, 0x01, TL_TABLE_BAD_WARP}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const uint8_t was = tail[bad[i].at];
        tail[bad[i].at] = bad[i].value;
        TEST_ASSERT_EQUAL_INT_MESSAGE(bad[i].reason, decode_tail(tail, 76), "changed byte");
        tail[bad[i].at] = was;
    }
}

#define REFUSED_PLAYS(reason, change)                                                                                  \
    do {                                                                                                               \
        tl_table_t t = several();                                                                                      \
        change;                                                                                                        \
        TEST_ASSERT_EQUAL_INT_MESSAGE(TL_TABLE_##reason, tl_table_check(&t, TL_TABLE_ANY_AXIS), #change);              \
    } while (0)

static void test_unfit_elements_are_refused(void) {
    REFUSED_PLAYS(OK, (void)t);
    REFUSED_PLAYS(BAD_PLAYS, t.play_width_q28[1] = t.play_width_q28[0]);
    REFUSED_PLAYS(BAD_PLAYS, t.play_width_q28[0] = 0);                                     // another B
    REFUSED_PLAYS(BAD_PLAYS, (t.play_weight_q16[0] = 3276, t.play_weight_q16[1] = 62260)); // below 0.05
    REFUSED_PLAYS(BAD_PLAYS, t.play_weight_q16[1]++);
    REFUSED_PLAYS(BAD_PLAYS, t.narrow = -1);
    REFUSED_PLAYS(BAD_WARP, t.centre[1] = t.centre[0]);
    REFUSED_PLAYS(OK, t.centre[1] = TL_TABLE_CENTRE_MAX);
    REFUSED_PLAYS(BAD_WARP, t.centre[1] = TL_TABLE_CENTRE_MAX + 1);
    REFUSED_PLAYS(BAD_RESERVED, (t.nodes = 0, t.q0 = 0, t.step_log2 = 0)); // nothing to share
}

// Content -----------------------------------------------------------------------------------------

#define REFUSED(reason, change)                                                                                        \
    do {                                                                                                               \
        tl_table_t t = table_fixture(1);                                                                               \
        change;                                                                                                        \
        TEST_ASSERT_EQUAL_INT_MESSAGE(TL_TABLE_##reason, tl_table_check(&t, TL_TABLE_ANY_AXIS), #change);              \
    } while (0)

static void test_unfit_content_is_refused_with_its_reason(void) {
    REFUSED(OK, (void)t);
    REFUSED(BAD_AXIS, t.axis = 4);
    REFUSED(BAD_KIND, t.kind = 3);
    REFUSED(BAD_UNIT, t.unit = 2);
    REFUSED(BAD_SCALE, t.nano_units_per_count = 0);
    REFUSED(BAD_NODES, t.nodes = 1);
    REFUSED(BAD_NODES, t.nodes = 258);
    REFUSED(BAD_STEP, t.step_log2 = 24);
    REFUSED(BAD_RANGE, t.q_min = t.q_max);
    REFUSED(BAD_RANGE, t.q_min = t.q_max + 1);
    REFUSED(BAD_RANGE, t.q_min = t.q0 - 1);
    REFUSED(BAD_RANGE, t.q_max = t.q0 + (157 << 14) + 1);
    REFUSED(OK, t.q_max = t.q0 + (157 << 14));
    REFUSED(BAD_STRENGTH, t.strength_q15 = 32769);
    REFUSED(OK, t.strength_q15 = 0);
    REFUSED(BAD_LIMITS, t.speed_max_q8 = 0);
    REFUSED(BAD_LIMITS, t.takeup_speed_q8 = 0);
    REFUSED(BAD_LIMITS, t.takeup_accel = -1);
    REFUSED(BAD_LIMITS, t.band = -1);
    REFUSED(OK, t.band = 0);
    REFUSED(BAD_LIMITS, t.slope_min_q28 = INT32_MIN);
    REFUSED(BAD_LIMITS, t.flat_speed_q8 = TL_TABLE_VALUE_MAX + 1);
    REFUSED(BAD_DELAY, t.delay_us = TL_TABLE_DELAY_MAX_US + 1);
    REFUSED(OK, t.delay_us = TL_TABLE_DELAY_MAX_US);
    REFUSED(BAD_COARSE, t.coarse_c_max = t.coarse_c_min);
    REFUSED(BAD_SIDES,
            (t.has = TL_TABLE_HAS_sides, t.sides.side = 1, t.sides.late[0] = 3680, t.sides.late[1] = INT32_MIN));
    REFUSED(BAD_COARSE, (t.coarse_c_min = 1, t.coarse_c_max = 0)); // falls where f rises
    REFUSED(BAD_RESERVED, (t.nodes = 0, t.step_log2 = 0));
    REFUSED(BAD_RESERVED, (t.nodes = 0, t.q0 = 0));
    REFUSED(OK, (t.nodes = 0, t.q0 = 0, t.step_log2 = 0));
}

static void test_unfit_functions_are_refused_with_their_reason(void) {
    const int32_t steep = 2 << 14; // |dB| of a span with |B'| = 2
    REFUSED(BAD_WIDTH_NEGATIVE, t.width[157] = -1);
    REFUSED(OK, t.width[157] = 0 * t.width[156] + t.width[156] - steep + 1);
    REFUSED(BAD_WIDTH_STEEP, t.width[157] = t.width[156] - steep);
    REFUSED(OK, t.width[157] = t.width[156] + steep - 1);
    REFUSED(BAD_WIDTH_STEEP, t.width[157] = t.width[156] + steep);
    REFUSED(BAD_WIDTH_STEEP, t.width[0] = t.width[1] + steep);
    REFUSED(BAD_NOT_MONOTONE, t.angle[1] = t.angle[0]);
    REFUSED(BAD_NOT_MONOTONE, t.angle[157] = t.angle[156]);
    REFUSED(BAD_NOT_MONOTONE, t.angle[80] = t.angle[79] - 1);
    REFUSED(BAD_NOT_MONOTONE, t.angle[0] = t.angle[1] + 1);
}

static void all_widths(tl_table_t *t, int32_t width) {
    for (unsigned i = 0; i < t->nodes; i++) {
        t->width[i] = width;
    }
}

static void test_what_is_too_large_is_refused(void) {
    REFUSED(BAD_SATURATES, t.angle[157] = TL_TABLE_VALUE_MAX + 1);
    REFUSED(OK, t.angle[157] = TL_TABLE_VALUE_MAX);
    REFUSED(BAD_SATURATES, t.angle[0] = INT32_MIN);
    REFUSED(BAD_SATURATES, t.coarse_c_min = INT32_MIN);
    REFUSED(BAD_SATURATES, t.q0 = INT32_MIN);
    REFUSED(BAD_SATURATES, t.q_min = -TL_TABLE_POSITION_MAX - 1);
    REFUSED(BAD_SATURATES, t.q_max = TL_TABLE_POSITION_MAX + 1);
    REFUSED(BAD_SATURATES, (t.nodes = 0, t.q0 = 0, t.step_log2 = 0, t.q_max = TL_TABLE_POSITION_MAX + 1));
    REFUSED(OK, (t.nodes = 0, t.q0 = 0, t.step_log2 = 0, t.q_max = TL_TABLE_POSITION_MAX));
    // the grid's ends, exactly at the bound and one beyond
    REFUSED(OK, (t.q0 = t.q_min = -TL_TABLE_POSITION_MAX, t.q_max = t.q0 + 1));
    REFUSED(OK, (t.q0 = TL_TABLE_POSITION_MAX - (157 << 14), t.q_min = t.q0, t.q_max = t.q0 + 1));
    REFUSED(BAD_SATURATES, (t.q0 = TL_TABLE_POSITION_MAX - (157 << 14) + 1, t.q_min = t.q0, t.q_max = t.q0 + 1));
    // a grid that would leave 32 bits
    REFUSED(BAD_SATURATES, (t.step_log2 = 23));
    for (unsigned i = 0; i < 158U; i++) {
        REFUSED(BAD_SATURATES, t.width[i] = INT32_MAX);
    }
    REFUSED(OK, all_widths(&t, TL_TABLE_WIDTH_MAX));
    REFUSED(BAD_SATURATES, all_widths(&t, TL_TABLE_WIDTH_MAX + 1));
}

// A motor with an encoder of a million counts a turn, that turns once to either side: B is 9 deg.
static void test_a_range_of_a_million_counts_is_taken(void) {
    REFUSED(OK, (t.step_log2 = 22, t.q0 = t.q_min = -1000000 * TL_COUNT_ONE, t.q_max = 1000000 * TL_COUNT_ONE,
                 all_widths(&t, 25000 * TL_COUNT_ONE)));
}

static void test_flat_spans_are_refused_or_crossed(void) {
    // 64 counts a span: a rise of 64 is 1 last bit of c a count, 2^-16 deg/count, 4096 in Q28
    REFUSED(OK, (t.angle[157] = t.angle[156] + 64, t.slope_min_q28 = 4096));
    REFUSED(BAD_FLAT, (t.angle[157] = t.angle[156] + 63, t.slope_min_q28 = 4096));
    REFUSED(BAD_FLAT, (t.angle[157] = t.angle[156] + 64, t.slope_min_q28 = 4097));
    REFUSED(OK, (t.angle[157] = t.angle[156] + 63, t.slope_min_q28 = 4096, t.flat_speed_q8 = 1));
}

static void test_a_falling_f_is_as_good_as_a_rising_one(void) {
    tl_table_t t = table_fixture(-1);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_check(&t, 0));
    t.angle[100] = t.angle[99];
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_NOT_MONOTONE, tl_table_check(&t, 0));
}

static void test_a_table_for_another_axis_is_refused(void) {
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(golden, sizeof golden, 2, &read));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_AXIS, tl_table_decode(golden, sizeof golden, 0, &read));
}

static void test_every_reason_has_a_text(void) {
    for (int i = 0; i < TL_TABLE_REASON_COUNT; i++) {
        TEST_ASSERT_GREATER_THAN(4, strlen(tl_table_reason_text((tl_table_reason_t)i)));
        for (int j = 0; j < i; j++) {
            TEST_ASSERT_NOT_EQUAL(
                0, strcmp(tl_table_reason_text((tl_table_reason_t)i), tl_table_reason_text((tl_table_reason_t)j)));
        }
    }
    TEST_ASSERT_EQUAL_STRING("unknown reason", tl_table_reason_text(TL_TABLE_REASON_COUNT));
    TEST_ASSERT_EQUAL_STRING("unknown reason", tl_table_reason_text((tl_table_reason_t)-1));
}

// Content at random behind a right CRC: whatever passes must be safe to load and to use.
static void test_random_content_never_does_harm(void) {
    static tl_lookup_t lookup;
    uint32_t seed = 12345, accepted = 0;
    for (int round = 0; round < 20000; round++) {
        tl_table_t t = table_fixture(round & 1 ? 1 : -1);
        t.nodes = (uint16_t)(2 + round % 40);
        t.q_max = t.q0 + 1;
        for (int i = 0; i < 1 + round % 3; i++) {
            seed = seed * 1664525U + 1013904223U;
            const size_t at = (seed >> 8) % (TL_TABLE_HEADER_SIZE + 8U * t.nodes - 8U) + 8U;
            const size_t size = tl_table_encode(&t, blob, sizeof blob);
            seed = seed * 1664525U + 1013904223U;
            blob[at] = (uint8_t)(seed >> 16);
            const uint32_t crc = tl_crc32(0, blob, size - 4);
            for (unsigned k = 0; k < 4; k++) {
                blob[size - 4 + k] = (uint8_t)(crc >> 8 * k);
            }
            if (tl_lookup_load(&lookup, blob, size, TL_TABLE_ANY_AXIS) != TL_TABLE_OK) {
                continue;
            }
            accepted++;
            t = lookup.table;
            static const int32_t corners[] = {INT32_MIN, -TL_TABLE_VALUE_MAX, -1, 0, 1, TL_TABLE_VALUE_MAX, INT32_MAX};
            for (unsigned k = 0; k < sizeof corners / sizeof corners[0]; k++) {
                uint32_t flags = 0;
                (void)tl_lookup_width(&lookup, corners[k], &flags);
                (void)tl_lookup_angle(&lookup, corners[k], &flags);
                (void)tl_lookup_angle_inverse(&lookup, corners[k], &flags);
                (void)tl_lookup_p_low(&lookup, corners[k], corners[k], &flags);
                (void)tl_lookup_p_high(&lookup, corners[k], corners[6 - k], &flags);
                (void)tl_lookup_coarse(&lookup, corners[k], &flags);
                (void)tl_lookup_coarse_inverse(&lookup, corners[k], &flags);
            }
        }
    }
    TEST_ASSERT_GREATER_THAN(1000, accepted);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_bytes_are_the_documented_ones);
    RUN_TEST(test_the_documented_bytes_are_read);
    RUN_TEST(test_a_blob_is_read_at_any_alignment);
    RUN_TEST(test_the_largest_table_fits_a_flash_sector);
    RUN_TEST(test_damaged_blobs_are_refused_with_their_reason);
    RUN_TEST(test_any_flipped_bit_is_refused);
    RUN_TEST(test_a_section_follows_the_nodes);
    RUN_TEST(test_sections_that_are_none_are_refused);
    RUN_TEST(test_unfit_elements_are_refused);
    RUN_TEST(test_unfit_content_is_refused_with_its_reason);
    RUN_TEST(test_unfit_functions_are_refused_with_their_reason);
    RUN_TEST(test_what_is_too_large_is_refused);
    RUN_TEST(test_a_range_of_a_million_counts_is_taken);
    RUN_TEST(test_flat_spans_are_refused_or_crossed);
    RUN_TEST(test_a_falling_f_is_as_good_as_a_rising_one);
    RUN_TEST(test_a_table_for_another_axis_is_refused);
    RUN_TEST(test_every_reason_has_a_text);
    RUN_TEST(test_random_content_never_does_harm);
    return UNITY_END();
}
