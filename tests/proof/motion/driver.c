#include "__fc_builtin.h"

#include "../../../firmware/estimator/src/tl_motion.c"

#define ANY()   Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define PLACE() Frama_C_long_long_interval(-((int64_t)1 << 54), (int64_t)1 << 54)

static tl_motion_t motion;
static tl_motion_config_t config;

static void start(void) {
    config.low = ANY();
    config.high = ANY();
    config.speed_count = (uint8_t)Frama_C_unsigned_int_interval(0, UINT8_MAX);
    config.cycles = (uint8_t)Frama_C_unsigned_int_interval(0, UINT8_MAX);
    config.transit = ANY();
    config.acceleration = ANY();
    config.approach = ANY();
    config.stroke_max = ANY();
    config.host_timeout_us = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    config.rate_hz = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    //@ loop unroll 4;
    for (unsigned i = 0; i < TL_MOTION_SPEEDS; i++) {
        config.speed[i] = ANY();
    }
    Frama_C_make_unknown((char *)&motion, sizeof motion);
    tl_motion_start(&motion, &config, ANY());
}

static int64_t any_speed(void) {
    return Frama_C_long_long_interval(0, SPEED_MAX);
}

// Any that a start and ticks can leave with such an acceleration: the larger it is, the fewer steps there are.
static void any_motion(int64_t least, int64_t largest) {
    const int64_t quickest = SPEED_MAX / least + 1;
    const uint32_t most = (uint32_t)(quickest < STEPS_MAX ? quickest : STEPS_MAX);
    motion.config.low = Frama_C_int_interval(-POSITION_MAX, POSITION_MAX);
    motion.config.high = Frama_C_int_interval(-POSITION_MAX, POSITION_MAX);
    motion.config.approach = Frama_C_int_interval(TL_COUNT_ONE, POSITION_MAX / 2);
    motion.config.stroke_max = Frama_C_int_interval(2 * TL_COUNT_ONE, POSITION_MAX);
    motion.config.speed_count = (uint8_t)Frama_C_unsigned_int_interval(1, TL_MOTION_SPEEDS);
    motion.config.cycles = (uint8_t)Frama_C_unsigned_int_interval(1, 100);
    motion.config.rate_hz = Frama_C_unsigned_int_interval(1000, 10000);
    motion.position = PLACE();
    motion.target = PLACE();
    motion.began = PLACE();
    motion.first = PLACE();
    motion.half_step = Frama_C_long_long_interval(0, (int64_t)1 << 54);
    motion.half_step_share = Frama_C_unsigned_int_interval(0, UINT32_MAX / 2U);
    motion.speed = any_speed();
    motion.transit = any_speed();
    motion.acceleration = Frama_C_long_long_interval(least, largest);
    motion.steps = Frama_C_unsigned_int_interval(0, most);
    //@ loop unroll 4;
    for (unsigned i = 0; i < TL_MOTION_SPEEDS; i++) {
        motion.measuring[i] = any_speed();
        motion.measuring_steps[i] = Frama_C_unsigned_int_interval(0, most);
    }
    motion.quiet_ticks = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    motion.timeout_ticks = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    motion.pass = (uint8_t)Frama_C_unsigned_int_interval(0, 2U * TL_MOTION_SPEEDS - 1U);
    motion.leg = (uint8_t)Frama_C_unsigned_int_interval(0, 200);
    motion.direction = (int8_t)Frama_C_nondet(-1, 1);
    motion.phase = (uint8_t)Frama_C_unsigned_int_interval(PREPARING, TRAVELLING);
    motion.state = (uint8_t)Frama_C_unsigned_int_interval(TL_MOTION_IDLE, TL_MOTION_HOST_LOST);
    motion.ends_as = (uint8_t)Frama_C_unsigned_int_interval(TL_MOTION_IDLE, TL_MOTION_HOST_LOST);
}

static void tick(int64_t least, int64_t largest) {
    any_motion(least, largest);
    tl_motion_tick(&motion);
    any_motion(least, largest);
    tl_motion_onset(&motion, (int8_t)Frama_C_int_interval(INT8_MIN, INT8_MAX));
    tl_motion_frame(&motion);
    tl_motion_stop(&motion);
    tl_motion_state(&motion);
    tl_motion_progress(&motion);
}

int main(void) {
    start();
    tick(RESOLUTION, (int64_t)1 << 20);
    tick((int64_t)1 << 20, (int64_t)1 << 24);
    tick((int64_t)1 << 24, (int64_t)1 << 30);
    tick((int64_t)1 << 30, (int64_t)1 << 36); // of 2^31 Q8 counts/s^2 at 1000 Hz: 2^55 / 10^6
    return 0;
}
