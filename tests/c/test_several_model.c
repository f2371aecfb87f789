// The inverse of several plays, tick by tick and to the last bit: what tl_several.h and tl_elements.h say of where the
// elements want the motor, from where p is (test_compensator_model.c has the feed) and with what is to be taken up
// (there, too), on look-ups and elements that have models of their own.
#include "draws.h"
#include "table_fixture.h"
#include "tl_elements.h"
#include "tl_several.h"
#include "tl_takeup.h"
#include "undone.h"

#include <stdlib.h>
#include <unity.h>

#define LIVES  300
#define TICKS  500
#define TABLES 5

static tl_lookup_t lookups[TABLES]; // the last has one play
static tl_compensator_t k;

static struct {
    const tl_lookup_t *lookup;
    int64_t side, anchor, p, offset, start_offset, apart, centre, strength, q;
    int mode;
    int32_t lag[TL_TABLE_PLAYS_MAX];
    tl_takeup_t takeup;
    undone_t undone;
} m;

static struct {
    uint32_t narrow, wide, turns, leaps, clipped, beyond, undone, anew;
} seen;

void setUp(void) {
    seed = 141421U;
}
void tearDown(void) {}

static void any_lookup(tl_lookup_t *lookup, bool several) {
    tl_table_reason_t reason;
    do {
        const int sign = once_in(2) ? 1 : -1;
        tl_table_t table = several ? table_fixture_several(sign) : table_fixture(sign);
        table.strength_q15 = (uint16_t)(once_in(2) ? TL_RATIO_ONE : between(0, TL_RATIO_ONE));
        table.q_min = between(-4800, -2000) * TL_COUNT_ONE;
        table.q_max = between(2000, 4800) * TL_COUNT_ONE;
        table.band = between(0, 3) * TL_COUNT_ONE;
        table.takeup_speed_q8 = between(50, 20000) * TL_COUNT_ONE;
        table.takeup_accel = once_in(2) ? between(1000, 400000) : between(400000, 40000000);
        table.narrow = once_in(2) ? 0 : between(1, 300 * TL_COUNT_ONE);
        int32_t width = between(0, 400 * TL_COUNT_ONE);
        for (uint32_t i = 0; i < table.nodes; i++) { // the warp need not be that of these widths: any is taken
            table.width[i] = width;
            width = (int32_t)within(width + between(-9000, 9000), 0, 500 * TL_COUNT_ONE);
            table.centre[i] += i > 0U ? between(0, 100000) : 0;
        }
        table.play_weight_q16[0] = (uint32_t)between(3277, 60000);
        table.play_weight_q16[1] = 65536U - table.play_weight_q16[0];
        const uint32_t first = (uint32_t)between(0, (1 << 28) - 70000);
        table.play_width_q28[0] = first;
        table.play_width_q28[1] =
            (uint32_t)((((uint64_t)1 << 44) - (uint64_t)table.play_weight_q16[0] * first) / table.play_weight_q16[1]);
        if (once_in(2)) {
            table.has = TL_TABLE_HAS_adapt | TL_TABLE_HAS_speed | TL_TABLE_HAS_sides;
            table.sides = (tl_table_sides_t){.side = sign, .step_log2 = between(6, 10)};
            table.speed = (tl_table_speed_t){between(10, 14), between(2000, 200000), between(0, 1), {0}};
            table.adapt = (tl_table_adapt_t){1 << 16, 0, 65535};
            undone_curves(&table);
            if (!once_in(3)) {
                table.has |= TL_TABLE_HAS_anew;
                table.anew.rest_us = once_in(2) ? 1 : between(1, 30000);
            }
            if (!once_in(3)) {
                undone_pressed(&table, between(20, 300) * TL_COUNT_ONE);
            }
        }
        reason = tl_lookup_derive(lookup, &table, TL_TABLE_ANY_AXIS);
    } while (reason != TL_TABLE_OK);
}

// -- where the elements want q ----------------------------------------------------------------------------------------

static int64_t width_at(int64_t p) {
    uint32_t ends = 0;
    return tl_lookup_width(m.lookup, (int32_t)p, &ends);
}

// A span of which both ends are narrow; beyond the grid its last ones.
static bool is_narrow(void) {
    const tl_table_t *table = &m.lookup->table;
    int64_t span = m.p < table->q0 ? 0 : (m.p - table->q0) >> table->step_log2;
    span = span > table->nodes - 2 ? table->nodes - 2 : span;
    return table->width[span] < table->narrow && table->width[span + 1] < table->narrow;
}

static int64_t offset_of(int64_t side) { // on the envelope of this side
    if (is_narrow()) {
        seen.narrow++;
        return side * (width_at(m.p) / 2);
    }
    seen.wide++;
    const int64_t half_period = (int64_t)1 << (m.lookup->table.period_log2 - 1);
    const int64_t edge = tl_lookup_centre_inverse(m.lookup, (int32_t)(m.centre + m.apart - side * half_period));
    const int64_t width = width_at(edge), least = m.lookup->table.narrow;
    return edge - m.p + side * ((width > least ? width : least) / 2);
}

static int64_t compensated(void) { // of the offset
    const int64_t size = m.mode == TL_MODE_OFF ? 0 : llabs(m.offset) * 2 * m.strength / 65536;
    const int64_t offset = m.offset < 0 ? -size : size;
    return (m.undone.on ? tl_undo_scaled(&m.undone.undo, (int32_t)offset) : offset) + m.side * m.undone.wider;
}

static void widens(void) {
    undone_widens(&m.undone, m.lookup, m.p, m.strength);
}

static void widens_anew(void) {
    undone_widens_anew(&m.undone, m.lookup, m.p, m.strength);
}

static int64_t pushing(int64_t reading) {
    return undone_pushing(&m.undone, m.lookup, reading);
}

static void sees_what_to_undo(void) {
    undone_sees(&m.undone, m.mode == TL_MODE_FULL, m.q, k.goal);
}

static int64_t fed(int64_t offset) {
    const int64_t low = m.lookup->table.q_min, high = m.lookup->table.q_max, pushed = m.p + offset;
    seen.clipped += pushed < low || pushed > high ? 1U : 0U;
    return within(pushed, low, high);
}

// p has come to where it is: the side, and the plays that undo the elements.
static bool turns_to(int64_t p, bool *moves) {
    const int64_t ahead = p - m.anchor;
    const bool turns = m.side * ahead < 0 || m.side == 0 ? llabs(ahead) > m.lookup->table.band : false;
    m.p = p;
    *moves = turns || (m.side != 0 && m.side * ahead >= 0);
    if (!*moves) {
        return false;
    }
    m.side = turns ? (ahead > 0 ? 1 : -1) : m.side;
    m.anchor = p;
    const int32_t y = tl_lookup_centre(m.lookup, (int32_t)p);
    m.apart = tl_elements_ahead(m.lookup, (int32_t)(y - m.centre), m.lag) + m.side * m.lookup->element[0].half;
    m.centre = y;
    return turns;
}

static int64_t held; // the offset before this tick, as far as it was compensated

static void step(int32_t c) {
    if (m.undone.on) {
        tl_compensator_hear(&k, c);
        undone_weighs(&m.undone, m.lookup);
    }
    tl_compensator_feed(&k, c);
    tl_compensator_turn(&k);
    bool moves;
    const int64_t anchor = m.anchor;
    const bool turns = turns_to(k.p, &moves);
    bool anew = false;
    if (m.undone.on) { // the width may change where p does not
        const bool still = m.takeup.ahead_q36 == 0 && m.takeup.speed_q36 == 0;
        anew = undone_begins(&m.undone, m.lookup, anchor, m.anchor, m.side, turns, still);
        seen.anew += anew && !turns ? 1U : 0U;
        widens();
        seen.undone++;
    }
    if (moves || (m.undone.on && m.side != 0)) {
        const int64_t before = fed(held), most = k.step_max;
        m.offset = offset_of(m.side);
        held = compensated();
        const int64_t jump = fed(held) - before;
        const bool leaps = llabs(jump) > most;
        if (turns || anew || leaps) {
            tl_takeup_add(&m.takeup, (int32_t)jump);
        }
        seen.turns += turns ? 1U : 0U;
        seen.leaps += leaps ? 1U : 0U;
    }
    tl_takeup_step(&m.takeup);
    const int64_t low = m.lookup->table.q_min, high = m.lookup->table.q_max, feed = fed(held);
    const int64_t wanted = feed - (int32_t)tl_takeup_rest(&m.takeup);
    const int64_t q = within(wanted, m.q < low ? m.q : low, m.q > high ? m.q : high);
    if (q != wanted) {
        tl_takeup_set(&m.takeup, (int32_t)(feed - q));
        seen.beyond++;
    }
    m.q = q;
    TEST_ASSERT_EQUAL_INT64(q, tl_compensator_take_up(&k));
    if (m.undone.on) {
        undone_ticks(&m.undone, m.lookup, m.p, q);
        TEST_ASSERT_EQUAL_INT64(m.undone.reading, tl_compensator_reach(&k));
    }
}

// -- changes ----------------------------------------------------------------------------------------------------------

static void stands(int64_t p) {
    m.p = p;
    tl_undo_rest(&m.undone.undo, (int32_t)p);
    m.centre = tl_lookup_centre(m.lookup, (int32_t)p);
    if (m.side != 0) {
        m.offset = offset_of(m.side);
    } else if (is_narrow()) { // as near to where the motor was as the width allows
        m.offset = within(m.offset, -(width_at(p) / 2), width_at(p) / 2);
    } else {
        m.offset = offset_of(m.apart >= 0 ? 1 : -1);
    }
}

static void begins_apart(int64_t apart) {
    m.apart = within(apart, -m.lookup->half, m.lookup->half);
    tl_elements_start(m.lookup, (int32_t)m.apart, m.lag);
    tl_elements_undo(m.lookup, m.lag, m.lag);
}

static void begin(void) {
    memset(&m, 0, sizeof(m));
    m.lookup = &lookups[between(0, TABLES - 2)];
    m.mode = once_in(4) ? between(0, 2) : TL_MODE_FULL;
    m.strength = m.lookup->table.strength_q15;
    const int32_t c = between(-50, 50) * TL_DEG_ONE;
    uint32_t ends = 0;
    m.q = once_in(2) ? between(-6000, 6000) * TL_COUNT_ONE : tl_lookup_angle_inverse(m.lookup, c, &ends);
    tl_compensator_start(&k, m.lookup, 1000, (tl_mode_t)m.mode, (int32_t)m.q, c);
    tl_undo_start(&m.undone.undo, m.lookup, 1000);
    sees_what_to_undo();
    m.undone.reading = m.q;
    m.q = pushing(m.undone.reading);
    m.p = m.anchor = k.p;
    m.offset = m.q - m.p;
    const int64_t side = m.q >= m.p ? 1 : -1;
    const int32_t edge = side > 0 ? tl_lookup_p_low(m.lookup, (int32_t)m.q, (int32_t)m.p, &ends)
                                  : tl_lookup_p_high(m.lookup, (int32_t)m.q, (int32_t)m.p, &ends);
    begins_apart(tl_lookup_centre(m.lookup, edge) + side * m.lookup->half - tl_lookup_centre(m.lookup, (int32_t)m.p));
    stands(m.p);
    widens_anew();
    held = compensated();
    tl_takeup_start(&m.takeup);
    tl_takeup_set_limits(&m.takeup, &m.lookup->table, 1000);
    tl_takeup_add(&m.takeup, (int32_t)(fed(held) - m.q));
}

// The motor stays where it was sent: what it then lacks is taken up.
static void settles(int64_t rest, int64_t reading) {
    m.anchor += k.p - m.p;
    stands(k.p);
    m.undone.reading = reading;
    m.q = pushing(reading);
    widens_anew();
    held = compensated();
    tl_takeup_add(&m.takeup, (int32_t)(fed(held) - (m.q + rest)));
}

static void changes(void) {
    const int64_t rest = tl_compensator_rest(&k), reading = m.undone.on ? m.undone.reading : m.q;
    switch (between(0, 4)) {
    case 0:
        m.mode = once_in(2) ? TL_MODE_FULL : between(0, 2);
        tl_compensator_set_mode(&k, (tl_mode_t)m.mode);
        sees_what_to_undo();
        settles(rest, reading);
        break;
    case 1: {
        const int32_t strength = between(-100, 33000);
        tl_compensator_set_strength(&k, strength);
        widens_anew();
        const int64_t before = fed(compensated());
        m.strength = within(strength, 0, TL_RATIO_ONE);
        widens_anew();
        held = compensated();
        tl_takeup_add(&m.takeup, (int32_t)(fed(held) - before));
        break;
    }
    case 2: { // the place in the backlash stays
        const int64_t place = m.apart * TL_RATIO_ONE / m.lookup->half;
        TEST_ASSERT_EQUAL_INT64(place, tl_several_place(&k));
        m.lookup = &lookups[between(0, TABLES - 2)];
        tl_compensator_set_table(&k, m.lookup);
        tl_undo_start(&m.undone.undo, m.lookup, 1000);
        m.undone.rested = 0;
        sees_what_to_undo();
        tl_takeup_set_limits(&m.takeup, &m.lookup->table, 1000);
        begins_apart(place * m.lookup->half / TL_RATIO_ONE);
        settles(rest, reading);
        break;
    }
    case 3: {
        const int32_t offset = any(14), scale = between(20000, 45000);
        TEST_ASSERT_EQUAL(tl_undo_adapt(&m.undone.undo, m.lookup, offset, scale, 100),
                          tl_compensator_adapt(&k, offset, scale, 100));
        sees_what_to_undo();
        break;
    }
    default: { // by way of a table of one play, which keeps it at its ends where it has a side
        const tl_lookup_t *one = &lookups[TABLES - 1];
        tl_compensator_t other = k;
        tl_compensator_set_table(&other, one);
        const int64_t half = tl_lookup_width(one, other.p, &(uint32_t){0}) / 2;
        const int64_t place = other.side != 0 || half == 0
                                  ? other.side * TL_RATIO_ONE
                                  : within(other.start_offset, -half, half) * TL_RATIO_ONE / half;
        TEST_ASSERT_EQUAL_INT64(place, tl_several_place(&other));
        break;
    }
    }
}

static void test_the_compensator_of_several_plays_is_its_model(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        for (uint32_t i = 0; i < TABLES && life % 8U == 0U; i++) {
            any_lookup(&lookups[i], i + 1U < TABLES);
        }
        begin();
        const bool halts = once_in(2);
        const int32_t calm = halts ? 500 : between(10, 300);
        int32_t c = k.c, by = 0, way = 1;
        for (uint32_t tick = 0; tick < TICKS; tick++) {
            if (once_in(calm)) {
                changes();
            }
            if (halts && once_in(40)) {
                way = once_in(6) ? -way : way;
                by = once_in(2) ? 0 : way * between(1, 3000);
            } else if (!halts && once_in(30)) {
                by = once_in(4) ? 0 : between(-20000, 20000);
                c = once_in(20) ? between(-60, 60) * TL_DEG_ONE : c;
            }
            c = (int32_t)within(c + by, -70 * TL_DEG_ONE, 70 * TL_DEG_ONE);
            step(c);
            TEST_ASSERT_EQUAL_INT64(m.side, k.side);
            TEST_ASSERT_EQUAL_INT64(m.anchor, k.anchor);
            TEST_ASSERT_EQUAL_INT64(m.apart, k.apart);
            TEST_ASSERT_EQUAL_INT64(m.offset, k.offset);
            TEST_ASSERT_EQUAL_INT64((int32_t)tl_takeup_rest(&m.takeup), tl_compensator_rest(&k));
        }
    }
    TEST_ASSERT_TRUE(seen.narrow > LIVES && seen.wide > LIVES && seen.turns > LIVES && seen.leaps > LIVES);
    TEST_ASSERT_TRUE(seen.clipped > LIVES && seen.beyond > 0U && seen.undone > LIVES * TICKS / 10U);
    TEST_ASSERT_GREATER_THAN_UINT32(LIVES / 10U, seen.anew);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_compensator_of_several_plays_is_its_model);
    return UNITY_END();
}
