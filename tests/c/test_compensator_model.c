// The inverse of one play, tick by tick and to the last bit: what tl_compensator.h and tl_takeup.h say, in 64-bit
// numbers, through changes of mode, strength and table, and of what further sections undo. What these give is
// tl_undo.h's own (test_undo_exact.c): here is where each belongs.
#include "draws.h"
#include "table_fixture.h"
#include "undone.h"

#include <stdlib.h>
#include <unity.h>

#define LIVES  400
#define TICKS  600
#define TABLES 6
#define Q36    ((int64_t)1 << 28) // a Q8 count

static tl_lookup_t lookups[TABLES];
static tl_compensator_t k;
static uint32_t seen_flags, undone, begun_anew, pressed, joined;

static struct {
    const tl_lookup_t *lookup;
    int mode, side;
    int64_t rate, strength, p, anchor, start_offset, half, q, c;
    int64_t saved;                                                // of a limited feed, Q32
    int64_t rest, speed, way, accel, most, next_accel, next_most; // Q36: to be taken up, `speed` along `way`
    bool pending;
    uint32_t flags;
    int64_t goal;
    undone_t undone;
} m;

void setUp(void) {
    seed = 112358U;
}
void tearDown(void) {}

static void any_sections(tl_table_t *table) {
    table->has = (uint32_t)random_u32() & (TL_TABLE_HAS_encoder | TL_TABLE_HAS_sides | TL_TABLE_HAS_speed |
                                           TL_TABLE_HAS_late | TL_TABLE_HAS_load | TL_TABLE_HAS_joints);
    table->has |= TL_TABLE_HAS_adapt;
    table->has |= (table->has & TL_TABLE_HAS_sides) != 0 && !once_in(3) ? TL_TABLE_HAS_anew : 0U;
    table->encoder = (tl_table_encoder_t){between(600, 3000) << 12, any(12), any(12), any(10), any(10)};
    table->sides = (tl_table_sides_t){.side = once_in(2) ? 1 : -1, .step_log2 = between(6, 10)};
    table->speed = (tl_table_speed_t){between(10, 14), once_in(2) ? 0 : between(2000, 200000), between(0, 1), {0}};
    undone_curves(table);
    table->late = (tl_table_late_t){{between(100, 65536)}, {between(5000, 300000)}};
    table->load = (tl_table_load_t){any(12), any(14), any(14), any(14), any(20)};
    table->joints = (tl_table_joints_t){{3, 0, 2}, {between(0, 5000), 0, between(0, 5000)}, {any(20), 0, any(20)}};
    table->adapt = (tl_table_adapt_t){between(0, 1 << 18), between(0, 32768), between(32768, 65535)};
    table->anew.rest_us = once_in(2) ? 1 : between(1, 40000);
    if ((table->has & (TL_TABLE_HAS_sides | TL_TABLE_HAS_speed)) != 0 && !once_in(3)) {
        undone_pressed(table, between(60, 400) * TL_COUNT_ONE);
    }
    if ((table->has & TL_TABLE_HAS_joints) != 0 && once_in(2)) { // one of them
        table->has |= TL_TABLE_HAS_before;
        table->joints.slope[2] = 0;
        table->before = (tl_table_before_t){{0, 0, any(21)}};
    }
#define LEFT_OUT(number, name, FIELDS)                                                                                 \
    if ((table->has & TL_TABLE_HAS_##name) == 0) {                                                                     \
        memset(&table->name, 0, sizeof table->name);                                                                   \
    }
    TL_TABLE_SECTIONS(LEFT_OUT)
#undef LEFT_OUT
}

static void any_lookup(tl_lookup_t *lookup) {
    tl_table_t table;
    tl_table_reason_t reason;
    do {
        table = table_fixture(between(0, 1) == 0 ? 1 : -1);
        table.q_min = between(-5000, -2000) * TL_COUNT_ONE + between(0, 255);
        table.q_max = between(2000, 5000) * TL_COUNT_ONE + between(0, 255);
        table.strength_q15 = (uint16_t)between(0, TL_RATIO_ONE);
        table.band = between(0, 4) * TL_COUNT_ONE / 2;
        table.speed_max_q8 = between(50, once_in(3) ? 350 : 20000) * TL_COUNT_ONE + between(0, 255);
        table.takeup_speed_q8 = between(50, 20000) * TL_COUNT_ONE;
        table.takeup_accel = once_in(2) ? between(1, 400000) : between(400000, 40000000);
        int32_t width = between(0, 400 * TL_COUNT_ONE), angle = table.angle[0];
        for (uint32_t i = 0; i < table.nodes; i++) { // some spans flat, which take their time
            const int32_t sign = table.angle[table.nodes - 1U] > table.angle[0] ? 1 : -1;
            table.width[i] = width;
            width = (int32_t)within(width + between(-8000, 8000), 0, 500 * TL_COUNT_ONE);
            if (i > 0U) {
                angle += sign * (between(0, 5) == 0 ? between(1, 900) : between(20000, 60000));
                table.angle[i] = angle;
            }
        }
        table.slope_min_q28 = between(0, 1) == 0 ? 0 : 12000;
        table.flat_speed_q8 = table.slope_min_q28 == 0 ? 0 : between(20, 900) * TL_COUNT_ONE;
        if (once_in(2)) {
            any_sections(&table);
        }
        reason = tl_lookup_derive(lookup, &table, TL_TABLE_ANY_AXIS);
    } while (reason != TL_TABLE_OK);
}

// -- where c wants p, and p wants q -----------------------------------------------------------------------------------

static int64_t goal_of(int32_t c, uint32_t *flags) {
    if (m.mode != TL_MODE_FULL) {
        return tl_lookup_coarse_inverse(m.lookup, c, flags);
    }
    const int64_t p = tl_lookup_angle_inverse(m.lookup, c, flags);
    const int64_t low = m.lookup->table.q_min, high = m.lookup->table.q_max;
    *flags = p < low ? TL_COMPENSATOR_BELOW : (p > high ? TL_COMPENSATOR_ABOVE : *flags);
    return within(p, low, high);
}

// p for the command, what is undone before f included.
static int64_t wanted(uint32_t *flags) {
    return goal_of(m.undone.on ? tl_undo_angle(&m.undone.undo, m.lookup, (int32_t)m.c) : (int32_t)m.c, flags);
}

static int64_t half_width(void) {
    uint32_t flags = 0;
    const int64_t half =
        m.mode == TL_MODE_OFF ? 0 : tl_lookup_width(m.lookup, (int32_t)m.p, &flags) * m.strength / 65536;
    return m.undone.on ? tl_undo_scaled(&m.undone.undo, (int32_t)half) + m.undone.wider : half;
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
    undone_sees(&m.undone, m.mode == TL_MODE_FULL, m.q, m.goal);
}

static int64_t pushed(void) {
    return m.p + (m.side != 0 ? m.side * m.half : within(m.start_offset, -m.half, m.half));
}

static int64_t fed(void) {
    return within(pushed(), m.lookup->table.q_min, m.lookup->table.q_max);
}

static void absorb(int64_t after, int64_t before) {
    m.rest += (after - before) * Q36;
}

// -- the feed ---------------------------------------------------------------------------------------------------------

// Of the way to the goal what a tick may go: no further than a span, and to the edge of a flat one first.
static int64_t aim_of(int64_t goal, bool *slow) {
    const tl_lookup_t *lookup = m.lookup;
    *slow = false;
    if (m.mode != TL_MODE_FULL || lookup->has_flat == 0U || goal == m.p) {
        return goal;
    }
    const int64_t step = (int64_t)1 << lookup->step_log2, next = m.p + within(goal - m.p, -step, step);
    *slow = tl_lookup_is_flat(lookup, (int32_t)m.p);
    if (*slow || !tl_lookup_is_flat(lookup, (int32_t)next)) {
        return next;
    }
    const int64_t span = lookup->q0 + (next - lookup->q0) / step * step, edge = next > m.p ? span : span + step;
    *slow = edge == m.p;
    return *slow ? next : edge;
}

static void feeds(int32_t c) {
    const tl_table_t *table = &m.lookup->table;
    m.c = c;
    m.flags = 0;
    const int64_t on_curve = wanted(&m.flags);
    undone_weighs(&m.undone, m.lookup);
    const int64_t goal =
        m.undone.on ? within(tl_undo_late(&m.undone.undo, (int32_t)on_curve), table->q_min, table->q_max) : on_curve;
    m.goal = goal;
    bool slow;
    const int64_t aim = aim_of(goal, &slow), way = aim - m.p;
    if (goal != m.p) {
        m.flags |= slow ? TL_COMPENSATOR_FLAT : 0U;
        const int64_t a_tick = ((int64_t)(slow ? table->flat_speed_q8 : table->speed_max_q8) << 32) / m.rate;
        const int64_t whole = a_tick >> 32, part = a_tick & 0xFFFFFFFF;
        int64_t most = llabs(way);
        if (most > whole) { // parts of a count are saved up
            m.saved += part;
            most = whole + (m.saved >> 32);
            m.saved &= 0xFFFFFFFF;
        }
        m.p += way < 0 ? -most : most;
    }
    m.flags |= m.p != goal ? TL_COMPENSATOR_LIMITED : 0U;
}

static void turns(void) {
    const int64_t ahead = m.p - m.anchor, anchor = m.anchor;
    m.half = half_width();
    const int64_t before = fed();
    const bool turned = m.side * ahead <= 0 && (m.side == 0 || ahead != 0) && llabs(ahead) > m.lookup->table.band;
    if (turned) {
        m.side = ahead > 0 ? 1 : -1;
    }
    if (turned || m.side * ahead > 0) {
        m.anchor = m.p;
    }
    bool anew = false;
    if (m.undone.on) { // by the side's own travel
        anew = undone_begins(&m.undone, m.lookup, anchor, m.anchor, m.side, turned, m.rest == 0 && m.speed == 0);
        begun_anew += anew && !turned ? 1U : 0U;
        widens();
        m.half = half_width();
    }
    if (turned || anew) {
        absorb(fed(), before);
    }
}

// -- the take-up ------------------------------------------------------------------------------------------------------

static void limits_of_table(void) {
    const tl_table_t *table = &m.lookup->table;
    const int64_t most = ((int64_t)table->takeup_speed_q8 << 28) / m.rate;
    const int64_t accel = (((int64_t)table->takeup_accel << 32) / m.rate << 4) / m.rate;
    m.next_most = most < 1 ? 1 : most;
    m.next_accel = accel < 1 ? 1 : (accel < m.next_most ? accel : m.next_most);
    m.pending = true;
}

static void takes_up(void) {
    if (m.speed == 0) {
        m.most = m.pending ? m.next_most : m.most;
        m.accel = m.pending ? m.next_accel : m.accel;
        m.pending = false;
        m.way = m.rest < 0 ? -1 : (m.rest > 0 ? 1 : m.way);
        if (llabs(m.rest) < m.accel) { // at once
            m.rest = 0;
            return;
        }
    }
    // One more tick at this speed, n a, and then braking take a n (n + 1) / 2.
    const int64_t n = m.speed / m.accel, spare = m.rest * m.way - m.accel * (n * (n + 1) / 2);
    if (spare < 0 || m.pending) {
        m.speed -= m.accel;
    } else if (m.speed + m.accel <= spare && m.speed + m.accel <= m.most) {
        m.speed += m.accel;
    }
    m.rest -= m.way * m.speed;
}

static int64_t rest_q8(void) { // rounded, as seen along its way
    return m.way * ((m.rest * m.way + Q36 / 2) >> 28);
}

static int64_t goes(void) {
    const int64_t low = m.lookup->table.q_min, high = m.lookup->table.q_max, feed = fed();
    takes_up();
    m.flags |= pushed() != feed ? TL_COMPENSATOR_CLIPPED : 0U;
    // Within its range; from outside of it only inwards.
    const int64_t wanted = feed - rest_q8(), q = within(wanted, m.q < low ? m.q : low, m.q > high ? m.q : high);
    if (q != wanted) {
        m.rest = (feed - q) * Q36;
        m.speed = 0;
        m.flags |= TL_COMPENSATOR_CLIPPED;
    }
    m.flags |= m.side == 0 ? TL_COMPENSATOR_NO_SIDE : 0U;
    m.flags |= m.rest != 0 || m.speed != 0 ? TL_COMPENSATOR_TAKE_UP : 0U;
    m.q = q;
    if (m.undone.on) {
        undone_ticks(&m.undone, m.lookup, m.p, q);
    }
    return m.undone.on ? m.undone.reading : q;
}

// -- a life -----------------------------------------------------------------------------------------------------------

static void begin(bool halts) {
    static const uint32_t rates[] = {1000, 1000, 5000, 16, 8, 100001};
    const uint32_t rate = halts ? 1000U : rates[once_in(4) ? 5 : between(0, 5)];
    memset(&m, 0, sizeof m);
    m.lookup = &lookups[between(0, TABLES - 1)];
    for (uint32_t i = 0; i < TABLES && halts && (m.lookup->table.has & TL_TABLE_HAS_anew) == 0; i++) {
        m.lookup = &lookups[i];
    }
    m.mode = halts || once_in(2) ? TL_MODE_FULL : between(0, 2);
    m.rate = within(rate, 16, 100000);
    m.strength = m.lookup->table.strength_q15;
    m.c = (halts ? between(-40, 40) : between(-70, 70)) * TL_DEG_ONE;
    m.q = between(0, 9) == 0 ? (between(0, 1) == 0 ? INT32_MIN : INT32_MAX) : between(-6000, 6000) * TL_COUNT_ONE;
    m.q = once_in(2) ? m.q : tl_lookup_angle_inverse(m.lookup, (int32_t)m.c, &(uint32_t){0});
    tl_compensator_start(&k, m.lookup, rate, (tl_mode_t)m.mode, (int32_t)m.q, (int32_t)m.c);
    tl_undo_start(&m.undone.undo, m.lookup, (uint32_t)m.rate);
    sees_what_to_undo();
    m.undone.reading = within(m.q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    m.q = pushing(m.undone.reading);
    m.way = 1;
    uint32_t flags = 0;
    m.p = m.goal = m.anchor = wanted(&flags);
    m.start_offset = m.q - m.p;
    tl_undo_rest(&m.undone.undo, (int32_t)m.p);
    limits_of_table();
    widens_anew();
    m.half = half_width();
    absorb(fed(), m.q);
}

// Whatever is changed, the motor stays where it was sent: what it then lacks is taken up.
static void settles(int64_t reading) {
    uint32_t flags = 0;
    const int64_t p = wanted(&flags);
    m.anchor += p - m.p;
    m.p = m.goal = p;
    tl_undo_rest(&m.undone.undo, (int32_t)p);
    m.undone.reading = reading;
    m.q = pushing(reading);
    widens_anew();
    m.half = half_width();
    absorb(fed(), m.q + rest_q8());
}

static void adapts_or_loads(void) {
    if (once_in(2)) {
        const int32_t offset = any(19), scale = once_in(3) ? TL_RATIO_ONE : between(0, 66000), load = any(16);
        const uint32_t ticks = (uint32_t)between(0, 300);
        if (once_in(2)) {
            const bool allowed = tl_undo_adapt(&m.undone.undo, m.lookup, offset, scale, ticks);
            TEST_ASSERT_EQUAL(allowed, tl_compensator_adapt(&k, offset, scale, ticks));
        } else {
            tl_undo_load(&m.undone.undo, m.lookup, load, ticks);
            tl_compensator_load(&k, load, ticks);
        }
        sees_what_to_undo();
    } else {
        const uint32_t i = (uint32_t)between(0, TL_TABLE_JOINTS - 1);
        m.undone.undo.moved.joint[i] = k.undo.moved.joint[i] = any(20);
        tl_undo_join(&m.undone.undo, m.lookup);
        tl_undo_join(&k.undo, k.lookup);
    }
}

static void changes(void) {
    const int64_t before_all = m.undone.on ? m.undone.reading : m.q;
    switch (between(0, 3)) {
    case 0:
        m.mode = once_in(2) ? TL_MODE_FULL : between(0, 2);
        tl_compensator_set_mode(&k, (tl_mode_t)m.mode);
        sees_what_to_undo();
        settles(before_all);
        break;
    case 1: {
        const int32_t strength = between(-100, 33000);
        tl_compensator_set_strength(&k, strength);
        widens_anew();
        m.half = half_width();
        const int64_t before = fed();
        m.strength = within(strength, 0, TL_RATIO_ONE);
        widens_anew();
        m.half = half_width();
        absorb(fed(), before);
        break;
    }
    case 2:
        adapts_or_loads();
        break;
    default:
        m.lookup = &lookups[between(0, TABLES - 1)];
        tl_compensator_set_table(&k, m.lookup);
        tl_undo_start(&m.undone.undo, m.lookup, (uint32_t)m.rate);
        m.undone.rested = 0;
        sees_what_to_undo();
        limits_of_table();
        settles(before_all);
        break;
    }
    TEST_ASSERT_EQUAL_INT64(rest_q8(), tl_compensator_rest(&k));
}

static void live(void) {
    const bool halts = once_in(2); // and goes on, mostly the same way: sides may begin anew
    begin(halts);
    int32_t c = (int32_t)m.c, by = 0, way = 1;
    const bool creeps = once_in(4); // by parts of a count, as limits may ask of a tick
    const int32_t calm = halts ? 500 : between(20, 400);
    for (uint32_t tick = 0; tick < TICKS; tick++) {
        if (between(0, calm) == 0) {
            changes();
        }
        if (between(0, 40) == 0 && creeps) {
            by = any(once_in(2) ? 2 : 7);
        } else if (halts && once_in(40)) {
            way = once_in(6) ? -way : way;
            by = once_in(2) ? 0 : way * between(1, 3000);
        } else if (!halts && between(0, 40) == 0) {
            by = between(0, 3) == 0 ? 0 : between(-20000, 20000);
            c = between(0, 9) == 0 ? between(-70, 70) * TL_DEG_ONE : c;
        }
        c = (int32_t)within(c + by, -90 * TL_DEG_ONE, 90 * TL_DEG_ONE);
        feeds(c);
        turns();
        const int64_t q = goes();
        TEST_ASSERT_EQUAL_INT64(q, tl_compensator_step(&k, c));
        TEST_ASSERT_EQUAL_INT64(m.q, k.q);
        TEST_ASSERT_EQUAL(m.undone.on, k.undoes);
        TEST_ASSERT_EQUAL_INT32(m.undone.undo.turned_at, k.undo.turned_at);
        TEST_ASSERT_EQUAL_INT32(m.undone.undo.speed_q8, k.undo.speed_q8);
        undone += m.undone.on ? 1U : 0U;
        pressed += m.undone.on && m.undone.undo.followed != 0 ? 1U : 0U;
        joined += m.undone.on && m.undone.undo.before != 0 ? 1U : 0U;
        TEST_ASSERT_EQUAL_INT64(m.p, k.p);
        TEST_ASSERT_EQUAL_INT64(m.side, k.side);
        TEST_ASSERT_EQUAL_INT64(m.anchor, k.anchor);
        TEST_ASSERT_EQUAL_INT64(rest_q8(), tl_compensator_rest(&k));
        TEST_ASSERT_EQUAL_UINT32(m.flags, k.flags);
        seen_flags |= m.flags;
    }
}

static void test_the_compensator_of_one_play_is_its_model(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        for (uint32_t i = 0; i < TABLES && life % 8U == 0U; i++) {
            any_lookup(&lookups[i]);
        }
        live();
    }
    const uint32_t each = TL_COMPENSATOR_BELOW | TL_COMPENSATOR_ABOVE | TL_COMPENSATOR_FLAT | TL_COMPENSATOR_LIMITED |
                          TL_COMPENSATOR_CLIPPED | TL_COMPENSATOR_NO_SIDE | TL_COMPENSATOR_TAKE_UP;
    TEST_ASSERT_EQUAL_UINT32(each, seen_flags);
    TEST_ASSERT_TRUE(undone > LIVES * TICKS / 10U);
    TEST_ASSERT_GREATER_THAN_UINT32(LIVES / 10U, begun_anew);
    TEST_ASSERT_GREATER_THAN_UINT32(LIVES, pressed);
    TEST_ASSERT_GREATER_THAN_UINT32(LIVES, joined);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_compensator_of_one_play_is_its_model);
    return UNITY_END();
}
