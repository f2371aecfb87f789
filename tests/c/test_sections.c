// What each section of a table may say: its extremes are taken, one beyond is refused with the section's reason.
#include "table_fixture.h"

#include <unity.h>

void setUp(void) {}
void tearDown(void) {}

// All sections, each saying nothing: an encoder without error, sides alike, no load.
static tl_table_t silent(void) {
    tl_table_t t = table_fixture(1);
#define HAS(number, name, FIELDS) t.has |= TL_TABLE_HAS_##name;
    TL_TABLE_SECTIONS(HAS)
#undef HAS
    t.encoder.period_q12 = 1 << 28;
    t.sides.side = 1;
    t.adapt.width_least_q15 = t.adapt.width_most_q15 = TL_RATIO_ONE;
    t.anew.rest_us = 50000;
    t.pressed.mean = 100 * TL_COUNT_ONE;
    return t;
}

#define IS(reason, change)                                                                                             \
    do {                                                                                                               \
        tl_table_t t = silent();                                                                                       \
        change;                                                                                                        \
        TEST_ASSERT_EQUAL_INT_MESSAGE(TL_TABLE_##reason, tl_table_check(&t, TL_TABLE_ANY_AXIS), #change);              \
    } while (0)

// From `low` to `high`, both taken.
#define WITHIN(reason, field, low, high)                                                                               \
    do {                                                                                                               \
        IS(OK, t.field = (low));                                                                                       \
        IS(OK, t.field = (high));                                                                                      \
        IS(reason, t.field = (low) - 1);                                                                               \
        IS(reason, t.field = (high) + 1);                                                                              \
    } while (0)

enum { PLACE = 1 << 24, GAIN = (1 << 26) - 1 };

static void test_sections_that_say_nothing_are_taken(void) {
    IS(OK, (void)t);
}

static void test_an_encoder_s_error_has_a_size_and_a_slope(void) {
    IS(OK, t.encoder.period_q12 = 1 << 12);
    IS(BAD_ENCODER, t.encoder.period_q12 = (1 << 12) - 1);
    IS(BAD_ENCODER, t.encoder.period_q12 = -1);
    WITHIN(BAD_ENCODER, encoder.sine, 1 - TL_TABLE_ENCODER_MAX, TL_TABLE_ENCODER_MAX - 1);
    WITHIN(BAD_ENCODER, encoder.cosine, 1 - TL_TABLE_ENCODER_MAX, TL_TABLE_ENCODER_MAX - 1);
    // The second harmonic has twice the slope.
    WITHIN(BAD_ENCODER, encoder.sine2, 1 - TL_TABLE_ENCODER_MAX / 2, TL_TABLE_ENCODER_MAX / 2 - 1);
    WITHIN(BAD_ENCODER, encoder.cosine2, 1 - TL_TABLE_ENCODER_MAX / 2, TL_TABLE_ENCODER_MAX / 2 - 1);
    const int32_t half = TL_TABLE_ENCODER_MAX / 2;
    IS(OK, (t.encoder.sine = half, t.encoder.cosine = 1 - half));
    IS(BAD_ENCODER, (t.encoder.sine = half, t.encoder.cosine = -half));
    IS(OK, (t.encoder.sine = half, t.encoder.sine2 = half / 2 - 1));
    IS(BAD_ENCODER, (t.encoder.sine = half, t.encoder.cosine2 = -half / 2));
    // At most 1/2: 2 pi A / period, A in Q8 and the period in Q12, so 16 * 4 pi A = 201.06 A; the firmware takes 202.
    IS(BAD_ENCODER, (t.encoder.sine = 10000, t.encoder.period_q12 = 2010619));
    IS(OK, (t.encoder.sine = 10000, t.encoder.period_q12 = 2020000));
}

static void test_what_a_side_adds_falls_by_no_more_than_the_travel(void) {
    static const int32_t travel[TL_TABLE_LAST + 1U] = {0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256};
    IS(OK, t.sides.side = -1);
    IS(BAD_SIDES, t.sides.side = 0);
    IS(BAD_SIDES, t.sides.side = 2);
    WITHIN(BAD_SIDES, sides.step_log2, 0, 22);
    for (unsigned from = 1; from <= TL_TABLE_LAST; from++) {
        for (int32_t log2 = 0; log2 <= 8; log2 += 4) {
            const int32_t step = (travel[from] - travel[from - 1U]) * (1 << log2);
            for (int32_t more = -1; more <= 1; more++) { // up to this node all of the step, then nothing
                tl_table_t t = silent();
                t.sides.step_log2 = log2;
                for (unsigned i = 0; i < from; i++) {
                    t.sides.late[i] = step + more;
                }
                TEST_ASSERT_EQUAL_INT(more > 0 ? TL_TABLE_BAD_SIDES : TL_TABLE_OK, tl_table_check(&t, 0));
            }
        }
    }
    IS(BAD_SIDES, t.sides.late[1] = 1);             // it rises
    IS(BAD_SIDES, t.sides.late[TL_TABLE_LAST] = 1); // at the end, too
    IS(BAD_SIDES, t.sides.late[TL_TABLE_LAST] = -1);
    for (int32_t more = 0; more <= 1; more++) {
        tl_table_t t = silent();
        t.sides.step_log2 = 22;
        for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
            t.sides.late[i] = PLACE;
        }
        t.sides.late[0] += more;
        TEST_ASSERT_EQUAL_INT(more > 0 ? TL_TABLE_BAD_SIDES : TL_TABLE_OK, tl_table_check(&t, 0));
    }
}

static void test_sides_begin_anew_after_a_rest_of_some_length_where_there_are_any(void) {
    WITHIN(BAD_ANEW, anew.rest_us, 1, 10000000);
    IS(BAD_ANEW, t.has &= ~(uint32_t)TL_TABLE_HAS_sides);
    IS(OK, t.has &= ~(uint32_t)(TL_TABLE_HAS_sides | TL_TABLE_HAS_anew));
}

// B is 100 counts everywhere, or `rises` more from one node on; the grid's step is 64 counts.
static tl_table_t pressed(int32_t sides_q16, int32_t speed_q16, int32_t late, int32_t extra, int32_t rises) {
    tl_table_t t = silent();
    for (unsigned i = 0; i < t.nodes; i++) {
        t.width[i] = 100 * TL_COUNT_ONE + (i > t.nodes / 2U ? rises : 0);
    }
    t.sides.step_log2 = 22;
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        t.sides.late[i] = late;
    }
    t.speed.extra[7] = extra; // the largest, wherever it is
    t.pressed.sides_q16 = sides_q16;
    t.pressed.speed_q16 = speed_q16;
    return t;
}

#define PRESSED_IS(reason, ...)                                                                                        \
    do {                                                                                                               \
        const tl_table_t t = pressed(__VA_ARGS__);                                                                     \
        TEST_ASSERT_EQUAL_INT_MESSAGE(TL_TABLE_##reason, tl_table_check(&t, TL_TABLE_ANY_AXIS), #__VA_ARGS__);         \
    } while (0)

static void test_what_is_pressed_is_a_share_of_what_the_table_adds(void) {
    WITHIN(BAD_PRESSED, pressed.sides_q16, 0, 2 << 16);
    WITHIN(BAD_PRESSED, pressed.speed_q16, 0, 2 << 16);
    IS(OK, (t.has &= ~(uint32_t)(TL_TABLE_HAS_sides | TL_TABLE_HAS_anew), t.pressed.speed_q16 = 1));
    IS(BAD_PRESSED, (t.has &= ~(uint32_t)(TL_TABLE_HAS_sides | TL_TABLE_HAS_anew), t.pressed.sides_q16 = 1));
    IS(OK, (t.has &= ~(uint32_t)TL_TABLE_HAS_speed, t.pressed.sides_q16 = 1));
    IS(BAD_PRESSED, (t.has &= ~(uint32_t)TL_TABLE_HAS_speed, t.pressed.speed_q16 = 1));
    IS(BAD_PRESSED, t.pressed.mean = 0);
    IS(OK, t.pressed.mean = TL_TABLE_WIDTH_MAX);
    IS(BAD_PRESSED, t.pressed.mean = TL_TABLE_WIDTH_MAX + 1);
}

static void test_what_is_pressed_is_nowhere_too_large(void) {
    for (int32_t more = 0; more <= 1; more++) { // eight times the mean, where nothing else is too much
        tl_table_t t = pressed(0, 0, 0, 0, 0);
        t.pressed.mean = t.width[3] / TL_TABLE_WIDE_MAX;
        t.width[3] += more;
        TEST_ASSERT_EQUAL_INT(more > 0 ? TL_TABLE_BAD_PRESSED : TL_TABLE_OK, tl_table_check(&t, 0));
    }
    PRESSED_IS(OK, 2 << 16, 2 << 16, PLACE, PLACE, 0); // at the mean all of it
    PRESSED_IS(BAD_PRESSED, 1, 0, PLACE, PLACE, 1);    // and nowhere more, however little
    PRESSED_IS(BAD_PRESSED, 0, 1, PLACE, PLACE, 1);
    PRESSED_IS(OK, 1, 1, PLACE, PLACE, -1);
    // A quarter more of B is half more by a share of 2, a quarter more by one of 1.
    const int32_t most_2 = PLACE / 3 * 2, most_1 = PLACE / 5 * 4;
    tl_table_t t = pressed(2 << 16, 0, most_2, PLACE, 0);
    for (unsigned i = 0; i < t.nodes; i++) {
        t.width[i] = 125 * TL_COUNT_ONE;
    }
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_check(&t, 0));
    t.sides.late[0]++;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_PRESSED, tl_table_check(&t, 0));
    t.sides.late[0] = most_2;
    t.pressed.speed_q16 = 1 << 16;
    t.speed.extra[7] = most_1;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_check(&t, 0));
    t.speed.extra[7] = most_1 + 1;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_PRESSED, tl_table_check(&t, 0));
}

// B' may be less than 2 (the step is 16384), with what it brings along: by 100 counts of B, twice 40 late and 20 extra.
static void test_what_is_pressed_leaves_a_motion(void) {
    const int32_t late = 40 * TL_COUNT_ONE, extra = 20 * TL_COUNT_ONE;
    PRESSED_IS(OK, 0, 0, late, extra, 32767);
    PRESSED_IS(BAD_WIDTH_STEEP, 0, 0, late, extra, 32768);
    PRESSED_IS(OK, 1 << 16, 0, late, extra, 32768 * 10 / 18);
    PRESSED_IS(BAD_PRESSED, 1 << 16, 0, late, extra, 32768 * 10 / 18 + 1);
    PRESSED_IS(OK, 0, 1 << 16, late, extra, 32768 * 10 / 12);
    PRESSED_IS(BAD_PRESSED, 0, 1 << 16, late, extra, 32768 * 10 / 12 + 1);
    PRESSED_IS(OK, 2 << 16, 1 << 16, late, extra, 32768 * 10 / 28);
    PRESSED_IS(BAD_PRESSED, 2 << 16, 1 << 16, late, extra, 32768 * 10 / 28 + 1);
    PRESSED_IS(OK, 2 << 16, 1 << 16, late, extra, -32768 * 10 / 28);
    PRESSED_IS(BAD_PRESSED, 2 << 16, 1 << 16, late, extra, -32768 * 10 / 28 - 1);
}

static void test_what_moves_the_motor_is_another_axis_and_moves_nothing_else(void) {
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        IS(OK, (t.joints.axis[i] = 3, t.before.slope_q20[i] = GAIN));
        IS(OK, (t.joints.axis[i] = 3, t.before.slope_q20[i] = -GAIN));
        IS(BAD_BEFORE, (t.joints.axis[i] = 3, t.before.slope_q20[i] = GAIN + 1));
        IS(BAD_BEFORE, (t.joints.axis[i] = 3, t.before.slope_q20[i] = -GAIN - 1));
        IS(BAD_BEFORE, t.before.slope_q20[i] = 1);
        IS(BAD_BEFORE, (t.joints.axis[i] = 3, t.joints.slope[i] = 1, t.before.slope_q20[i] = 1));
    }
    IS(BAD_BEFORE, t.has &= ~(uint32_t)TL_TABLE_HAS_joints);
    IS(OK, t.has &= ~(uint32_t)(TL_TABLE_HAS_joints | TL_TABLE_HAS_before));
}

static void test_ranges_of_speed_and_of_lag(void) {
    WITHIN(BAD_SPEED, speed.step_log2, 0, 22);
    WITHIN(BAD_SPEED, speed.time_us, 0, 10000000);
    WITHIN(BAD_SPEED, speed.held, 0, 1);
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        WITHIN(BAD_SPEED, speed.extra[i], 0, PLACE);
    }
    for (unsigned i = 0; i < TL_TABLE_LATE_MAX; i++) {
        WITHIN(BAD_LATE, late.time_us[i], 1000, 1000000000);
        IS(BAD_LATE, t.late.gain_q16[i] = 1); // without a time
        IS(OK, (t.late.time_us[i] = 1000, t.late.gain_q16[i] = GAIN));
        IS(OK, (t.late.time_us[i] = 1000, t.late.gain_q16[i] = -GAIN));
        IS(BAD_LATE, (t.late.time_us[i] = 1000, t.late.gain_q16[i] = GAIN + 1));
        IS(BAD_LATE, (t.late.time_us[i] = 1000, t.late.gain_q16[i] = -GAIN - 1));
    }
}

static void test_ranges_of_load_joints_and_what_may_change(void) {
    WITHIN(BAD_LOAD, load.reference, -PLACE, PLACE);
    WITHIN(BAD_LOAD, load.width, -PLACE, PLACE);
    WITHIN(BAD_LOAD, load.gain, -PLACE, PLACE);
    WITHIN(BAD_LOAD, load.offset, -PLACE, PLACE);
    WITHIN(BAD_LOAD, load.middle, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        WITHIN(BAD_JOINTS, joints.play[i], 0, PLACE);
        WITHIN(BAD_JOINTS, joints.slope[i], -GAIN, GAIN);
        WITHIN(BAD_JOINTS, joints.axis[i], 0, (int32_t)TL_TABLE_AXES);
        for (int32_t axis = 0; axis < (int32_t)TL_TABLE_AXES; axis++) { // not by itself
            IS(BAD_JOINTS, (t.axis = (uint8_t)axis, t.joints.axis[i] = axis + 1));
        }
    }
    WITHIN(BAD_ADAPT, adapt.offset, 0, TL_TABLE_ADAPT_OFFSET_MAX);
    WITHIN(BAD_ADAPT, adapt.width_least_q15, 0, TL_RATIO_ONE);
    WITHIN(BAD_ADAPT, adapt.width_most_q15, TL_RATIO_ONE, 2 * TL_RATIO_ONE);
}

#define PLAYS_ARE(reason, change)                                                                                      \
    do {                                                                                                               \
        tl_table_t t = table_fixture_several(1);                                                                       \
        change;                                                                                                        \
        TEST_ASSERT_EQUAL_INT_MESSAGE(TL_TABLE_##reason, tl_table_check(&t, TL_TABLE_ANY_AXIS), #change);              \
    } while (0)

static void test_ranges_of_elements(void) {
    PLAYS_ARE(OK, (void)t);
    PLAYS_ARE(OK, t.narrow = TL_TABLE_WIDTH_MAX);
    PLAYS_ARE(BAD_PLAYS, t.narrow = TL_TABLE_WIDTH_MAX + 1);
    PLAYS_ARE(BAD_PLAYS, t.plays = 1);
    PLAYS_ARE(BAD_PLAYS, t.plays = TL_TABLE_PLAYS_MAX + 1U);
    PLAYS_ARE(BAD_WARP, t.period_log2 = 7);
    PLAYS_ARE(BAD_WARP, t.period_log2 = 27);
    PLAYS_ARE(OK, t.period_log2 = 26);
    PLAYS_ARE(OK, t.period_log2 = 8);
    // What the shares sum up to, B itself, may be wrong by 2^-16: 2^28 of 2^44
    PLAYS_ARE(OK, t.play_width_q28[1] += 8192U);
    PLAYS_ARE(BAD_PLAYS, t.play_width_q28[1] += 8193U);
    PLAYS_ARE(OK, t.play_width_q28[1] -= 8192U);
    PLAYS_ARE(BAD_PLAYS, t.play_width_q28[1] -= 8193U);
    PLAYS_ARE(BAD_PLAYS, (t.play_width_q28[0] = t.play_width_q28[1] = 1U << 28)); // they rise
    // Half of the widest is below 2^26 of Y's unit.
    PLAYS_ARE(OK, (t.period_log2 = 26, t.play_width_q28[0] = 1, t.play_width_q28[1] = (1U << 29) - 1U));
    PLAYS_ARE(BAD_WARP, (t.period_log2 = 26, t.play_width_q28[0] = 0, t.play_width_q28[1] = 1U << 29));
    PLAYS_ARE(BAD_WARP, t.centre[0] = -TL_TABLE_CENTRE_MAX - 1);
    PLAYS_ARE(OK, t.centre[0] = -TL_TABLE_CENTRE_MAX);
    PLAYS_ARE(BAD_WARP, t.centre[80] = t.centre[79]);
    PLAYS_ARE(OK, t.centre[80] = t.centre[79] + 1);
}

static void test_three_elements_share_all_and_each_has_a_part(void) {
    static const struct {
        uint32_t weight[3], width[3]; // quarters of B
        tl_table_reason_t reason;
    } of[] = {{{32768, 16384, 16384}, {2, 5, 7}, TL_TABLE_OK},
              {{32768, 16384, 16383}, {2, 5, 7}, TL_TABLE_BAD_PLAYS},
              {{32768, 16384, 16385}, {2, 5, 7}, TL_TABLE_BAD_PLAYS},
              {{32768, 0, 32768}, {2, 4, 6}, TL_TABLE_BAD_PLAYS},
              {{32768, 32768, 0}, {2, 6, 7}, TL_TABLE_BAD_PLAYS}};
    for (unsigned i = 0; i < sizeof of / sizeof of[0]; i++) {
        tl_table_t t = table_fixture_several(1);
        t.plays = 3;
        for (unsigned k = 0; k < 3U; k++) {
            t.play_weight_q16[k] = of[i].weight[k];
            t.play_width_q28[k] = of[i].width[k] << 26;
        }
        TEST_ASSERT_EQUAL_INT(of[i].reason, tl_table_check(&t, TL_TABLE_ANY_AXIS));
    }
}

static void test_an_instrument_s_serial_is_printable_and_then_zeros(void) {
    static const struct {
        char text[9];
        tl_table_reason_t reason;
    } serials[] = {{" ~0aZ ~!", TL_TABLE_OK}, // the ends of what can be printed, and no room for a zero
                   {"A", TL_TABLE_OK},
                   {"\x1F", TL_TABLE_BAD_RESERVED},
                   {"\x7F", TL_TABLE_BAD_RESERVED},
                   {"A\0\0\0\0\0\0B", TL_TABLE_BAD_RESERVED}};
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    static tl_table_t read;
    for (unsigned i = 0; i < sizeof serials / sizeof serials[0]; i++) {
        tl_table_t t = table_fixture(1);
        memcpy(t.instrument, serials[i].text, sizeof t.instrument);
        const size_t size = tl_table_encode(&t, blob, sizeof blob);
        TEST_ASSERT_EQUAL_INT(serials[i].reason, tl_table_decode(blob, size, 0, &read));
    }
}

// The second of two shares so that both sum up to 1: w0 s0 + w1 s1 = 1, here s0 = 0.
static void test_the_first_element_has_a_twentieth_of_the_motion(void) {
    for (uint32_t weight = 3276; weight <= 3277; weight++) { // 0.05 is 3276.8
        tl_table_t t = table_fixture_several(1);
        t.play_weight_q16[0] = weight;
        t.play_weight_q16[1] = 65536U - weight;
        t.play_width_q28[0] = 0;
        t.play_width_q28[1] = (uint32_t)(((uint64_t)1 << 44) / (65536U - weight));
        TEST_ASSERT_EQUAL_INT(weight < 3277 ? TL_TABLE_BAD_PLAYS : TL_TABLE_OK, tl_table_check(&t, 0));
    }
}

static void test_every_word_of_every_section_survives_the_trip(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    static tl_table_t read;
    tl_table_t t = silent();
    t.encoder = (tl_table_encoder_t){1 << 28, 11, -12, 13, -14};
    t.sides = (tl_table_sides_t){-1, 5, {60, 59, 58, 57, 56, 55, 54, 53, 52, 51, 50, 49, 48, 47, 46, 45, 44}};
    t.speed = (tl_table_speed_t){6, 70000, 1, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17}};
    t.late = (tl_table_late_t){{21, -22, 23, -24}, {1021, 1022, 1023, 1024}};
    t.load = (tl_table_load_t){31, -32, 33, -34, 35};
    t.joints = (tl_table_joints_t){{2, 0, 4}, {41, 0, 43}, {-44, 0, 46}};
    t.adapt = (tl_table_adapt_t){51, 32000, 33000};
    t.anew = (tl_table_anew_t){61};
    t.pressed = (tl_table_pressed_t){71 * 256, 72, 73};
    t.before = (tl_table_before_t){{0, 0, -83}};
    t.joints.slope[2] = 0;
    const size_t size = tl_table_encode(&t, blob, sizeof blob);
    TEST_ASSERT_EQUAL_UINT(TL_TABLE_SIZE(t.nodes) + TL_TABLE_WORDS_SIZE, size);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_table_decode(blob, size, 0, &read));
    TEST_ASSERT_EQUAL_MEMORY(&t, &read, sizeof t);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_sections_that_say_nothing_are_taken);
    RUN_TEST(test_an_encoder_s_error_has_a_size_and_a_slope);
    RUN_TEST(test_what_a_side_adds_falls_by_no_more_than_the_travel);
    RUN_TEST(test_sides_begin_anew_after_a_rest_of_some_length_where_there_are_any);
    RUN_TEST(test_what_is_pressed_is_a_share_of_what_the_table_adds);
    RUN_TEST(test_what_is_pressed_is_nowhere_too_large);
    RUN_TEST(test_what_is_pressed_leaves_a_motion);
    RUN_TEST(test_what_moves_the_motor_is_another_axis_and_moves_nothing_else);
    RUN_TEST(test_ranges_of_speed_and_of_lag);
    RUN_TEST(test_ranges_of_load_joints_and_what_may_change);
    RUN_TEST(test_ranges_of_elements);
    RUN_TEST(test_three_elements_share_all_and_each_has_a_part);
    RUN_TEST(test_an_instrument_s_serial_is_printable_and_then_zeros);
    RUN_TEST(test_the_first_element_has_a_twentieth_of_the_motion);
    RUN_TEST(test_every_word_of_every_section_survives_the_trip);
    return UNITY_END();
}
