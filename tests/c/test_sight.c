// An encoder that drops out while its motor turns, and a sound one that does not: motors with friction, load and a
// driver that cuts the current, by other equations than the fake board's, that are not quite what the gains say.
#include <math.h>

#include "fake_board.h"
#include "random_u32.h"

#ifndef SIGHT_STEPS
#define SIGHT_STEPS 2000000U // of sound motion
#endif
#define GONE_MOST  50.0  // counts, as docs/safety.md says,
#define GONE_SPEED 500   // from that many a second on
#define STATIC     150.0 // counts/s within which static friction falls to sliding friction
#define CHOPS      0.607 // of what full drive makes of a motor that stands

typedef enum { WELL, FROZEN, ONE_LINE } ill_t;

static struct {
    double free_speed, lag_s, sliding, sticking, load;
    double position, speed;
    ill_t ill;
    int32_t shown;
    int64_t at;
    int32_t zero;
} motor;

void setUp(void) {}
void tearDown(void) {}

static double uniform(double low, double high) {
    return low + (high - low) * (random_u32() / 4294967296.0);
}

static double log_uniform(double low, double high) {
    return exp(uniform(log(low), log(high)));
}

// Of the lines' states 00, 01, 11, 10: A.
static bool line_a(int64_t count) {
    return (count & 2) != 0;
}

static int32_t shown(void) {
    const int64_t count = (int64_t)floor(motor.position);
    if (motor.ill == WELL) {
        return (int32_t)count - motor.zero;
    }
    if (motor.ill == FROZEN || line_a(count) == line_a(motor.at)) {
        return motor.shown;
    }
    // B stands still, A has changed: a count, up or down by what B is.
    const bool up = line_a(motor.at + 1) != line_a(motor.at);
    return motor.shown + (up ? 1 : -1);
}

static void become(ill_t ill) {
    const int32_t now = shown();
    motor.ill = ill;
    motor.shown = now;
    motor.at = (int64_t)floor(motor.position);
    motor.zero = (int32_t)motor.at - now;
}

static int32_t encoder(void *context, uint8_t axis) {
    (void)context;
    (void)axis;
    return shown();
}

static void turn(double dt) {
    const double duty = fake.duty[0] / 32768.0, free = duty - motor.speed / motor.free_speed;
    const double drive = free > CHOPS ? CHOPS : (free < -CHOPS ? -CHOPS : free);
    if (motor.speed == 0.0 && fabs(duty - motor.load) <= motor.sticking) {
        return;
    }
    const double way = (motor.speed != 0.0 ? motor.speed : duty - motor.load) < 0.0 ? -1.0 : 1.0;
    const double rubs = motor.sliding + (motor.sticking - motor.sliding) * exp(-fabs(motor.speed) / STATIC);
    const double speed = motor.speed + (drive - motor.load - way * rubs) * motor.free_speed / motor.lag_s * dt;
    motor.speed = speed * way < 0.0 ? 0.0 : speed;
    motor.position += motor.speed * dt;
}

static uint32_t ticks;

static void step(void) {
    fake.t_us += 1000000U / FAKE_HZ;
    for (int part = 0; part < 8; part++) {
        turn(1.0 / FAKE_HZ / 8.0);
    }
    tl_app_control(&app);
    if (++ticks % (FAKE_HZ / 1000U) == 0U) {
        tl_app_task(&app);
    }
}

static void run_ms(double ms) {
    for (uint32_t i = (uint32_t)(ms * FAKE_HZ / 1000.0); i > 0U; i--) {
        step();
    }
}

// Holding, checked and referenced.
static void begin(void) {
    fake_new(1);
    motor.position = 0.5;
    motor.speed = motor.load = 0.0;
    motor.ill = WELL;
    motor.zero = 0;
    fake_port.encoder = encoder;
    app.axes[0].motor.encoder = shown();
    fake.current_ma = 100;
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    run_ms(20);
}

// The load goes there within a second, as it does not at once.
static void load_to(double load) {
    while (fabs(motor.load - load) > 1e-4) {
        motor.load += load > motor.load ? 1e-4 : -1e-4;
        step();
    }
}

static void move(double q, double speed_s, double acceleration_s2) {
    tl_wire_limits_t limits = app.axes[0].limits;
    limits.acceleration_q8_s2 = (int32_t)(acceleration_s2 * 256.0);
    (void)fake_ask(TL_WIRE_LIMITS, &limits); // of a motion that is under way as they were
    const tl_wire_move_t request = {
        .axis = 0, .q_q8 = (int32_t)(q * 256.0), .speed_q8_s = (int32_t)(speed_s * 256.0), .silence_us = 60000000U};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &request));
}

static void draw_motor(void) {
    motor.free_speed = uniform(15000.0, 22000.0); // the gains say 20 000 counts/s, 30 ms
    motor.lag_s = uniform(0.02, 0.04);
    motor.sliding = uniform(0.02, 0.05);
    motor.sticking = motor.sliding + uniform(0.0, 0.02);
}

// Stops and reversals as hard as the limits allow, at any speed, without a load, with one that is constant, and with
// one that grows with the way.
static void test_no_sound_motion_is_taken_for_a_dropout(void) {
    int32_t most = 0;
    for (uint32_t run = 0, from = ticks; ticks - from < SIGHT_STEPS; run++) {
        seed = run * 2654435761U + 7U;
        draw_motor();
        begin();
        const double stiffness = run % 3U == 1U ? uniform(-0.3, 0.3) / 2000.0 : 0.0;
        load_to(run % 3U == 2U ? uniform(-0.3, 0.3) : 0.0);
        for (int i = 0; i < 60; i++) {
            const double way = log_uniform(3.0, 3000.0);
            move(uniform(-way, way), log_uniform(300.0, 15000.0),
                 i % 2 == 0 ? 200000.0 : log_uniform(5000.0, 200000.0));
            for (uint32_t left = (uint32_t)uniform(50.0, 2000.0); left > 0U; left--) {
                const double load = stiffness * motor.position;
                motor.load = stiffness != 0.0 ? fmax(-0.4, fmin(0.4, load)) : motor.load;
                step();
                most = app.axes[0].motor.sight.must > most ? app.axes[0].motor.sight.must : most;
            }
            TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
            TEST_ASSERT_TRUE(app.axes[0].referenced);
        }
    }
    TEST_ASSERT_TRUE(most < TL_SIGHT_MOST * TL_COUNT_ONE * 2 / 3); // and not by a hair
    TEST_ASSERT_TRUE(most > TL_COUNT_ONE / 2);
}

// At constant speed: what it goes until the bridge is off, and the position then.
static void test_a_dropout_at_speed_is_fifty_counts_at_most(void) {
    for (int run = 0; run < 300; run++) {
        seed = (uint32_t)run * 2654435761U + 99U;
        draw_motor();
        begin();
        load_to(uniform(-0.2, 0.2));
        const double speed = run % 3 == 0 ? GONE_SPEED : log_uniform(GONE_SPEED, 12000.0);
        const double ends_ms = run % 5 == 0 ? 1e9 : uniform(60.0 * GONE_SPEED / speed + 5.0, 200.0);
        move(run % 2 == 0 ? 100000.0 : -100000.0, speed, 200000.0);
        run_ms(uniform(150.0, 200.0));
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
        const double from = motor.position;
        become(run % 4 < 2 ? FROZEN : ONE_LINE);
        for (double ms = 0.0; app.axes[0].fault == TL_WIRE_FAULT_NONE && ms < ends_ms; ms += 0.2) {
            step();
            TEST_ASSERT_TRUE(fabs(motor.position - from) <= GONE_MOST);
        }
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_STALL, app.axes[0].fault);
        TEST_ASSERT_FALSE(app.axes[0].referenced);
        TEST_ASSERT_EQUAL(0, fake.duty[0]);
        become(WELL);
        run_ms(200);
        TEST_ASSERT_TRUE(fabs(motor.speed) < 1.0 || fabs(motor.load) > motor.sliding); // which turns it
        TEST_ASSERT_FALSE(app.axes[0].referenced);
    }
}

// It shows a count to and fro, as a motor does that hardly turns: whatever trips at last, it is no position.
static void test_a_line_that_dies_at_any_speed_leaves_no_position(void) {
    for (int run = 0; run < 200; run++) {
        seed = (uint32_t)run * 2654435761U + 31U;
        draw_motor();
        begin();
        load_to(uniform(-0.2, 0.2));
        move(run % 2 == 0 ? 100000.0 : -100000.0, log_uniform(50.0, 12000.0), 200000.0);
        run_ms(uniform(150.0, 200.0));
        become(ONE_LINE);
        for (int ms = 0; app.axes[0].fault == TL_WIRE_FAULT_NONE && ms < 2000; ms++) {
            run_ms(1.0);
        }
        TEST_ASSERT_TRUE(app.axes[0].fault != TL_WIRE_FAULT_NONE);
        TEST_ASSERT_FALSE(app.axes[0].referenced);
    }
}

static void test_a_dropout_while_it_runs_down_leaves_no_position(void) {
    for (int run = 0; run < 100; run++) {
        seed = (uint32_t)run * 2654435761U + 5U;
        draw_motor();
        begin();
        move(100000.0, uniform(3000.0, 12000.0), 200000.0);
        run_ms(200);
        const tl_wire_safe_stop_t stop = {.axis = 0};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &stop));
        if (run % 4 != 3) {
            run_ms(uniform(0.0, 10.0));
            become(run % 2 == 0 ? FROZEN : ONE_LINE);
        }
        const double from = motor.position;
        run_ms(200);
        const bool far = fabs(motor.position - from) > GONE_MOST && motor.ill != WELL;
        TEST_ASSERT_TRUE(!far || !app.axes[0].referenced);
        TEST_ASSERT_TRUE(motor.ill != WELL || app.axes[0].referenced);
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_STOPPED, app.axes[0].fault);
    }
}

// Nothing overflows (UBSan): settings may say any gains, and an encoder may show anything.
static void test_any_gains_and_any_encoder(void) {
    for (uint32_t run = 0; run < 2000; run++) {
        seed = run * 2654435761U + 3U;
        const tl_servo_gains_t gains = {.inertia = (int32_t)log_uniform(1.0, 32767.9),
                                        .feed_forward = (int32_t)log_uniform(1.0, 32767.9)};
        tl_sight_t sight = {.gain = 0};
        tl_sight_configure(&sight, &gains);
        tl_sight_reset(&sight, 0);
        const int32_t most = (int32_t)log_uniform(1.0, 2048.0 * 256.0);
        int32_t q = 0, way = 0, duty = 0;
        for (int ms = 0; ms < 300; ms++) {
            way = ms % 20 == 0 ? (int32_t)uniform(-most, most) : way;
            duty = ms % 30 == 0 ? (int32_t)uniform(-32768.0, 32768.0) : duty;
            q += ms % 50 < 40 ? way : 0;
            (void)tl_sight_step(&sight, q, duty);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_no_sound_motion_is_taken_for_a_dropout);
    RUN_TEST(test_a_dropout_at_speed_is_fifty_counts_at_most);
    RUN_TEST(test_a_line_that_dies_at_any_speed_leaves_no_position);
    RUN_TEST(test_a_dropout_while_it_runs_down_leaves_no_position);
    RUN_TEST(test_any_gains_and_any_encoder);
    return UNITY_END();
}
