// Whether an encoder still shows what its motor does, step by step and to the last bit: the equations of tl_sight.h in
// 64-bit numbers, for any gains, drives and encoders.
#include "draws.h"
#include "tautline/tl_sight.h"

#include <stdlib.h>
#include <unity.h>

#define LIVES 3000
#define STEPS 300
#define COUNT TL_COUNT_ONE

static tl_sight_t sight;

static struct model {
    int64_t gain, feed, duty, q, ahead, speed, load, seen_q, least, least_load, must, doubt, unseen_ms;
} m;

static struct seen {
    uint32_t lost, rests, runs_away, unknown;
} seen;

void setUp(void) {
    seed = 235711U;
}
void tearDown(void) {}

static int64_t down(int64_t x, int64_t by) { // rounded down
    const int64_t quotient = x / by;
    return quotient * by > x ? quotient - 1 : quotient;
}

static void configures(const tl_servo_gains_t *gains) {
    const int64_t inertia = gains->inertia < 500 ? 500 : gains->inertia; // no motor is quicker
    const bool known = gains->inertia > 0 && gains->feed_forward > 0 && gains->feed_forward <= 5 * inertia;
    m.gain = known ? ((int64_t)1 << 24) / 10 / inertia : 0;
    m.feed = gains->feed_forward;
    seen.unknown += known ? 0U : 1U;
}

static int64_t pull_of(int64_t speed, int64_t duty) { // what of it does not hold the speed; counts/ms Q16
    return duty - down(down(speed, 256) * m.feed, 256);
}

static int64_t faster(int64_t pull) {
    return down(pull * m.gain, 256);
}

// Nothing of two counts has been seen since: it goes alone, braked by what a load may grow and by what is not known.
static bool goes_unseen(int64_t drove) {
    const int64_t less = 2621 + m.doubt, before = m.least;
    const int64_t after = before + faster(pull_of(before, drove - m.least_load - (before > 0 ? less : -less)));
    if ((before < 0) != (after < 0)) { // a load stops a motor and does not turn it
        m.least = 0;
        seen.rests++;
        return true;
    }
    m.least = after;
    m.must += after < 0 ? down(-after, 256) : down(after, 256);
    const bool lost = m.must > 6 * COUNT;
    m.least = lost ? 0 : m.least;
    seen.lost += lost ? 1U : 0U;
    return !lost;
}

static bool steps(int64_t q, int64_t duty) {
    const int64_t drove = m.duty, moved = within(q - m.q, -64 * COUNT, 64 * COUNT);
    m.duty = duty;
    m.q = q;
    const int64_t pull = pull_of(m.speed, drove - m.load), speed = m.speed + faster(pull);
    const int64_t ahead = m.ahead + speed - moved * 256;
    m.ahead = ahead - down(ahead, 2) - down(ahead, 8);
    m.load = within(m.load + down(ahead, 128), -65536, 65536);
    m.speed = speed - down(ahead, 8);
    if (llabs(m.speed) > (int64_t)64 * 65536) {
        m.speed = 0;
        seen.runs_away++;
    }
    const int64_t way = q - m.seen_q;
    if (llabs(way) < (int64_t)2 * COUNT) {
        m.unseen_ms++;
        return m.least == 0 || m.gain == 0 || goes_unseen(drove);
    }
    const int64_t fades = m.doubt - down(m.doubt, 8);
    m.doubt = llabs(pull) > fades ? llabs(pull) : fades;
    m.seen_q = q;
    m.least = (way < 0) == (m.speed < 0) ? m.speed : 0;
    m.least_load = m.load;
    m.must = m.unseen_ms = 0;
    return true;
}

static void begins(void) {
    static const int32_t inertias[] = {0, 1, 499, 500, 501, 4900, 60000};
    tl_servo_gains_t gains = {.inertia = inertias[between(0, 6)]};
    const int32_t least = gains.inertia > 500 ? gains.inertia : 500;
    gains.feed_forward =
        once_in(3) ? 5 * least + between(-1, 1) : (once_in(6) ? between(-1, 1) : between(2, 5 * least));
    gains.feed_forward = gains.feed_forward > 30000 ? 30000 : gains.feed_forward;
    gains.inertia = once_in(8) ? -1 : gains.inertia;
    const tl_count_q8_t q = any(24);
    tl_sight_configure(&sight, &gains);
    configures(&gains);
    tl_sight_reset(&sight, q);
    m.q = m.seen_q = q;
    m.duty = m.ahead = m.speed = m.load = m.least = m.least_load = m.must = m.doubt = m.unseen_ms = 0;
}

// A reading near q that makes the way since something was seen by number as large as the speed, or one less than its
// opposite: where a sign could be taken for another. q adds 32 to the speed for one to the way.
static int32_t as_far_as_fast(int32_t q, int32_t duty, int32_t sign) {
    const struct model was = m;
    const struct seen had = seen;
    for (uint32_t i = 0; i < 4U; i++) {
        (void)steps(q, duty);
        q -= (int32_t)((m.speed - sign * (q - was.seen_q) + (sign < 0)) / (32 - sign));
        m = was;
    }
    seen = had;
    return q;
}

static void test_sight_is_its_equations(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        begins();
        double speed = 0.0, place = (double)m.q;
        const int32_t wild = once_in(8) ? between(10000, 30000) : 0; // no motor: an encoder that runs to and fro
        int32_t duty = 0;
        bool frozen = false;
        for (uint32_t step = 0; step < STEPS; step++) {
            if (once_in(20)) {
                duty = once_in(4) ? 0 : any(16);
                duty = (int32_t)within(duty, -32768, 32768);
            }
            frozen = once_in(40) ? !frozen : frozen;
            // A motor of about these gains, or another one.
            speed += (m.gain == 0 ? 0.01 : (double)m.gain / 65536.0) * (duty - speed / 256.0 * (double)m.feed) / 256.0;
            const double jump = wild > 0 ? (step / 40U % 2U == 0U ? wild : -wild) : (once_in(100) ? any(16) : 0);
            place += speed + jump;
            int32_t q = (int32_t)(frozen ? m.q + (once_in(3) ? between(-COUNT, COUNT) : 0) : (int64_t)place);
            q = once_in(20) ? as_far_as_fast(q, duty, once_in(2) ? 1 : -1) : q;
            const bool well = steps(q, duty);
            TEST_ASSERT_EQUAL(well, tl_sight_step(&sight, q, duty));
            TEST_ASSERT_EQUAL_INT64(m.speed, sight.speed);
            TEST_ASSERT_EQUAL_INT64(m.load, sight.load);
            TEST_ASSERT_EQUAL_INT64(m.ahead, sight.ahead);
            TEST_ASSERT_EQUAL_INT64(m.least, sight.least);
            TEST_ASSERT_EQUAL_INT64(m.doubt, sight.doubt);
            TEST_ASSERT_EQUAL_INT64(m.unseen_ms, sight.unseen_ms);
        }
        if (once_in(3)) { // what it knew is forgotten
            tl_sight_reset(&sight, 5);
            TEST_ASSERT_EQUAL(0, sight.speed | sight.load | sight.ahead | sight.least | sight.doubt | sight.must |
                                     sight.duty);
        }
    }
    TEST_ASSERT_TRUE(seen.lost > 100U && seen.rests > 100U && seen.runs_away > 20U && seen.unknown > LIVES / 20);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_sight_is_its_equations);
    return UNITY_END();
}
