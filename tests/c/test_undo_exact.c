// What a table undoes beside play and curve (tl_undo.h), to the last bit: the same in 64-bit numbers, at random and at
// the ends. test_undoing.c says that these are the equations.
#include "draws.h"
#include "table_fixture.h"
#include "tautline/tl_undo.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define MOST   (((int64_t)1 << 30) - 1)
#define SHORT  (((int64_t)1 << 20) - 1)
#define TRIALS 4000

static tl_lookup_t lookup;
static tl_undo_t undo;

void setUp(void) {
    memset(&undo, 0, sizeof undo);
    memset(&lookup, 0, sizeof lookup);
    lookup.table = table_fixture(1);
    lookup.table.adapt = (tl_table_adapt_t){1 << 20, 0, 65535};
    seed = 271828U;
}
void tearDown(void) {}

// a b / 2^right towards 0.
static int64_t product(int64_t a, int64_t b, uint32_t right) {
    return within(a * b / ((int64_t)1 << right), -MOST, MOST);
}

static void test_a_width_is_scaled(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        const int32_t width = i % 4U == 1U ? any(23) : any(30); // each bit another one, too, but for the sign's like
        const int32_t scale = i % 4U == 0 ? 0 : (i % 4U == 1U ? ~width : any(24));
        undo.moved.scale.now = scale;
        TEST_ASSERT_EQUAL_INT32((int32_t)((uint32_t)width + (uint32_t)product(width, scale, 23)),
                                tl_undo_scaled(&undo, width));
    }
}

// -- ramps ------------------------------------------------------------------------------------------------------------

typedef struct {
    int64_t now, goal, step;
} line_t;

static void aims(line_t *line, int64_t goal, int64_t most, uint32_t ticks) {
    const int64_t way = llabs(goal - line->now), step = ticks > 1U ? way / (int64_t)ticks + 1 : way;
    line->now = ticks == 0U ? goal : line->now;
    line->goal = goal;
    line->step = step < most ? step : most;
}

static void goes(line_t *line) {
    line->now += within(line->goal - line->now, -line->step, line->step);
}

static void check_line(const line_t *line, const tl_ramp_t *ramp) {
    TEST_ASSERT_EQUAL_INT64(line->now, ramp->now);
    TEST_ASSERT_EQUAL_INT64(line->goal, ramp->goal);
}

static struct {
    line_t offset, scale, gain;
    int64_t adapt_offset, adapt_scale, load_offset, load_scale;
} moves;

static void aim_all(int64_t gain, uint32_t ticks) { // half a count a tick; a scale that is as much of 2000 counts
    aims(&moves.offset, within(moves.adapt_offset + moves.load_offset, -MOST, MOST), 32768, ticks);
    aims(&moves.scale, within(moves.adapt_scale + moves.load_scale, -(1 << 23), (1 << 23) - 1), 4096, ticks);
    aims(&moves.gain, gain, 4096, ticks);
}

static void adapts(void) {
    const tl_table_adapt_t *most = &lookup.table.adapt;
    const int32_t offset = between(0, 3) == 0 ? most->offset * between(-1, 1) + between(-1, 1) : any(22);
    const int32_t scale = between(0, 3) == 0 ? between(0, 1) * most->width_most_q15 + between(-1, 1)
                                             : (between(0, 3) == 0 ? TL_RATIO_ONE : between(0, 66000));
    const uint32_t ticks = (uint32_t)between(0, 300);
    const bool none = offset == 0 && scale == TL_RATIO_ONE;
    const bool allowed = (lookup.table.has & TL_TABLE_HAS_adapt) != 0 && abs(offset) <= most->offset &&
                         scale >= most->width_least_q15 && scale <= most->width_most_q15;
    TEST_ASSERT_EQUAL(none || allowed, tl_undo_adapt(&undo, &lookup, offset, scale, ticks));
    if (none || allowed) {
        moves.adapt_offset = (int64_t)offset * 256;
        moves.adapt_scale = (int64_t)(scale - TL_RATIO_ONE) * 256;
        aim_all(moves.gain.goal, ticks);
    }
}

static void loads(void) {
    const tl_table_load_t *by = &lookup.table.load;
    const int32_t load = any(between(0, 5) == 0 ? 31 : 18);
    const uint32_t ticks = (uint32_t)between(0, 300);
    tl_undo_load(&undo, &lookup, load, ticks);
    if ((lookup.table.has & TL_TABLE_HAS_load) == 0) {
        return;
    }
    const int64_t beyond = within((int64_t)load - by->reference, INT32_MIN, INT32_MAX), one = 1 << 23;
    const int64_t gain = within(product(beyond, by->gain, 9), -(1 << 22), 1 << 22);
    moves.load_offset = product(beyond, by->offset, 8);
    moves.load_scale = within(product(beyond, by->width, 9), -one, one - 1);
    aim_all(-gain * one / (one + gain), ticks); // so that (1 + gain) (1 + this) is 1
}

static void test_offset_scale_and_gain_go_to_their_goals_in_a_straight_line(void) {
    for (uint32_t life = 0; life < 200U; life++) {
        setUp();
        seed += life;
        memset(&moves, 0, sizeof moves);
        lookup.table.has = (uint32_t)between(0, 1) * TL_TABLE_HAS_adapt + (uint32_t)between(0, 1) * TL_TABLE_HAS_load;
        lookup.table.load = (tl_table_load_t){any(16), any(15), any(15), any(18), 0};
        tl_undo_start(&undo, &lookup, 1000);
        TEST_ASSERT_EQUAL((lookup.table.has & TL_TABLE_HAS_load) != 0, undo.active);
        bool moved = false;
        for (uint32_t tick = 0; tick < 400U; tick++) {
            if (between(0, 60) == 0) {
                between(0, 1) == 0 ? adapts() : loads();
            }
            moved = moved || moves.offset.goal != 0 || moves.scale.goal != 0 || moves.gain.goal != 0;
            TEST_ASSERT_EQUAL(moved || (lookup.table.has & TL_TABLE_HAS_load) != 0, undo.active);
            tl_undo_tick(&undo, &lookup, 0);
            goes(&moves.offset);
            goes(&moves.scale);
            goes(&moves.gain);
            check_line(&moves.offset, &undo.moved.offset);
            check_line(&moves.scale, &undo.moved.scale);
            check_line(&moves.gain, &undo.moved.gain);
        }
        tl_undo_t begun = undo; // begins at the end of its way
        tl_undo_start(&begun, &lookup, 1000);
        TEST_ASSERT_EQUAL_INT64(moves.offset.goal, begun.moved.offset.now);
        TEST_ASSERT_EQUAL_INT64(moves.scale.goal, begun.moved.scale.now);
        TEST_ASSERT_EQUAL_INT64(moves.gain.goal, begun.moved.gain.now);
        tl_undo_forget(&undo); // what the host has moved
        moves.offset.now = moves.offset.goal = moves.load_offset;
        moves.scale.now = moves.scale.goal = moves.load_scale;
        check_line(&moves.offset, &undo.moved.offset);
        check_line(&moves.scale, &undo.moved.scale);
        check_line(&moves.gain, &undo.moved.gain);
        TEST_ASSERT_EQUAL_INT32(0, undo.moved.adapt_offset);
        TEST_ASSERT_EQUAL_INT32(0, undo.moved.adapt_scale);
    }
}

// -- the angle --------------------------------------------------------------------------------------------------------

// value as 11 bits and a power of two, which is `least` or more.
static int64_t eleven_bits(int64_t value, uint32_t least, uint32_t *log2) {
    for (*log2 = least; llabs(value) >> (*log2 + 11U) != 0; (*log2)++) {
    }
    const int64_t half = *log2 > 0U ? (int64_t)1 << (*log2 - 1U) : 0;
    return within((value + half) >> *log2, -2047, 2047); // rounded
}

static void test_what_other_axes_carry_is_taken_from_the_angle_or_from_the_motor(void) {
    for (uint32_t life = 0; life < 300U; life++) {
        setUp();
        seed += life;
        tl_table_joints_t *joints = &lookup.table.joints;
        lookup.table.load.middle = any(24);
        int64_t carried[TL_TABLE_JOINTS] = {0}, last = 0;
        for (uint32_t i = 0; i < TL_TABLE_JOINTS; i++) {
            joints->axis[i] = between(0, 2);
            joints->play[i] = joints->axis[i] != 0 ? abs(any(20)) : 0;
            joints->slope[i] = any(24);
            lookup.table.before.slope_q20[i] = 0;
            if (joints->axis[i] != 0 && life % 2U == 1U && between(0, 1) == 0) { // the motor instead
                joints->slope[i] = 0;
                lookup.table.before.slope_q20[i] = any(24);
            }
            carried[i] = undo.moved.joint[i] = any(24);
            last = joints->axis[i] != 0 ? i + 1U : last;
        }
        lookup.table.has = TL_TABLE_HAS_joints;
        tl_undo_start(&undo, &lookup, 1000);
        TEST_ASSERT_EQUAL_INT64(last, undo.joints);
        for (uint32_t tick = 0; tick < 60U; tick++) {
            const tl_deg_q16_t c = any(24);
            int64_t expected = c;
            undo.moved.gain.now = between(0, 1) * any(22);
            int64_t before = 0, behind = 0;
            for (uint32_t i = 0; i < TL_TABLE_JOINTS; i++) {
                undo.moved.joint[i] += any(18);
                const int64_t at = undo.moved.joint[i], half = joints->play[i] / 2;
                uint32_t log2;
                const int32_t on_motor = lookup.table.before.slope_q20[i];
                const int64_t slope = eleven_bits(on_motor != 0 ? on_motor : joints->slope[i], 0, &log2);
                if ((int64_t)i < last) {
                    carried[i] = within(carried[i], at - half, at + half);
                }
                if (joints->axis[i] != 0) {
                    *(on_motor != 0 ? &before : &behind) +=
                        within(carried[i] >> 4, -SHORT, SHORT) * slope >> (16U - log2);
                }
            }
            expected -= behind;
            before = within(before, -(1 << 24), 1 << 24);
            const int64_t gain = undo.moved.gain.now;
            expected += gain == 0 ? 0 : product(expected - lookup.table.load.middle, gain, 23);
            tl_undo_join(&undo, &lookup);
            TEST_ASSERT_EQUAL_INT64(expected, tl_undo_angle(&undo, &lookup, c));
            undo.moved.offset.now = any(22);
            const int32_t q = any(24);
            const int64_t offset = (undo.moved.offset.now >> 8) + before;
            TEST_ASSERT_EQUAL_INT64(q - offset, tl_undo_reading(&undo, &lookup, q));
            TEST_ASSERT_EQUAL_INT64(q + offset, tl_undo_pushing(&undo, &lookup, q, TL_UNDO_ROUNDS));
        }
    }
}

// -- lag and creep ----------------------------------------------------------------------------------------------------

typedef struct {
    int64_t at; // Q40
    int64_t share, gain, most;
    uint32_t share_log2, gain_log2, coarse;
} follower_t;

static int64_t share_of_tick(int64_t time_us, int64_t rate_hz) { // 1 / (ticks + 1/2), Q32; half at most
    const int64_t share = ((int64_t)2000000 << 32) / (2 * time_us * rate_hz + 1000000);
    return share < INT32_MAX ? share : INT32_MAX;
}

static follower_t follower(int64_t time_us, int64_t gain_q16, int64_t rate_hz, int64_t p) {
    follower_t f = {.at = p * ((int64_t)1 << 32) + ((int64_t)1 << 31)}; // rests are rounded
    f.share = eleven_bits(share_of_tick(time_us, rate_hz), 1, &f.share_log2);
    f.gain = eleven_bits(gain_q16, 0, &f.gain_log2);
    f.coarse = time_us >= 50000 && f.gain_log2 <= 11U ? 4U : 0U;
    const int64_t lead = (int64_t)1 << 28 << (16U - f.gain_log2 - f.coarse); // of the rest by the gain
    f.most = f.gain == 0 ? SHORT : within(lead / llabs(f.gain), 0, SHORT);
    return f;
}

static int64_t leads(follower_t *f, int64_t p) {
    const int64_t rest = within((p - (f->at >> 32)) >> f->coarse, -f->most, f->most), way = rest * f->share;
    const int64_t step = way >> (32U - f->share_log2); // what this tick takes of it
    f->at += way * ((int64_t)1 << (f->share_log2 + f->coarse));
    return (rest - step / 2) * f->gain >> (16U - f->gain_log2 - f->coarse);
}

static void test_what_is_late_is_led(void) {
    for (uint32_t life = 0; life < 300U; life++) {
        setUp();
        seed += life;
        const int32_t rate_hz = between(0, 1) == 0 ? 1000 : 5000;
        follower_t f[TL_TABLE_LATE_MAX];
        uint32_t used = 0;
        int32_t p = any(24);
        for (uint32_t i = 0; i < TL_TABLE_LATE_MAX; i++) {
            const int32_t time_us = between(0, 2) == 0   ? 0
                                    : between(0, 4) == 0 ? 50000 - between(0, 1)
                                                         : abs(any(22)) + 1;
            lookup.table.late.time_us[i] = time_us;
            lookup.table.late.gain_q16[i] = any(20);
            if (time_us != 0) {
                f[used++] = follower(time_us, lookup.table.late.gain_q16[i], rate_hz, p);
            }
        }
        lookup.table.has = TL_TABLE_HAS_late;
        tl_undo_start(&undo, &lookup, (uint32_t)rate_hz);
        tl_undo_rest(&undo, p);
        TEST_ASSERT_EQUAL_INT32(p, undo.p);
        int32_t speed = 0;
        for (uint32_t tick = 0; tick < 200U; tick++) {
            speed = between(0, 20) == 0 ? any(12) : speed;
            p = (int32_t)within(p + speed + (between(0, 50) == 0 ? any(22) : 0), -(1 << 28), 1 << 28);
            int64_t expected = p;
            for (uint32_t i = 0; i < used; i++) {
                expected += leads(&f[i], p);
            }
            TEST_ASSERT_EQUAL_INT64(within(expected, -MOST, MOST), tl_undo_late(&undo, p));
        }
    }
}

// -- the width --------------------------------------------------------------------------------------------------------

static const int32_t nodes[TL_TABLE_LAST + 1U] = {0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256};

// A small table at x, straight between its nodes by 16 bits.
static int32_t small(const int32_t *values, int64_t x, int32_t step_log2) {
    uint32_t i = 0;
    while (i < TL_TABLE_LAST && (int64_t)nodes[i + 1U] << step_log2 <= x) {
        i++;
    }
    if (i == TL_TABLE_LAST) {
        return values[i];
    }
    const int64_t from = (int64_t)nodes[i] << step_log2, to = (int64_t)nodes[i + 1U] << step_log2;
    return tl_lerp(values[i], values[i + 1U], (uint32_t)(((x - from) << 16) / (to - from)));
}

static int64_t part(int64_t x, int64_t part_q12) { // in two products of 32 bits
    return (x >> 12) * part_q12 + ((x & 0xFFF) * part_q12 >> 12);
}

// max(0, 1 + share (B / mean - 1))
static int64_t weight(int64_t width, int64_t share_q16) {
    const tl_scale_t per_mean_q14 = tl_scale_of(16384, (uint32_t)lookup.table.pressed.mean);
    const int64_t beyond_q14 = (int64_t)tl_scale((uint32_t)width, per_mean_q14) - 16384;
    return within(4096 + (beyond_q14 * (share_q16 >> 4) >> 14), 0, INT32_MAX);
}

// The side's turn as section 10 moves it: exact but for 1/16 count of what is late.
typedef struct {
    int64_t turned, caught, followed, rest_q12, half, sides_q12;
} turn_t;

static void follows(turn_t *turn, int64_t side, int64_t width) {
    const int64_t sides_q12 = weight(width, lookup.table.pressed.sides_q16), half = width / 2;
    const int64_t more = within(turn->caught - turn->followed, 0, 16383) >> lookup.follows_log2;
    const int64_t again_q12 = more * (turn->sides_q12 - 4096) + turn->rest_q12;
    const int64_t late_q4 = (lookup.table.sides.late[0] - turn->caught) >> 4;
    const int64_t grown_q12 = within(sides_q12 - turn->sides_q12, -1023, 1023);
    turn->turned += side * ((again_q12 >> 12) - (half - turn->half) - ((late_q4 * grown_q12 + 128) >> 8));
    turn->followed += more;
    turn->rest_q12 = again_q12 & 0xFFF;
    turn->half = half;
    turn->sides_q12 = sides_q12;
}

// Of the widest: what a tick goes of the way, and what may be pressed.
static bool presses(bool told) {
    int64_t most = 0;
    lookup.follows_log2 = 0;
    lookup.table.pressed =
        (tl_table_pressed_t){between(20, 500) * TL_COUNT_ONE, between(0, 2 << 16), between(0, 2 << 16)};
    for (uint32_t i = 0; told && i < lookup.table.nodes; i++) {
        const int64_t w = weight(lookup.table.width[i], lookup.table.pressed.sides_q16);
        most = w > most ? w : most;
    }
    const bool taken = told && tl_lookup_derive(&lookup, &lookup.table, 0) == TL_TABLE_OK;
    TEST_ASSERT_TRUE(!taken || most <= (4096 * 3 / 2 << lookup.follows_log2) + 2);
    TEST_ASSERT_TRUE(!taken || lookup.follows_log2 == 0 || most >= (4096 * 3 / 4 << lookup.follows_log2) - 2);
    return taken;
}

static void test_the_width_grows_by_speed_and_side(void) {
    uint32_t pressed = 0;
    for (uint32_t life = 0; life < 300U; life++) {
        setUp();
        seed += life;
        tl_table_speed_t *by = &lookup.table.speed;
        tl_table_sides_t *sides = &lookup.table.sides;
        by->step_log2 = between(4, 22);
        by->time_us = between(0, 1) * abs(any(20));
        by->held = between(0, 1);
        sides->step_log2 = between(0, 20);
        sides->side = between(-1, 1);
        for (uint32_t i = 0; i <= TL_TABLE_LAST; i++) {
            by->extra[i] = abs(any(20));
            sides->late[i] = abs(any(20));
        }
        const bool goes = life % 3U != 0U;
        lookup.table.has = TL_TABLE_HAS_speed | TL_TABLE_HAS_sides | (goes ? TL_TABLE_HAS_pressed : 0U);
        for (uint32_t i = 0; goes && i <= TL_TABLE_LAST; i++) { // what a table may say
            sides->late[i] = (int32_t)(TL_TABLE_LAST - i) << (sides->step_log2 < 12 ? sides->step_log2 : 12);
        }
        sides->side = goes && sides->side == 0 ? 1 : sides->side;
        if (!presses(goes)) {
            lookup.table.has &= ~(uint32_t)TL_TABLE_HAS_pressed;
        }
        const bool has = (lookup.table.has & TL_TABLE_HAS_pressed) != 0;
        turn_t turn = {.sides_q12 = 4096};
        tl_undo_start(&undo, &lookup, 1000);
        const int64_t share = by->time_us == 0 ? 65536 : share_of_tick(by->time_us, 1000) >> 16;
        int32_t p = any(20), side = 0;
        int64_t speed = 0, extra = 0;
        tl_undo_rest(&undo, p);
        for (uint32_t tick = 0; tick < 200U; tick++) {
            if (between(0, 30) == 0) {
                side = between(-1, 1);
                turn.turned = p + any(10);
                turn.caught = turn.followed = 0;
                tl_undo_turned(&undo, (int32_t)turn.turned, side);
            }
            const int32_t step = between(0, 2) == 0 ? 0 : any(between(0, 9) == 0 ? 22 : 12);
            p += step;
            tl_undo_tick(&undo, &lookup, p);
            TEST_ASSERT_EQUAL_INT32(p, undo.p);
            if (step != 0 || by->held == 0) {
                const int64_t seen = within(step, -(MOST / 1000), MOST / 1000) * 1000;
                speed += (seen - speed) * share >> 16;
                extra = small(by->extra, llabs(speed), by->step_log2);
            }
            TEST_ASSERT_EQUAL_INT64(speed, undo.speed_q8);
            int64_t expected = extra;
            const int32_t width = tl_lookup_width(&lookup, p, &(uint32_t){0});
            if (has) {
                follows(&turn, side > 0 ? 1 : -1, width);
                expected = part(extra, weight(width, lookup.table.pressed.speed_q16));
            }
            tl_undo_weigh(&undo, &lookup, p);
            const int64_t travel = side * ((int64_t)p - turn.turned);
            if (side != 0 && side == sides->side) {
                const int64_t late = small(sides->late, travel > 0 ? travel : 0, sides->step_log2);
                turn.caught = sides->late[0] - late;
                expected += 2 * part(late, turn.sides_q12);
                pressed += has && turn.followed != 0 ? 1U : 0U;
            }
            TEST_ASSERT_EQUAL_INT64(expected, tl_undo_wider(&undo, &lookup, p));
            TEST_ASSERT_EQUAL_INT64(turn.turned, undo.turned_at);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(1000, pressed);
}

// -- the encoder ------------------------------------------------------------------------------------------------------

// A turn is a whole number of periods anywhere: 48 bits of a Q8 count's share of it.
static void test_an_encoder_s_error_is_periodic_to_the_ends_of_the_range(void) {
    static tl_table_t table;
    for (uint32_t i = 0; i < 60U; i++) {
        setUp();
        seed += i;
        table = table_fixture(1);
        table.has = TL_TABLE_HAS_encoder;
        const double period = between(700 << 12, 60000 << 12), size = 9000.0;
        table.encoder = (tl_table_encoder_t){.period_q12 = (int32_t)period};
        *(i % 2U == 0U ? &table.encoder.sine : &table.encoder.cosine) = (int32_t)size;
        TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS));
        for (uint32_t k = 0; k < 200U; k++) {
            const int32_t q = any(k % 2U == 0U ? 29 : 21);
            const double turn = 2.0 * 3.14159265358979323846 * fmod(q * 16.0 / period, 1.0);
            const double expected = size * (i % 2U == 0U ? sin(turn) : cos(turn));
            // the sine to 1.4e-4, a product to 2^-13, a turn to 2^-14; last bits
            TEST_ASSERT_DOUBLE_WITHIN(size * (1.4e-4 + 1.0 / 8192.0 + 3.2 / 16384.0) + 2.0, expected,
                                      (double)q - tl_undo_reading(&undo, &lookup, q));
            undo.moved.offset.now = any(24);
            const int32_t shaft = q - (undo.moved.offset.now >> 8);
            const int32_t reading = tl_undo_reading(&undo, &lookup, q);
            const int32_t pushed = tl_undo_pushing(&undo, &lookup, q, TL_UNDO_ROUNDS);
            undo.moved.offset.now = 0;
            TEST_ASSERT_EQUAL_INT32(tl_undo_reading(&undo, &lookup, shaft), reading); // from where the shaft is
            TEST_ASSERT_EQUAL_INT32(tl_undo_pushing(&undo, &lookup, q, TL_UNDO_ROUNDS) + q - shaft, pushed);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_width_is_scaled);
    RUN_TEST(test_offset_scale_and_gain_go_to_their_goals_in_a_straight_line);
    RUN_TEST(test_what_other_axes_carry_is_taken_from_the_angle_or_from_the_motor);
    RUN_TEST(test_what_is_late_is_led);
    RUN_TEST(test_the_width_grows_by_speed_and_side);
    RUN_TEST(test_an_encoder_s_error_is_periodic_to_the_ends_of_the_range);
    return UNITY_END();
}
