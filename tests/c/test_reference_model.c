// A step of the reference, to the last bit: what tl_reference.h says in 64-bit numbers, from any state, at any limits;
// and the limits themselves against v^2 / 2a.
#include "draws.h"
#include "tautline/tl_reference.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define LIVES 10000
#define TICKS 60
#define FAR   ((int64_t)1 << 22) // 16384 counts: farther is as that

static tl_reference_t reference;
static tl_reference_limits_t limits;
static uint32_t ways[6]; // taken: followed, in two ticks, stopped before an end, braked, held its speed, faster

void setUp(void) {
    seed = 161803U;
}
void tearDown(void) {}

static void any_limits(void) {
    const int32_t speed = between(0, 3) == 0 ? TL_REFERENCE_SPEED_MAX - between(0, 9) : abs(any(23)) + 1;
    const int32_t acceleration = between(0, 9) == 0 ? between(0, 1) * TL_REFERENCE_ACCELERATION_MAX
                                                    : TL_REFERENCE_ACCELERATION_MIN + abs(any(30));
    limits = tl_reference_limits(speed, acceleration, between(0, 1) == 0 ? 1000U : 5000U);
}

// -- limits -----------------------------------------------------------------------------------------------------------

static void test_what_stopping_takes_is_v_squared_by_2_a(void) {
    for (uint32_t i = 0; i < 40000U; i++) {
        any_limits();
        const double a = limits.acceleration, v = limits.speed;
        // A relative speed is twice the limit at most: the fewest bits that leave 15 of it and a tick more.
        const uint32_t down = limits.speed_down;
        TEST_ASSERT_TRUE((2.0 * v + a) / ldexp(1.0, (int)down) < 32768.0);
        TEST_ASSERT_TRUE(down == 0U || floor((2.0 * v + a) / ldexp(1.0, (int)down - 1)) >= 32768.0);
        TEST_ASSERT_EQUAL_INT32((int32_t)floor(a / ldexp(1.0, (int)down)), limits.acceleration_scaled);
        // v (v + a) / 2a of such speeds, Q24, in Q16 less way_down bits.
        const double unit = ldexp(1.0, 2 * (int)down - 9 - (int)limits.way_down) / a;
        const double ratio = limits.ratio / ldexp(1.0, 16 + (int)limits.ratio_down);
        TEST_ASSERT_TRUE(ratio > unit && ratio <= unit * (1.0 + 1.0 / 32768.0)); // never too little, to 16 bits
        TEST_ASSERT_TRUE(limits.ratio > 32768U && limits.ratio <= 65537U);
        TEST_ASSERT_TRUE(limits.way_down == 0U || limits.ratio_down == 0U); // no more than it must
        // Ticks are whole: a / 8 more, and three units for what is cut off.
        TEST_ASSERT_EQUAL_INT32((int32_t)floor(a / ldexp(1.0, 11 + (int)limits.way_down)) + 3, limits.whole_ticks);
        const double stop = (floor(v / a) + 2.0) * (floor(v / 2.0) + 1.0) / 65536.0;
        TEST_ASSERT_EQUAL_INT32((int32_t)fmin(floor(stop), INT32_MAX), limits.stop);
    }
}

// -- a step -----------------------------------------------------------------------------------------------------------

static int64_t stopping(int64_t speed) {                                // Q16 less way_down bits
    const int64_t v = within(speed >> limits.speed_down, 0, 65535) + 1; // of more it brakes, whatever this is
    const int64_t product = v * (v + limits.acceleration_scaled + 1);
    return ((product * limits.ratio) >> (16U + limits.ratio_down)) + limits.whole_ticks;
}

// A speed, Q24, that has `a` less, or none.
static int64_t braked(int64_t speed) {
    const int64_t a = limits.acceleration;
    return speed > a ? speed - a : (speed < -a ? speed + a : 0);
}

// Towards a way in front, Q16.
static int64_t towards(int64_t speed, int64_t way) {
    const int64_t a = limits.acceleration;
    if (speed <= 0) {
        return (speed + a) >> 8 > way ? way * 256 : speed + a;
    }
    const int64_t spare = (way >> limits.way_down) - stopping(speed);
    const bool faster = spare > (speed + a) >> (8U + limits.way_down);
    ways[spare < 0 ? 3 : (faster ? 5 : 4)]++;
    return spare < 0 ? (speed > a ? speed - a : 0) : (faster ? speed + a : speed);
}

static int64_t catches_up(int64_t target_speed, int64_t apart) {
    const int64_t a = limits.acceleration, most = limits.speed, before = reference.velocity;
    const int64_t ahead =
        target_speed > 0 ? (int64_t)reference.high - reference.q : (int64_t)reference.q - reference.low;
    const int64_t goes = ahead <= limits.stop ? 0 : target_speed; // it will have to stop at that end
    const int64_t way = within(apart, -FAR, FAR) * 256 - (reference.fraction >> 8) - (goes >> 8);
    const int64_t velocity = goes + (way >= 0 ? towards(before - goes, way) : -towards(goes - before, -way));
    // Where the limit was lowered meanwhile, as fast down to it as may be.
    return within(velocity, before + a < -most ? before + a : -most, before - a > most ? before - a : most);
}

// No faster than can be stopped before the end.
static int64_t held_by_the_end(int64_t velocity) {
    const bool up = velocity > 0;
    const int64_t room = up ? (int64_t)reference.high - reference.q : (int64_t)reference.q - reference.low;
    const int64_t fraction = reference.fraction >> 8, speed = llabs(velocity);
    const int64_t room_q16 = within(room, -FAR, FAR) * 256 + (up ? -fraction : fraction + 1);
    const bool fits =
        speed > limits.acceleration ? stopping(speed) <= room_q16 >> limits.way_down : speed >> 8 <= room_q16;
    if (velocity == 0 || room > limits.stop || fits) {
        return velocity;
    }
    ways[2]++;
    const int64_t slower = braked(reference.velocity);
    return (slower > 0) == up ? slower : 0;
}

static int64_t steps(tl_count_q8_t wanted, bool *behind, bool *clamped) {
    const int64_t target = within(wanted, reference.low, reference.high), a = limits.acceleration;
    const int64_t most_q8 = limits.speed >> 16, apart = target - reference.q, before = reference.velocity;
    const int64_t target_speed = within(target - reference.target, -most_q8, most_q8) * 65536;
    *clamped = target != wanted;
    *behind = true;
    if (llabs(apart) < 64 * 256) {
        const int64_t distance = apart * 65536 - reference.fraction, lag = distance - target_speed;
        const int64_t half = target_speed + (lag >> 1);
        const bool at_once = llabs(lag) <= a && llabs(distance - before) <= a;
        const bool in_two = llabs(lag) <= 2 * a && llabs(half - before) <= a;
        if (at_once || in_two) {
            ways[at_once ? 0 : 1]++;
            const int64_t velocity = within(at_once ? distance : half, -limits.speed, limits.speed);
            *behind = llabs(distance - velocity) > 1 << 24; // a count
            return held_by_the_end(velocity);
        }
    }
    return catches_up(target_speed, apart);
}

static void begin(void) {
    any_limits();
    const int32_t middle = any(28), stop = limits.stop < 1 << 25 ? limits.stop : 1 << 25; // often hardly room to stop
    const int32_t room = between(0, 1) == 0 ? stop / 4 * between(1, 9) + 1 : abs(any(26)) + 1;
    reference = (tl_reference_t){.low = middle - room, .high = middle + room};
    tl_reference_set(&reference, middle + between(-room, room));
    reference.fraction = (uint32_t)between(0, 65535);
    reference.velocity = between(0, 2) == 0 ? 0 : between(-limits.speed, limits.speed);
    reference.velocity = between(0, 9) == 0 ? any(27) : reference.velocity;
}

// Where a sender may be: near, at an end, as far as a few ticks lead, anywhere.
static tl_count_q8_t place(tl_count_q8_t last, int32_t speed) {
    switch (between(0, 5)) {
    case 0:
        return reference.q + any(10);
    case 1:
        return (between(0, 1) == 0 ? reference.low : reference.high) + any(6);
    case 2:
        return reference.q + between(-100, 100) * (limits.speed >> 20);
    case 3:
        return between(reference.low, reference.high);
    default:
        return last + speed;
    }
}

static void test_a_step_is_its_model(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        begin();
        tl_count_q8_t wanted = reference.q;
        int32_t speed = between(0, 2) == 0 ? between(-1, 1) * (limits.speed >> 16) : 0; // to an end, at full speed
        reference.velocity = speed != 0 && between(0, 1) == 0 ? speed * 65536 : reference.velocity;
        for (uint32_t tick = 0; tick < TICKS; tick++) {
            speed = between(0, 15) == 0 ? between(-1, 1) * (limits.speed >> 16) * between(0, 40) / 32 : speed;
            wanted = between(0, 9) == 0 ? place(wanted, speed) : wanted + speed;
            wanted = (tl_count_q8_t)within(wanted, -(1 << 29), 1 << 29);
            bool behind, clamped;
            const int64_t velocity = steps(wanted, &behind, &clamped);
            const int64_t at = (int64_t)reference.q * 65536 + reference.fraction + velocity;
            tl_reference_step(&reference, wanted, &limits);
            TEST_ASSERT_EQUAL_INT64(velocity, reference.velocity);
            TEST_ASSERT_EQUAL_INT64(at, (int64_t)reference.q * 65536 + reference.fraction);
            TEST_ASSERT_TRUE(reference.fraction < 65536U);
            TEST_ASSERT_EQUAL(behind, reference.behind);
            TEST_ASSERT_EQUAL(clamped, reference.clamped);
            TEST_ASSERT_EQUAL_INT64(within(wanted, reference.low, reference.high), reference.target);
            TEST_ASSERT_EQUAL_INT64((at + 32768) >> 16, tl_reference_q(&reference));
        }
    }
    for (uint32_t i = 0; i < 6U; i++) {
        TEST_ASSERT_TRUE(ways[i] > 100U);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_what_stopping_takes_is_v_squared_by_2_a);
    RUN_TEST(test_a_step_is_its_model);
    return UNITY_END();
}
