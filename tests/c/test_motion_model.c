// The calibration motion against its model (what tl_motion.h says, in whole numbers): the same reference on every tick,
// whatever is asked for, and whenever onsets come.
#include "draws.h"
#include "tautline/tl_motion.h"

#include <math.h>
#include <string.h>
#include <unity.h>

#ifndef MOTIONS
#define MOTIONS 400U
#endif
#define TICKS_MOST 30000U
#define ONE        ((int64_t)1 << 24) // a Q8 count in Q32

static tl_motion_t motion;
static tl_motion_config_t config;

// Positions and speeds Q32, speeds a tick.
static struct {
    tl_motion_state_t state, ends_as;
    int64_t at, began, target, speed, acceleration, first, half_step;
    uint32_t pass, leg, quiet;
    int32_t way;
    enum { TO_THE_BEGINNING, REVERSAL, ON } phase;
} m;
static uint32_t ended[6];

void setUp(void) {}
void tearDown(void) {}

static int64_t a_tick(int32_t speed) { // speeds are cut off to whole ones
    return speed * ONE / config.rate_hz;
}

// Ticks that braking takes, a tick each with `acceleration` less, and what they cover when they begin on the next one.
static int64_t braking(int64_t speed) {
    const int64_t a = m.acceleration, ticks = (speed + a - 1) / a;
    return a * (ticks * (ticks - 1) / 2);
}

static bool back(void) { // every other pass
    return m.pass % 2U == 1U;
}

static int32_t forward(void) {
    return back() ? -1 : 1;
}

static int64_t end_of(int32_t way) {
    return way > 0 ? config.high * ONE : config.low * ONE;
}

static int64_t farther(int64_t a, int64_t b, int32_t way) {
    return (a - b) * way > 0 ? a : b;
}

// A place that lies `by` further on, within the range.
static int64_t onward(int64_t by, int32_t way) {
    return farther(m.at + way * by, end_of(way), -way);
}

static void leg_to(int64_t target) {
    m.way = target < m.at ? -1 : 1;
    m.began = m.at;
    m.target = target;
}

static bool leads_forward(void) {
    return m.leg % 2U == 0U;
}

static void reverse(void) {
    m.phase = REVERSAL;
    leg_to(leads_forward() ? end_of(forward()) : onward(config.stroke_max * ONE, -forward()));
}

// The turning points are spread evenly: half a step, then whole ones; the pass back has its first at once.
static int64_t turning_point(void) {
    const uint32_t number = m.leg / 2U;
    return number == config.cycles ? end_of(forward())
                                   : m.first + forward() * m.half_step * (int64_t)(2U * number + (back() ? 0U : 1U));
}

static void onset_seen(void) {
    m.phase = ON;
    m.target = onward(braking(m.speed) + config.approach * ONE, m.way);
    if (!leads_forward()) {
        return;
    }
    if (m.leg == 0U) {
        m.first = m.target;
        const int64_t way = (end_of(forward()) - m.first) * forward() / ONE; // Q8
        const double step = (double)way / (2.0 * config.cycles);
        TEST_ASSERT_DOUBLE_WITHIN(1.0, step, (double)motion.half_step / (double)ONE);
        TEST_ASSERT_EQUAL_INT64(0, motion.half_step % ONE);
        m.half_step = motion.half_step; // rounded as it is there
    }
    m.target = farther(m.target, turning_point(), m.way);
}

static void leg_ends(void) {
    m.speed = 0;
    if (m.phase == TO_THE_BEGINNING && m.at != end_of(-1)) {
        leg_to(end_of(-1));
        return;
    }
    if (m.phase != TO_THE_BEGINNING) {
        m.leg++;
    }
    if (m.leg == 2U * config.cycles + 1U) {
        m.leg = 0;
        m.pass++;
    }
    if (m.pass == 2U * config.speed_count) {
        m.state = TL_MOTION_COMPLETE;
    } else {
        reverse();
    }
}

static int64_t measuring(void) {
    return a_tick(config.speed[m.pass / 2U]);
}

// Whether a tick at `speed` leaves room to brake: to rest at the target, and to measuring speed before the approach.
static bool may(int64_t speed) {
    const int64_t left = (m.target - m.at) * m.way - speed - braking(speed);
    return left >= 0 && (speed <= measuring() || left + braking(measuring()) >= config.approach * ONE);
}

static int64_t least(int64_t a, int64_t b) {
    return a < b ? a : b;
}

static void choose(void) {
    const int64_t a = m.acceleration, left = (m.target - m.at) * m.way, slow = measuring();
    const int64_t cap = m.phase == REVERSAL ? slow : a_tick(config.transit);
    if (m.speed <= a && left <= least(a, slow)) {
        m.speed = left;
        return;
    }
    const int64_t whole = (m.speed + a - 1) / a * a; // costs no tick of braking more
    const int64_t faster[] = {least(m.speed + a, cap), least(m.speed + a, slow), least(m.speed + a, least(whole, cap))};
    for (unsigned i = 0; i < 3U; i++) {
        if (faster[i] > m.speed && may(faster[i])) {
            m.speed = faster[i];
            return;
        }
    }
    if (m.speed > 0 && may(m.speed)) {
        return;
    }
    const int64_t slower = m.speed > a ? m.speed - a : 0;
    m.speed = m.speed > slow && slower < slow && may(slow) ? slow : slower;
}

static tl_motion_reference_t tick(void) {
    const int64_t timeout = (int64_t)config.host_timeout_us * config.rate_hz / 1000000;
    if (m.state == TL_MOTION_RUNNING) {
        if (timeout > 0 && ++m.quiet > timeout) {
            m.state = TL_MOTION_STOPPING;
            m.ends_as = TL_MOTION_HOST_LOST;
        } else if (m.at == m.target) {
            leg_ends();
        } else {
            if (m.phase == REVERSAL && leads_forward() && (m.at - m.began) * m.way >= config.stroke_max * ONE) {
                onset_seen();
            }
            choose();
        }
    }
    if (m.state == TL_MOTION_STOPPING) {
        m.speed = m.speed > m.acceleration ? m.speed - m.acceleration : 0;
        m.state = m.speed == 0 ? m.ends_as : m.state;
    }
    m.at += m.way * m.speed;
    const double velocity = (double)m.way * (double)m.speed * config.rate_hz / (double)ONE;
    const int64_t rounded = (m.at + ONE / 2) >> 24;
    return (tl_motion_reference_t){.q = (tl_count_q8_t)rounded, .velocity = (int32_t)floor(velocity)};
}

static void begin(void) {
    do {
        config = (tl_motion_config_t){
            .speed_count = (uint8_t)between(1, 4),
            .cycles = (uint8_t)between(1, 5),
            .transit = between(200, 8000) * TL_COUNT_ONE + between(0, 255),
            .acceleration = between(2000, 400000) * TL_COUNT_ONE + between(0, 255),
            .approach = between(TL_COUNT_ONE, 60 * TL_COUNT_ONE),
            .stroke_max = between(30 * TL_COUNT_ONE, 400 * TL_COUNT_ONE),
            .low = between(-2000, 100) * TL_COUNT_ONE + between(0, 255),
            .host_timeout_us =
                once_in(3) ? (uint32_t)(once_in(2) ? 1000 * between(20, 1500) : between(20000, 1500000)) : 0,
            .rate_hz = once_in(2) ? 1000U : (uint32_t)between(1000, 10000),
        };
        config.high = config.low + 2 * config.stroke_max + between(1, 800 * TL_COUNT_ONE);
        const bool whole = once_in(4); // ticks of braking, of each speed
        if (whole) {
            config.rate_hz = 1000U;
            config.acceleration = between(8, 800) * 125000; // of 2^-24 counts a tick^2
        }
        for (uint32_t i = 0; i < config.speed_count; i++) {
            config.speed[i] = once_in(6) ? config.transit : between(config.transit / 20 + 64, config.transit);
            const int32_t step = config.acceleration / 1000, steps = config.speed[i] / step;
            config.speed[i] = whole && steps > 0 ? steps * step : config.speed[i];
        }
        memset(&m, 0, sizeof m);
        m.at = between(config.low - 20000, config.high + 20000) * ONE;
        motion = (tl_motion_t){0};
    } while (tl_motion_start(&motion, &config, (tl_count_q8_t)(m.at / ONE)) != TL_MOTION_OK);
    m.state = TL_MOTION_RUNNING;
    m.acceleration = config.acceleration * ONE / (int64_t)config.rate_hz / (int64_t)config.rate_hz;
    const int64_t beyond = (config.low + (int64_t)config.stroke_max) * ONE;
    leg_to(m.at < beyond ? beyond : end_of(-1));
}

static void check_tick(void) {
    const tl_motion_reference_t got = tl_motion_tick(&motion), expected = tick();
    TEST_ASSERT_EQUAL_INT64(m.at, motion.position);
    TEST_ASSERT_EQUAL_INT32(expected.q, got.q);
    TEST_ASSERT_EQUAL_INT32(expected.velocity, got.velocity);
    TEST_ASSERT_EQUAL(m.state, tl_motion_state(&motion));
    if (m.state == TL_MOTION_RUNNING) { // ticks that braking takes
        const int64_t steps = motion.steps;
        TEST_ASSERT_TRUE((steps - 1) * m.acceleration < m.speed && m.speed <= steps * m.acceleration);
    }
    const uint32_t legs = 2U * config.cycles + 1U, done = legs * m.pass + m.leg;
    TEST_ASSERT_EQUAL_UINT16(1000U * done / (legs * 2U * config.speed_count), tl_motion_progress(&motion));
}

static void told_onset(int32_t way) {
    tl_motion_onset(&motion, (int8_t)way);
    if (m.state == TL_MOTION_RUNNING && m.phase == REVERSAL && way == m.way) {
        onset_seen();
    }
}

static void go(void) {
    const int32_t frames = between(5, 400), onsets = once_in(3) ? 1000000 : between(1, 300);
    for (uint32_t i = 0; i < TICKS_MOST && (m.state == TL_MOTION_RUNNING || m.state == TL_MOTION_STOPPING); i++) {
        check_tick();
        if (once_in(frames)) {
            tl_motion_frame(&motion);
            m.quiet = 0;
        }
        if (once_in(onsets)) {
            told_onset(once_in(2) ? 1 : -1);
        }
        if (once_in(20000)) {
            tl_motion_stop(&motion);
            m.ends_as = m.state == TL_MOTION_RUNNING ? TL_MOTION_STOPPED : m.ends_as;
            m.state = TL_MOTION_STOPPING;
        }
    }
    ended[m.state]++;
    for (uint32_t i = 0; i < 3U; i++) { // it rests, whatever comes
        told_onset(1);
        tl_motion_stop(&motion);
        tl_motion_frame(&motion);
        m.state = m.state == TL_MOTION_RUNNING ? TL_MOTION_STOPPING : m.state;
        m.ends_as = TL_MOTION_STOPPED;
        check_tick();
    }
}

static void test_the_motion_is_its_model(void) {
    seed = 2718281U;
    for (uint32_t i = 0; i < MOTIONS; i++) {
        begin();
        go();
    }
    TEST_ASSERT_TRUE(ended[TL_MOTION_COMPLETE] > MOTIONS / 4U);
    TEST_ASSERT_TRUE(ended[TL_MOTION_STOPPED] > MOTIONS / 20U);
    TEST_ASSERT_TRUE(ended[TL_MOTION_HOST_LOST] > MOTIONS / 20U);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_motion_is_its_model);
    return UNITY_END();
}
