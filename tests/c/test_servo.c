// The servo and its reference against their equations (tl_servo.h, tl_reference.h) in float64.
#include "tautline/tl_servo.h"

#include <math.h>
#include <unity.h>

void setUp(void) {}
void tearDown(void) {}

static const uint32_t rates[] = {1000, 2000, 5000, 10000};
enum { RATES = sizeof rates / sizeof rates[0] };

static tl_servo_t servo;
static tl_servo_gains_t gains;

static void begin(uint32_t rate) {
    TEST_ASSERT_TRUE(tl_servo_configure(&servo, &gains, rate));
    tl_servo_reset(&servo, 0);
}

static void near(double expected, double got, double absolute, const char *what) {
    TEST_ASSERT_DOUBLE_WITHIN_MESSAGE(absolute, expected, got, what);
}

// A path at a steady speed (counts/s) and acceleration (counts/s^2), and a motor that stands at `q`.
static tl_duty_q15_t drive(uint32_t rate, double speed, double acceleration, tl_count_q8_t error) {
    const tl_path_t path = {.q = error,
                            .speed = (int32_t)lround(ldexp(speed / rate, 24)),
                            .bend = (int32_t)lround(ldexp(acceleration / rate / rate, 24))};
    tl_servo_feed(&servo, &path);
    return tl_servo_step(&servo, 0, &path, 32768);
}

static void test_each_gain_is_what_its_unit_says(void) {
    for (unsigned i = 0; i < RATES; i++) {
        const uint32_t rate = rates[i];
        gains = (tl_servo_gains_t){.proportional = 321};
        begin(rate);
        near(321.0 * 5.5, drive(rate, 0.0, 0.0, 5 * 256 + 128), 1.0, "proportional, per count");
        near(-321.0 * 5.5, drive(rate, 0.0, 0.0, -5 * 256 - 128), 1.0, "either way");
        gains = (tl_servo_gains_t){.feed_forward = 1234};
        begin(rate);
        near(1234.0 * 7.0, drive(rate, 7000.0, 0.0, 0), 8.0, "feed-forward, per 1000 counts/s");
        near(-1234.0 * 7.0, drive(rate, -7000.0, 0.0, 0), 8.0, "either way");
        gains = (tl_servo_gains_t){.derivative = 987};
        begin(rate);
        near(987.0 * 6.0, drive(rate, 6000.0, 0.0, 0), 8.0, "derivative, of a motor that stands");
        gains = (tl_servo_gains_t){.inertia = 4321};
        begin(rate);
        near(4321.0 * 1.5, drive(rate, 0.0, 150000.0, 0), 4321.0 * 1.5 * 0.003, "inertia, per 100000 counts/s^2");
        near(-4321.0 * 1.5, drive(rate, 0.0, -150000.0, 0), 4321.0 * 1.5 * 0.003, "either way");
        gains = (tl_servo_gains_t){.friction = 777};
        begin(rate);
        near(777.0, drive(rate, 1000.0, 0.0, 0), 0.0, "friction, with the motion");
        near(-777.0, drive(rate, -1000.0, 0.0, 0), 1.0, "against it");
        near(777.0, drive(rate, 0.0, 100000.0, 0), 0.0, "setting off");
        near(-777.0, drive(rate, 0.0, -100000.0, 0), 1.0, "and back");
        near(0.0, drive(rate, 0.0, 0.0, 0), 0.0, "none at rest");
        gains = (tl_servo_gains_t){.integral = 5000};
        begin(rate);
        for (uint32_t tick = 0; tick < rate / 10U; tick++) {
            drive(rate, 0.0, 0.0, 3 * 256);
        }
        near(5000.0 * 3.0 * 0.1, drive(rate, 0.0, 0.0, 3 * 256), 5000.0 * 3.0 * 0.1 * 0.003,
             "integral, per count and s");
    }
}

static void test_gains_are_from_0_to_their_most(void) {
    int32_t *const all[] = {&gains.proportional, &gains.integral, &gains.derivative,
                            &gains.feed_forward, &gains.inertia,  &gains.friction};
    for (unsigned i = 0; i < sizeof all / sizeof all[0]; i++) {
        gains = (tl_servo_gains_t){0};
        *all[i] = 32767;
        TEST_ASSERT_TRUE(tl_servo_configure(&servo, &gains, 5000));
        *all[i] = 32768;
        TEST_ASSERT_FALSE(tl_servo_configure(&servo, &gains, 5000));
        *all[i] = -1;
        TEST_ASSERT_FALSE(tl_servo_configure(&servo, &gains, 5000));
    }
}

static void test_what_the_path_asks_for_goes_on_with_its_acceleration(void) {
    gains = (tl_servo_gains_t){.feed_forward = 2000, .derivative = 500};
    const double speed = 3000.0, acceleration = 200000.0;
    begin(5000);
    const tl_path_t path = {
        .q = 0, .speed = (int32_t)ldexp(speed / 5000, 24), .bend = (int32_t)ldexp(acceleration / 25e6, 24)};
    tl_servo_feed(&servo, &path);
    for (int tick = 0; tick < 5; tick++) { // of a millisecond
        const double now = speed + acceleration * tick / 5000.0;
        near(2.5 * now, tl_servo_step(&servo, 0, &path, 32768), 12.0, "duty of the speed then");
    }
}

// Critically damped at TL_SERVO_FILTER_HZ: a jump of speed is followed as 1 - (1 + omega t) e^(-omega t).
static void test_the_speed_is_filtered_as_the_header_says(void) {
    gains = (tl_servo_gains_t){0};
    const double omega = 2.0 * 3.14159265358979 * TL_SERVO_FILTER_HZ, speed = 4000.0;
    for (unsigned i = 1; i < RATES; i++) {
        begin(rates[i]);
        for (uint32_t tick = 1; tick < rates[i] / 50U; tick++) {
            const double t = (double)tick / rates[i];
            tl_servo_observe(&servo, (int32_t)lround(speed * t * 256.0));
            const double expected = speed * (1.0 - (1.0 + omega * t) * exp(-omega * t));
            const double lag = speed * omega * 2.0 / rates[i]; // two ticks of its steepest
            near(expected, ldexp(servo.velocity, -24) * rates[i], lag, "speed");
        }
    }
}

static void test_an_encoder_that_is_elsewhere_is_no_speed(void) {
    gains = (tl_servo_gains_t){0};
    begin(5000);
    tl_servo_observe(&servo, TL_SERVO_ERROR_MAX);
    TEST_ASSERT_TRUE(servo.velocity > 0); // as far as this it may have gone
    const int32_t went = servo.velocity;
    begin(5000);
    tl_servo_observe(&servo, -TL_SERVO_ERROR_MAX);
    TEST_ASSERT_EQUAL_INT32(-went, servo.velocity);
    for (int way = -1; way <= 1; way += 2) {
        begin(5000);
        tl_servo_observe(&servo, way * (TL_SERVO_ERROR_MAX + 1));
        TEST_ASSERT_EQUAL_INT32(0, servo.velocity);
        TEST_ASSERT_EQUAL_UINT32((uint32_t)(way * (TL_SERVO_ERROR_MAX + 1)) << 8, servo.predicted);
    }
}

static void test_drive_at_its_limit_is_told_and_winds_nothing_up(void) {
    gains = (tl_servo_gains_t){.proportional = 1000, .integral = 30000};
    begin(5000);
    const tl_path_t ahead = {.q = 100 * 256}, behind = {.q = -100 * 256}, near_by = {.q = 256}, past = {.q = 257};
    for (int i = 0; i < 100; i++) {
        TEST_ASSERT_EQUAL_INT32(9000, tl_servo_step(&servo, 0, &ahead, 9000));
    }
    TEST_ASSERT_EQUAL_UINT32(1, servo.pushed);
    TEST_ASSERT_EQUAL_INT32(0, servo.integral);
    TEST_ASSERT_EQUAL_INT32(-9000, tl_servo_step(&servo, 0, &behind, 9000));
    TEST_ASSERT_EQUAL_UINT32(3, servo.pushed);
    TEST_ASSERT_EQUAL_INT32(0, servo.integral);
    tl_servo_step(&servo, 0, &near_by, 9000); // at rest within a count it stays
    TEST_ASSERT_EQUAL_INT32(0, servo.integral);
    tl_servo_step(&servo, 0, &past, 9000);
    TEST_ASSERT_EQUAL_INT32(257 * (30000 * 64 / 5000), servo.integral);
    gains = (tl_servo_gains_t){.integral = 32767};
    begin(1000);
    for (int i = 0; i < 3000; i++) {
        tl_servo_step(&servo, 0, &ahead, 500);
    }
    TEST_ASSERT_TRUE(servo.integral <= 500 << 14); // never more than drives at the limit by itself
    TEST_ASSERT_INT32_WITHIN(1, 500, tl_servo_step(&servo, 0, &ahead, 500));
}

// -- the reference's limits ------------------------------------------------------------------------------------------

static void test_limits_in_ticks_are_those_in_seconds(void) {
    static const int32_t speeds[] = {1, 255, 256, 100000, 1234567, TL_REFERENCE_SPEED_MAX};
    static const int32_t accelerations[] = {TL_REFERENCE_ACCELERATION_MIN, 1000000, 51200000, 60000000};
    for (unsigned i = 0; i < sizeof speeds / sizeof speeds[0]; i++) {
        for (unsigned j = 0; j < sizeof accelerations / sizeof accelerations[0]; j++) {
            const double speed = speeds[i], acceleration = accelerations[j], rate = 1000.0;
            const tl_reference_limits_t limits = tl_reference_limits(speeds[i], accelerations[j], 1000);
            near(speed / rate * 65536.0, limits.speed, 1.0, "speed");
            near(acceleration / rate / rate * 65536.0, limits.acceleration, 1.0, "acceleration");
            TEST_ASSERT_TRUE((2LL * limits.speed + limits.acceleration) >> limits.speed_down < 32768); // 15 bits
            TEST_ASSERT_TRUE(limits.speed_down == 0 ||
                             (2LL * limits.speed + limits.acceleration) >> (limits.speed_down - 1U) >= 32768);
            const double v = limits.speed / 65536.0, a = limits.acceleration / 65536.0; // Q8 counts a tick
            const double least = v * (v / a + 1.0) / 2.0;
            TEST_ASSERT_TRUE(limits.stop >= (int32_t)least && limits.stop <= least + 3.0 * v + 2.0);
        }
    }
    for (uint32_t rate = 1000; rate <= 50000; rate += 7000) {
        near(1234567.0 / rate * 65536.0, tl_reference_speed(1234567, rate), 1.0, "speed, of any rate");
    }
    TEST_ASSERT_EQUAL_INT32(tl_reference_speed(1, 1000), tl_reference_speed(-5, 1000));
    TEST_ASSERT_EQUAL_INT32(tl_reference_speed(TL_REFERENCE_SPEED_MAX, 1000), tl_reference_speed(INT32_MAX, 1000));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_gain_is_what_its_unit_says);
    RUN_TEST(test_gains_are_from_0_to_their_most);
    RUN_TEST(test_what_the_path_asks_for_goes_on_with_its_acceleration);
    RUN_TEST(test_the_speed_is_filtered_as_the_header_says);
    RUN_TEST(test_an_encoder_that_is_elsewhere_is_no_speed);
    RUN_TEST(test_drive_at_its_limit_is_told_and_winds_nothing_up);
    RUN_TEST(test_limits_in_ticks_are_those_in_seconds);
    return UNITY_END();
}
