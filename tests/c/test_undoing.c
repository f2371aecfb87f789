// What a table undoes beside play and curve, each against its equation in float64.
#include "table_fixture.h"
#include "tautline/tl_undo.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define HZ 1000
#define PI 3.14159265358979323846

static tl_table_t table;
static tl_lookup_t lookup;
static tl_undo_t undo;

void setUp(void) {
    table = table_fixture(1);
    memset(&undo, 0, sizeof undo);
}
void tearDown(void) {}

static void begin(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    const size_t size = tl_table_encode(&table, blob, sizeof blob);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_load(&lookup, blob, size, TL_TABLE_ANY_AXIS));
    tl_undo_start(&undo, &lookup, HZ);
}

// Q8 counts by which the shaft is further than the encoder says, at x.
static double error_at(double x) {
    const double turn = 2.0 * PI * x * 16.0 / table.encoder.period_q12;
    return table.encoder.sine * sin(turn) + table.encoder.cosine * cos(turn) + table.encoder.sine2 * sin(2.0 * turn) +
           table.encoder.cosine2 * cos(2.0 * turn);
}

static void test_the_encoder_s_error_is_its_harmonics(void) {
    static const int32_t amplitudes[][4] = {
        {9000, 0, 0, 0}, {0, -9000, 0, 0}, {0, 0, 4000, 0}, {0, 0, 0, -4000}, {4000, -3000, 1500, 1000}};
    for (unsigned i = 0; i < sizeof amplitudes / sizeof amplitudes[0]; i++) {
        table.has = TL_TABLE_HAS_encoder;
        table.encoder =
            (tl_table_encoder_t){1200 << 12, amplitudes[i][0], amplitudes[i][1], amplitudes[i][2], amplitudes[i][3]};
        begin();
        for (tl_count_q8_t q = table.q_min; q <= table.q_max; q += 997) {
            const double told = q - tl_undo_reading(&undo, &lookup, q);
            // 9000 by a sine to 1.4e-4, which a product takes to 2^-13; the last bits of at most four
            TEST_ASSERT_DOUBLE_WITHIN(9000.0 * (1.4e-4 + 1.0 / 8192.0) * 2.0 + 4.0, error_at(q), told);
            // and back, as far as ten rounds of a slope of 1/2 or less lead
            const tl_count_q8_t reading = tl_undo_reading(&undo, &lookup, q);
            TEST_ASSERT_INT_WITHIN(10, q, tl_undo_pushing(&undo, &lookup, reading, TL_UNDO_ROUNDS));
        }
    }
}

static const int32_t nodes[TL_TABLE_LAST + 1U] = {0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256};

// A small table of `values` at x steps, straight between its nodes.
static double small(const int32_t *values, double x) {
    unsigned i = 0;
    while (i < TL_TABLE_LAST && nodes[i + 1U] <= x) {
        i++;
    }
    return i == TL_TABLE_LAST ? values[i]
                              : values[i] + (values[i + 1U] - values[i]) * (x - nodes[i]) / (nodes[i + 1U] - nodes[i]);
}

static void test_the_width_grows_with_the_speed(void) {
    table.has = TL_TABLE_HAS_speed;
    table.speed.step_log2 = 10;
    for (int32_t i = 0; i <= (int32_t)TL_TABLE_LAST; i++) {
        table.speed.extra[i] = i * i * 100;
    }
    begin();
    tl_count_q8_t p = 0;
    tl_undo_rest(&undo, p);
    for (int32_t by = -300; by <= 300; by++) { // Q8 counts in a millisecond; 262 and more are beyond the table
        p += by;
        tl_undo_tick(&undo, &lookup, p);
        tl_undo_weigh(&undo, &lookup, p);
        TEST_ASSERT_DOUBLE_WITHIN(1.0, small(table.speed.extra, abs(by) * HZ / 1024.0),
                                  tl_undo_wider(&undo, &lookup, p));
    }
}

static void test_the_speed_comes_through_a_filter_and_stays_where_it_is_held(void) {
    for (int32_t held = 0; held <= 1; held++) {
        setUp();
        table.has = TL_TABLE_HAS_speed;
        table.speed = (tl_table_speed_t){.step_log2 = 12, .time_us = 100000, .held = held};
        for (int32_t i = 0; i <= (int32_t)TL_TABLE_LAST; i++) {
            table.speed.extra[i] = nodes[i] * 16; // 1/256 of the speed
        }
        begin();
        tl_count_q8_t p = 0;
        tl_undo_rest(&undo, p);
        double filtered = 0.0;
        for (int32_t tick = 0; tick < 1000; tick++) {
            const int32_t by = tick < 400 ? 500 : 0;
            p += by;
            tl_undo_tick(&undo, &lookup, p);
            tl_undo_weigh(&undo, &lookup, p);
            if (by != 0 || held == 0) { // first order: exp(-1/100) stays of the rest with each tick
                filtered += (by * (double)HZ - filtered) * (1.0 - exp(-1.0 / 100.0));
            }
            // the share of a tick is kept to 2^-16 of it: 2e-3 of the rest at worst
            TEST_ASSERT_DOUBLE_WITHIN(2e-3 * 500.0 * HZ / 256.0, filtered / 256.0, tl_undo_wider(&undo, &lookup, p));
        }
    }
}

static void test_a_side_is_late_by_the_travel_since_its_turn(void) {
    for (int32_t side = -1; side <= 1; side += 2) {
        setUp();
        table.has = TL_TABLE_HAS_sides;
        table.sides.side = side;
        table.sides.step_log2 = 8;
        for (int32_t i = 0; i <= (int32_t)TL_TABLE_LAST; i++) {
            table.sides.late[i] = 20000 - nodes[i] * 70;
        }
        begin();
        const tl_count_q8_t turned = 12345;
        tl_undo_turned(&undo, turned, -side);
        TEST_ASSERT_EQUAL_INT32(0, tl_undo_wider(&undo, &lookup, turned));
        tl_undo_turned(&undo, turned, side);
        for (int32_t travel = 0; travel < 80000; travel += 37) { // the motor goes half of what the width grows by
            TEST_ASSERT_DOUBLE_WITHIN(2.0, 2.0 * small(table.sides.late, travel / 256.0),
                                      tl_undo_wider(&undo, &lookup, turned + side * travel));
        }
        TEST_ASSERT_EQUAL_INT32(2 * 20000, tl_undo_wider(&undo, &lookup, turned - side * 100));
    }
}

// A side that is late by L(x) = size exp(-x / travel), Q8 counts of the motor's way x, as section 3 has it.
static void be_late(double size, double travel) {
    table.sides.side = 1;
    table.sides.step_log2 = 12;
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        double low = 0.0, high = nodes[i] * 4096.0;
        for (unsigned k = 0; k < 60U; k++) { // d = x + L(0) - L(x)
            const double x = 0.5 * (low + high);
            *(x + size * (1.0 - exp(-x / travel)) < nodes[i] * 4096.0 ? &low : &high) = x;
        }
        table.sides.late[i] = (int32_t)lround(size * exp(-low / travel));
    }
}

// B goes up and down by `part` of its mean over 1600 counts.
static double width_at(double p, double mean, double part) {
    return mean * (1.0 + part * sin(2.0 * PI * p / (1600.0 * TL_COUNT_ONE)));
}

// The law: q = p + B(p) / 2 + w L(x), w = max(0, 1 + share (B / mean - 1)), where x is the motor's way and so q's; what
// is added for a speed goes with w, too.
static void test_what_is_pressed_is_late_by_the_law_wherever_it_turns(void) {
    const double mean = 200.0 * TL_COUNT_ONE, size = 60.0 * TL_COUNT_ONE, travel = 50.0 * TL_COUNT_ONE;
    static const double parts[] = {0.0, 0.5, -0.5, 0.9}, shares[] = {0.0, 0.5, 1.0, 2.0};
    for (unsigned i = 0; i < 16U; i++) {
        const double part = parts[i % 4U], share = shares[i / 4U];
        setUp();
        for (int32_t k = 0; k < table.nodes; k++) {
            table.width[k] = (int32_t)lround(width_at(table.q0 + k * (double)(1 << table.step_log2), mean, part));
        }
        table.has = TL_TABLE_HAS_sides | TL_TABLE_HAS_speed | TL_TABLE_HAS_pressed;
        table.speed = (tl_table_speed_t){.step_log2 = 22, .extra = {6000, 6000, 6000}};
        be_late(size, travel);
        table.pressed = (tl_table_pressed_t){(int32_t)mean, (int32_t)(share * 65536), (int32_t)(share * 65536)};
        begin();
        for (int32_t turn = -1000; turn <= 1000; turn += 125) {
            tl_count_q8_t p = turn * TL_COUNT_ONE;
            tl_undo_rest(&undo, p);
            tl_undo_tick(&undo, &lookup, p);
            tl_undo_weigh(&undo, &lookup, p);
            tl_undo_turned(&undo, p, 1);
            double x = 0.0, w = fmax(1.0 + share * (width_at(p, mean, part) / mean - 1.0), 0.0);
            for (int32_t tick = 0; tick < 600; tick++) { // by about a count
                const double b = width_at(p, mean, part), by = 200.0 + 100.0 * sin(tick * 0.02),
                             from = size * exp(-x / travel);
                p += (int32_t)by;
                const double b_now = width_at(p, mean, part), was = w;
                w = fmax(1.0 + share * (b_now / mean - 1.0), 0.0);
                double low = x, high = x + 100.0 * TL_COUNT_ONE; // q goes as far as x does
                for (unsigned k = 0; k < 50U; k++) {
                    const double to = 0.5 * (low + high);
                    const double q = (int32_t)by + 0.5 * (b_now - b) + w * size * exp(-to / travel) - was * from;
                    *(to - x < q ? &low : &high) = to;
                }
                x = low;
                tl_undo_weigh(&undo, &lookup, p);
                const double wider = 2.0 * w * size * exp(-x / travel) + 6000.0 * w;
                // nodes of late are joined by chords, 3.2 % of its size off at most; a tick late
                TEST_ASSERT_DOUBLE_WITHIN(0.035 * size * (1.0 + share * fabs(part)), wider,
                                          tl_undo_wider(&undo, &lookup, p));
                tl_undo_tick(&undo, &lookup, p);
            }
        }
    }
}

// The table's rest is 1 us to 10 s: the law's is over once more than that has passed without a tick that goes on.
static void test_a_side_begins_anew_after_a_rest_of_its_length_and_of_no_less(void) {
    static const struct {
        uint32_t hz;
        int32_t rest_us, ticks; // the least that are longer
    } of[] = {{1000, 50000, 51}, {1000, 50001, 51}, {1000, 49999, 50},     {1000, 1, 1},
              {16, 50000, 1},    {16, 62500, 2},    {100000, 50000, 5001}, {100000, 10000000, 1000001}};
    for (unsigned i = 0; i < sizeof of / sizeof of[0]; i++) {
        setUp();
        table.has = TL_TABLE_HAS_sides | TL_TABLE_HAS_anew;
        table.sides.side = 1;
        table.anew.rest_us = of[i].rest_us;
        begin();
        tl_undo_start(&undo, &lookup, of[i].hz);
        for (int32_t less = 1; less >= -1; less--) {
            TEST_ASSERT_EQUAL(less < 0, tl_undo_anew(&undo, true, true)); // what went before rested too short
            for (int32_t tick = less; tick < of[i].ticks; tick++) {
                TEST_ASSERT_FALSE(tl_undo_anew(&undo, false, true));
            }
        }
        TEST_ASSERT_TRUE(tl_undo_anew(&undo, true, true));
        TEST_ASSERT_FALSE(tl_undo_anew(&undo, true, true)); // it goes on
    }
}

// What is still taken up may move the tip until it is done: no rest before. A table without the section never begins
// anew, nor does one without sides.
static void test_no_rest_while_something_is_taken_up_and_none_without_the_section(void) {
    table.has = TL_TABLE_HAS_sides | TL_TABLE_HAS_anew;
    table.sides.side = 1;
    table.anew.rest_us = 3000;
    begin();
    for (int tick = 0; tick < 50; tick++) {
        TEST_ASSERT_FALSE(tl_undo_anew(&undo, false, false));
    }
    for (int tick = 0; tick < 3; tick++) {
        TEST_ASSERT_FALSE(tl_undo_anew(&undo, false, true));
    }
    TEST_ASSERT_FALSE(tl_undo_anew(&undo, true, true));
    for (uint32_t has = 0; has <= TL_TABLE_HAS_sides; has += TL_TABLE_HAS_sides) {
        table.has = has;
        begin();
        for (int tick = 0; tick < 20000; tick++) {
            TEST_ASSERT_FALSE(tl_undo_anew(&undo, tick % 10000 == 9999, true));
        }
    }
}

static void test_a_lag_is_led_by_its_time(void) {
    static const int32_t times_us[] = {5000, 20000, 300000};
    for (unsigned i = 0; i < 3; i++) {
        setUp();
        table.has = TL_TABLE_HAS_late;
        table.late.gain_q16[0] = 65536;
        table.late.time_us[0] = times_us[i];
        begin();
        tl_count_q8_t p = -100 * TL_COUNT_ONE;
        tl_undo_rest(&undo, p);
        TEST_ASSERT_EQUAL_INT32(p, tl_undo_late(&undo, p)); // at rest nothing is late
        const int32_t by = 40, ticks = times_us[i] / 1000;
        for (int32_t tick = 0; tick < 12 * ticks; tick++) {
            p += by;
            const double rest = by * ticks * (1.0 - exp(-(tick + 1.0) / ticks)); // y - y_i of a ramp
            const double led = tl_undo_late(&undo, p) - p;
            // share and gain have 11 bits; within a tick a ramp is where it is in the middle; rests to 1/16 count
            TEST_ASSERT_DOUBLE_WITHIN(by * ticks / 1024.0 + by / 2.0 + 16.0, rest, led);
        }
    }
}

// Any place of a section may be free: what stands behind one is undone as if it stood first.
static void test_what_stands_behind_a_free_place_is_undone(void) {
    enum { TIME_US = 20000, STEPS = 200 };
    static tl_count_q8_t led[STEPS];
    static tl_deg_q16_t angle[STEPS];
    for (unsigned place = 0; place < TL_TABLE_JOINTS; place++) {
        setUp();
        table.has = TL_TABLE_HAS_late | TL_TABLE_HAS_joints;
        table.late.time_us[place + 1U] = TIME_US;
        table.late.gain_q16[place + 1U] = 65536;
        table.joints = (tl_table_joints_t){.slope = {7777777, 7777777, 7777777}}; // nobody's
        table.joints.axis[place] = 3;
        table.joints.play[place] = 50 * TL_COUNT_ONE;
        table.joints.slope[place] = -1000000;
        begin();
        tl_undo_rest(&undo, 0);
        for (int32_t i = 0; i < STEPS; i++) {
            undo.moved.joint[place] = i * TL_COUNT_ONE;
            tl_undo_join(&undo, &lookup);
            const tl_count_q8_t p = tl_undo_late(&undo, 40 * i);
            const tl_deg_q16_t c = tl_undo_angle(&undo, &lookup, TL_DEG_ONE);
            if (place == 0) {
                led[i] = p;
                angle[i] = c;
            }
            TEST_ASSERT_EQUAL_INT32(led[i], p);
            TEST_ASSERT_EQUAL_INT32(angle[i], c);
        }
        // as far as a ramp is followed late, and as another axis carries it
        TEST_ASSERT_INT_WITHIN(40, 40 * (STEPS - 1) + 40 * TIME_US / 1000, led[STEPS - 1]);
        TEST_ASSERT_DOUBLE_WITHIN(0.01 * TL_DEG_ONE, (1.0 + (STEPS - 1 - 25) * 1e6 / (1 << 28)) * TL_DEG_ONE,
                                  angle[STEPS - 1]);
    }
}

static void test_a_table_is_moved_in_its_ticks_and_as_far_as_asked(void) {
    table.has = TL_TABLE_HAS_adapt;
    table.adapt = (tl_table_adapt_t){100 * TL_COUNT_ONE, 0, 2 * TL_RATIO_ONE};
    for (int32_t way = -64; way <= 64; way += 16) { // Q8 counts; half a count a tick at most
        for (uint32_t ticks = 1; ticks <= 5; ticks++) {
            memset(&undo, 0, sizeof undo);
            begin();
            TEST_ASSERT_TRUE(tl_undo_adapt(&undo, &lookup, way, TL_RATIO_ONE, ticks));
            for (uint32_t i = 0; i < ticks; i++) {
                tl_undo_tick(&undo, &lookup, 0);
            }
            TEST_ASSERT_EQUAL_INT32(way * 256, undo.moved.offset.now);
            TEST_ASSERT_TRUE(tl_undo_adapt(&undo, &lookup, -way, TL_RATIO_ONE, ticks));
            tl_undo_start(&undo, &lookup, HZ); // on its way: a start is at the end of it
            TEST_ASSERT_EQUAL_INT32(-way * 256, undo.moved.offset.now);
        }
    }
}

// Another axis carries the tip by its slope once its own backlash is taken up.
static void test_another_axis_carries_the_angle_behind_its_own_play(void) {
    enum { PLAY = 50 * TL_COUNT_ONE };
    const double slope = 1.0 / 300.0; // deg per count
    table.has = TL_TABLE_HAS_joints;
    table.joints.axis[0] = 3;
    table.joints.play[0] = PLAY;
    table.joints.slope[0] = (int32_t)lround(slope * (1 << 28));
    begin();
    double carried = 0.0; // Q8 counts
    const tl_deg_q16_t c = 7 * TL_DEG_ONE;
    for (int32_t i = 0; i < 1000; i++) { // strokes of 400 counts
        const int32_t at = (int32_t)lround(200.0 * TL_COUNT_ONE * sin(i * 0.02));
        undo.moved.joint[0] = at;
        tl_undo_join(&undo, &lookup);
        carried = fmin(fmax(carried, at - PLAY / 2), at + PLAY / 2);
        // the slope has 11 bits, the way is taken to 1/16 count; a bit of the angle
        TEST_ASSERT_DOUBLE_WITHIN((175.0 / 2048.0 + 1.0 / 16.0) * slope * TL_DEG_ONE + 1.0,
                                  c - carried / TL_COUNT_ONE * slope * TL_DEG_ONE, tl_undo_angle(&undo, &lookup, c));
    }
}

// The same for the motor: where it reads less by so much, it pushes from the same place. The angle stays.
static void test_another_axis_carries_the_motor_before_the_play(void) {
    enum { PLAY = 50 * TL_COUNT_ONE };
    const double slope = -0.37; // counts per count
    table.has = TL_TABLE_HAS_joints | TL_TABLE_HAS_before;
    table.joints.axis[1] = 3;
    table.joints.play[1] = PLAY;
    table.before.slope_q20[1] = (int32_t)lround(slope * (1 << 20));
    undo.moved.joint[1] = 300 * TL_COUNT_ONE;
    begin();
    double carried = undo.moved.joint[1]; // Q8 counts: there at the start
    for (int32_t i = 0; i < 1000; i++) {
        // the slope has 11 bits, the way is taken to 1/16 count; a bit
        const double error = (500.0 * TL_COUNT_ONE / 2048.0 + 16.0) * fabs(slope) + 1.0;
        TEST_ASSERT_DOUBLE_WITHIN(error, 4711 - carried * slope, tl_undo_reading(&undo, &lookup, 4711));
        TEST_ASSERT_DOUBLE_WITHIN(error, 4711 + carried * slope, tl_undo_pushing(&undo, &lookup, 4711, TL_UNDO_ROUNDS));
        TEST_ASSERT_EQUAL_INT32(4711, tl_undo_angle(&undo, &lookup, 4711));
        const int32_t at = (int32_t)lround(200.0 * TL_COUNT_ONE * (1.5 + sin(i * 0.02)));
        undo.moved.joint[1] = at;
        tl_undo_join(&undo, &lookup);
        carried = fmin(fmax(carried, at - PLAY / 2), at + PLAY / 2);
    }
}

static void test_a_width_is_scaled_by_a_product(void) {
    begin();
    for (int32_t width = 0; width < TL_TABLE_VALUE_MAX - 7654321; width += 7654321) {
        for (int32_t scale = 1 - (1 << 23); scale < 1 << 23; scale += 234567) {
            undo.moved.scale.now = scale; // Q23, beside one
            TEST_ASSERT_DOUBLE_WITHIN(1.0, width * (1.0 + scale / 8388608.0), tl_undo_scaled(&undo, width));
        }
    }
}

// tl_table.h, section 6, and its inverse: what makes the angle 1 + g times as large is undone by a gain of -g / (1 +
// g).
static void test_a_load_moves_offset_width_and_gain_by_what_is_beyond_its_reference(void) {
    enum { REFERENCE = 20 * 256 };
    for (int32_t load = -300 * 256; load <= 300 * 256; load += 997) {
        table.has = TL_TABLE_HAS_load;
        table.load = (tl_table_load_t){.reference = REFERENCE, .width = 1 << 15, .gain = -(1 << 15), .offset = 1 << 16};
        memset(&undo, 0, sizeof undo);
        begin();
        tl_undo_load(&undo, &lookup, load, 0);
        const double beyond = (load - REFERENCE) / 256.0; // mNm
        const double gain = fmin(fmax(beyond * table.load.gain / (1 << 24), -0.5), 0.5);
        TEST_ASSERT_DOUBLE_WITHIN(1.0, beyond * table.load.offset, undo.moved.offset.now); // counts Q16
        TEST_ASSERT_DOUBLE_WITHIN(1.0, fmin(fmax(beyond * table.load.width / 2.0, -8388608.0), 8388607.0),
                                  undo.moved.scale.now);                                       // Q23
        TEST_ASSERT_DOUBLE_WITHIN(5.0, -gain / (1.0 + gain) * (1 << 23), undo.moved.gain.now); // of a bit of g four
    }
}

static void test_a_slope_has_eleven_bits_and_is_rounded(void) {
    static const struct {
        int32_t slope;
        int16_t value;
        uint8_t log2;
    } of[] = {{0, 0, 0},         {1, 1, 0},         {2047, 2047, 0},    {-2047, -2047, 0},
              {2048, 1024, 1},   {2049, 1025, 1},   {4093, 2047, 1},    {4095, 2047, 1},
              {-4095, -2047, 1}, {-4093, -2046, 1}, {1 << 20, 1024, 10}};
    for (unsigned i = 0; i < sizeof of / sizeof of[0]; i++) {
        table.has = TL_TABLE_HAS_joints;
        table.joints.axis[0] = 3;
        table.joints.slope[0] = of[i].slope;
        begin();
        TEST_ASSERT_EQUAL_INT16(of[i].value, undo.slope[0].value);
        TEST_ASSERT_EQUAL_UINT8(of[i].log2, undo.slope[0].log2);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_encoder_s_error_is_its_harmonics);
    RUN_TEST(test_the_width_grows_with_the_speed);
    RUN_TEST(test_the_speed_comes_through_a_filter_and_stays_where_it_is_held);
    RUN_TEST(test_a_side_is_late_by_the_travel_since_its_turn);
    RUN_TEST(test_what_is_pressed_is_late_by_the_law_wherever_it_turns);
    RUN_TEST(test_another_axis_carries_the_motor_before_the_play);
    RUN_TEST(test_a_side_begins_anew_after_a_rest_of_its_length_and_of_no_less);
    RUN_TEST(test_no_rest_while_something_is_taken_up_and_none_without_the_section);
    RUN_TEST(test_a_lag_is_led_by_its_time);
    RUN_TEST(test_what_stands_behind_a_free_place_is_undone);
    RUN_TEST(test_a_table_is_moved_in_its_ticks_and_as_far_as_asked);
    RUN_TEST(test_another_axis_carries_the_angle_behind_its_own_play);
    RUN_TEST(test_a_width_is_scaled_by_a_product);
    RUN_TEST(test_a_load_moves_offset_width_and_gain_by_what_is_beyond_its_reference);
    RUN_TEST(test_a_slope_has_eleven_bits_and_is_rounded);
    return UNITY_END();
}
