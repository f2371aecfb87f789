// Whatever is changed while a compensator leads, with all that tables undo: the motor's goal never jumps, nor leaves
// the range.
#include <stdint.h>

static uint32_t seed;

static int32_t between(int32_t low, int32_t high) {
    seed = seed * 1664525U + 1013904223U;
    return low + (int32_t)((seed >> 8) % (uint32_t)(high - low + 1));
}

#include "ride.h"

#include <stdio.h>
#include <unity.h>

#define RIDES 300
#define TICKS 4000

void setUp(void) {}
void tearDown(void) {}

static void test_nothing_that_is_changed_makes_the_goal_jump_or_leave_the_range(void) {
    for (uint32_t ride = 1; ride <= RIDES; ride++) {
        seed = ride;
        ride_start(TABLES);
        for (int tick = 0; tick < TICKS; tick++) {
            const ride_tick_t now = ride_tick();
            char text[80];
            (void)snprintf(text, sizeof(text), "%d/256 counts in ride %u, tick %d", (int)now.step, (unsigned)ride,
                           tick);
            TEST_ASSERT_TRUE_MESSAGE(now.step <= STEP_MOST, text);
            TEST_ASSERT_TRUE_MESSAGE(now.inside, text);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_nothing_that_is_changed_makes_the_goal_jump_or_leave_the_range);
    return UNITY_END();
}
