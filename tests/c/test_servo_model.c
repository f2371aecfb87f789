// Path and servo to the last bit: what tl_path.h and tl_servo.h say, in 64-bit numbers. test_servo.c says that these
// are the equations.
#include "draws.h"
#include "tautline/tl_servo.h"

#include <stdlib.h>
#include <unity.h>

#define LIVES 600
#define TICKS 300

static tl_servo_t servo;
static tl_path_t path;

void setUp(void) {
    seed = 693147U;
}
void tearDown(void) {}

// -- gains in ticks ---------------------------------------------------------------------------------------------------

static uint32_t bits_over_15(int64_t most) {
    uint32_t bits = 0;
    while (most >> bits > 32767) {
        bits++;
    }
    return bits;
}

// Duty Q15 for `per` of something a second, as Q25 for 2^down of it a tick, Q24.
static int64_t a_tick(int64_t gain, int64_t rate, uint32_t down, int64_t per) {
    return gain * rate * ((int64_t)1 << (10U + down)) / (per << 24);
}

static void check_gains(const tl_servo_gains_t *gains, int64_t rate) {
    const uint32_t speed_down = bits_over_15(((int64_t)30000 << 24) / rate);           // counts/s
    const uint32_t bend_down = bits_over_15(((int64_t)4000000 << 25) / (rate * rate)); // counts/s2, twice
    TEST_ASSERT_EQUAL_UINT32(speed_down, servo.speed_down);
    TEST_ASSERT_EQUAL_UINT32(bend_down, servo.bend_down);
    TEST_ASSERT_EQUAL_UINT32(speed_down + 2U - bend_down, servo.bend_per_speed);
    TEST_ASSERT_EQUAL_INT64((int64_t)32767 << speed_down, servo.velocity_max);
    TEST_ASSERT_EQUAL_INT64(gains->proportional, servo.proportional);
    TEST_ASSERT_EQUAL_INT64((int64_t)gains->integral * 64 / rate, servo.integral_step);
    const int64_t derivative = a_tick(gains->derivative, rate, speed_down, 1000);
    TEST_ASSERT_EQUAL_INT64(derivative, servo.derivative);
    TEST_ASSERT_EQUAL_INT64(derivative + a_tick(gains->feed_forward, rate, speed_down, 1000), servo.path_gain);
    TEST_ASSERT_EQUAL_INT64(a_tick(gains->inertia, rate * rate, bend_down, 100000), servo.inertia);
    const int64_t omega = 502; // 2 pi 80 Hz, whole
    TEST_ASSERT_EQUAL_INT64(2 * omega * 32768 / rate, servo.alpha);
    TEST_ASSERT_EQUAL_INT64(omega * omega * 65536 / (rate * rate), servo.beta);
}

static uint32_t any_gains(void) {
    static const uint32_t rates[] = {1000, 2000, 5000, 10000};
    const uint32_t rate = rates[between(0, 3)];
    const tl_servo_gains_t gains = {.proportional = abs(any(15)),
                                    .integral = abs(any(15)),
                                    .derivative = abs(any(13)),
                                    .feed_forward = abs(any(13)),
                                    .inertia = abs(any(14)),
                                    .friction = between(0, 2) * 1000};
    TEST_ASSERT_TRUE(tl_servo_configure(&servo, &gains, rate));
    check_gains(&gains, rate);
    return rate;
}

// -- the path ---------------------------------------------------------------------------------------------------------

static int64_t share_of(int64_t x, int64_t share) { // a tick's of a millisecond's
    return (x * share) >> 16;
}

static struct {
    int64_t base, offset, speed, bend, velocity;
} p;

static void path_begins(const tl_reference_t *reference, int64_t ticks) {
    const int64_t share = (65536 + ticks / 2) / ticks, before = p.velocity, after = reference->velocity;
    p.bend = share_of(share_of(after - before, share), share);
    p.speed = share_of(before, share);
    p.velocity = after;
    p.base = reference->q;
    // Half of a tick before the beginning, at (r[k-1] + r[k]) / 2; half of a Q8 count for rounding.
    p.offset = 32768 + reference->fraction - after - (before >> 1) - (p.speed >> 1) + (p.bend >> 3);
}

static void path_ticks(void) {
    p.offset += p.speed;
    p.speed += p.bend;
    TEST_ASSERT_EQUAL_INT64(p.base + (p.offset >> 16), path.q);
    TEST_ASSERT_EQUAL_INT64(p.speed, path.speed);
    TEST_ASSERT_EQUAL_INT64(p.bend, path.bend);
}

// -- the servo --------------------------------------------------------------------------------------------------------

static struct {
    uint32_t predicted;
    int64_t velocity, integral, feed, feed_step;
    uint32_t pushed;
} s;

static void servo_feeds(void) {
    const int64_t bend = p.bend >> servo.bend_down, way = p.speed != 0 ? p.speed : bend;
    s.feed = ((p.speed >> (servo.speed_down + 1U)) * servo.path_gain >> 1) + (bend * servo.inertia >> 2);
    s.feed += way == 0 ? 0 : (way > 0 ? 256 : -256) * (int64_t)servo.gains.friction;
    s.feed_step = bend * servo.path_gain >> servo.bend_per_speed;
}

static void servo_observes(int32_t q) {
    const uint32_t position = (uint32_t)q * 256U, expected = s.predicted + (uint32_t)(s.velocity >> 8);
    const int64_t residual = (int32_t)(position - expected) >> 8; // Q8
    if (llabs(residual) > 128 * 256) {                            // it is elsewhere
        s.predicted = position;
        s.velocity = 0;
        return;
    }
    s.predicted = expected + (uint32_t)(residual * servo.alpha >> 7);
    s.velocity = within(s.velocity + residual * servo.beta, -servo.velocity_max, servo.velocity_max);
}

static int64_t servo_steps(int32_t q, int32_t limit) {
    servo_observes(q);
    const int64_t error = within((int64_t)path.q - q, -128 * 256, 128 * 256);
    int64_t sum = (s.feed >> 8) - ((s.velocity >> servo.speed_down) * servo.derivative >> 10);
    sum += (error * servo.proportional >> 8) + (s.integral >> 14);
    s.feed += s.feed_step;
    bool winds_up = false;
    if (llabs(sum) > limit) {
        s.pushed |= sum > 0 ? 1U : 2U;
        sum = sum > 0 ? limit : -limit;
        winds_up = (sum > 0) == (error > 0);
    }
    if (!winds_up && (path.speed != 0 || llabs(error) > 256)) { // within a count of a path that rests it is held
        const int64_t most = (int64_t)limit << 14;
        s.integral = within(s.integral + error * servo.integral_step, -most, most);
    }
    return sum;
}

static void check_servo(void) {
    TEST_ASSERT_EQUAL_UINT32(s.predicted, servo.predicted);
    TEST_ASSERT_EQUAL_INT64(s.velocity, servo.velocity);
    TEST_ASSERT_EQUAL_INT64(s.integral, servo.integral);
    TEST_ASSERT_EQUAL_INT64(s.feed, servo.feed);
    TEST_ASSERT_EQUAL_INT64(s.feed_step, servo.feed_step);
    TEST_ASSERT_EQUAL_UINT32(s.pushed, servo.pushed);
}

static void begin(int32_t q, uint32_t ticks) {
    tl_path_init(&path, q, ticks);
    TEST_ASSERT_EQUAL_INT32(q, path.q);
    TEST_ASSERT_TRUE(tl_path_rests(&path));
    servo.integral = servo.feed = servo.feed_step = servo.velocity = 77;
    servo.pushed = 3;
    tl_servo_reset(&servo, q);
    s.predicted = (uint32_t)q * 256U;
    s.velocity = s.integral = s.feed = s.feed_step = 0;
    s.pushed = 0;
    p.velocity = 0;
    check_servo();
}

static void live(void) {
    const uint32_t rate = any_gains(), ticks = rate / 1000U;
    int32_t q = any(27), limit = between(0, 32768), velocity = 0;
    begin(q, ticks);
    tl_reference_t reference = {.q = q};
    for (uint32_t tick = 0; tick < TICKS; tick++) {
        if (tick % ticks == 0U) {
            velocity = between(0, 6) == 0 ? any(27) : (between(0, 6) == 0 ? 0 : velocity);
            const uint32_t sum = reference.fraction + ((uint32_t)velocity & 0xFFFFU);
            reference.q += (velocity >> 16) + (int32_t)(sum >> 16);
            reference.fraction = sum & 0xFFFFU;
            reference.velocity = velocity;
            tl_path_begin(&path, &reference);
            path_begins(&reference, ticks);
            tl_servo_feed(&servo, &path);
            servo_feeds();
        }
        q = between(0, 3) == 0 ? path.q + any(between(0, 9) == 0 ? 18 : 10) : q;
        limit = between(0, 20) == 0 ? abs(any(15)) : limit;
        TEST_ASSERT_EQUAL_INT64(servo_steps(q, limit), tl_servo_step(&servo, q, &path, limit));
        check_servo();
        tl_path_tick(&path);
        path_ticks();
        if (between(0, 9) == 0) {
            servo.pushed = s.pushed = 0;
        }
    }
}

static void test_path_and_servo_are_their_model(void) {
    for (uint32_t i = 0; i < LIVES; i++) {
        live();
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_path_and_servo_are_their_model);
    return UNITY_END();
}
