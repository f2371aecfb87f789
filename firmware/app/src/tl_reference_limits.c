#include "tautline/tl_reference.h"

#define ACCELERATION_MAX (1 << 26) // counts/tick2 Q24: with four of them, and twice the greatest speed, below 2^31

tl_reference_limits_t tl_reference_limits(int32_t speed, int32_t acceleration, uint32_t rate_hz) {
    const int64_t rate = (int64_t)rate_hz;
    speed = tl_clamp(speed, 1, TL_REFERENCE_SPEED_MAX);
    acceleration = tl_clamp(acceleration, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    const int64_t per_tick = ((int64_t)speed << 16) / rate;
    const int64_t per_tick2 = ((int64_t)acceleration << 16) / (rate * rate);
    tl_reference_limits_t limits = {
        .speed = (int32_t)per_tick,
        .acceleration = per_tick2 > ACCELERATION_MAX ? ACCELERATION_MAX : (int32_t)per_tick2,
    };
    // A speed relative to the target's is at most twice the limit.
    while ((2 * (int64_t)limits.speed + limits.acceleration) >> limits.speed_down >= 32768) {
        limits.speed_down++;
    }
    limits.acceleration_scaled = limits.acceleration >> limits.speed_down;
    // v (v + a) / 2a, of speeds v 2^speed_down: 2^(2 speed_down - 25) / a in counts. As 2^(bits + 15) / a has 16 bits:
    uint32_t bits = 0;
    while (limits.acceleration >> bits != 0) {
        bits++;
    }
    limits.ratio = (uint32_t)(((uint64_t)1 << (bits + 15U)) / (uint32_t)limits.acceleration);
    const uint32_t down =
        24U + bits - 2U * limits.speed_down; // in counts it would lose this much, and so has it to spare
    limits.ratio_down = down > 16U ? down - 16U : 0U;
    limits.way_down = down > 16U ? 0U : 16U - down;
    const int64_t ticks = limits.speed / limits.acceleration + 2;
    const int64_t stop = (ticks * (limits.speed / 2 + 1)) >> 16;
    limits.stop = stop < INT32_MAX ? (int32_t)stop : INT32_MAX;
    return limits;
}
