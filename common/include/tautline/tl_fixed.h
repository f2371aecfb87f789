/// Fixed-point types and arithmetic shared by board and host.
///
/// A type's name holds its unit and its Q-format: tl_count_q8_t is encoder counts with 8 fractional bits.
/// Every operation here saturates; none has undefined behaviour for any input. All are O(1), need no
/// 64-bit multiplication or division, and are safe from any context.
#ifndef TAUTLINE_TL_FIXED_H
#define TAUTLINE_TL_FIXED_H

#include <stdbool.h>
#include <stdint.h>

#include "tautline/tl_fast.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef int32_t tl_count_q8_t;  ///< motor position or width: encoder counts, Q23.8: +-8.3 M counts, 1/256 count
typedef int32_t tl_deg_q16_t;   ///< configuration (bending angle): degrees, Q15.16: +-32768 deg, 15 udeg
typedef int32_t tl_px_q12_t;    ///< image position: pixels, Q19.12: +-524288 px, 0.25 mpx
typedef int32_t tl_ratio_q15_t; ///< dimensionless, Q16.15; 32768 is 1
typedef int32_t tl_duty_q15_t;  ///< motor drive, -32768 (full reverse) to 32768 (full forward)
typedef uint64_t tl_us_t;       ///< time since the board's start, microseconds

#define TL_COUNT_ONE ((tl_count_q8_t)1 << 8)
#define TL_DEG_ONE   ((tl_deg_q16_t)1 << 16)
#define TL_PX_ONE    ((tl_px_q12_t)1 << 12)
#define TL_RATIO_ONE ((tl_ratio_q15_t)1 << 15)

/// a + b, held at the ends of int32_t where it would leave them.
static inline TL_FAST int32_t tl_add_sat(int32_t a, int32_t b) {
    const uint32_t sum = (uint32_t)a + (uint32_t)b;
    const uint32_t overflow = ~((uint32_t)a ^ (uint32_t)b) & ((uint32_t)a ^ sum);
    if (overflow >> 31) {
        return a < 0 ? INT32_MIN : INT32_MAX;
    }
    return (int32_t)sum;
}

/// a - b, held likewise.
static inline TL_FAST int32_t tl_sub_sat(int32_t a, int32_t b) {
    const uint32_t difference = (uint32_t)a - (uint32_t)b;
    const uint32_t overflow = ((uint32_t)a ^ (uint32_t)b) & ((uint32_t)a ^ difference);
    if (overflow >> 31) {
        return a < 0 ? INT32_MIN : INT32_MAX;
    }
    return (int32_t)difference;
}

/// x within [low, high]; low must not be above high.
static inline TL_FAST int32_t tl_clamp(int32_t x, int32_t low, int32_t high) {
    return x < low ? low : (x > high ? high : x);
}

/// |x|; INT32_MAX for INT32_MIN.
static inline int32_t tl_abs_sat(int32_t x) {
    return x == INT32_MIN ? INT32_MAX : (x < 0 ? -x : x);
}

/// Upper half of the 64-bit product, by four 16-bit ones: exact, about 17 cycles on a Cortex-M0+.
static inline TL_FAST uint32_t tl_mul_high(uint32_t a, uint32_t b) {
    const uint32_t a0 = a & 0xFFFFU, a1 = a >> 16, b0 = b & 0xFFFFU, b1 = b >> 16;
    const uint32_t low = a1 * b0 + (a0 * b0 >> 16); // at most 0xFFFE0001 + 0xFFFE: no carry is lost
    const uint32_t middle = a0 * b1 + (low & 0xFFFFU);
    return a1 * b1 + (low >> 16) + (middle >> 16);
}

/// a * factor, factor < 2^16, modulo 2^64. Three products, about 12 cycles.
static inline TL_FAST int64_t tl_times(int64_t a, uint32_t factor) {
    const uint32_t low = (uint32_t)a, high = (uint32_t)((uint64_t)a >> 32);
    const uint32_t first = (low & 0xFFFFU) * factor, second = (low >> 16) * factor + (first >> 16);
    return (int64_t)((uint64_t)(high * factor + (second >> 16)) << 32 | (second << 16 | (first & 0xFFFFU)));
}

/// a + (b - a) t / 2^16, t < 2^16, rounded to nearest. Two products. b - a must not overflow.
static inline TL_FAST int32_t tl_lerp(int32_t a, int32_t b, uint32_t t) {
    const int32_t difference = b - a;
    const uint32_t low = ((uint32_t)difference & 0xFFFFU) * t + 0x8000U;
    return a + (difference >> 16) * (int32_t)t + (int32_t)(low >> 16);
}

/// a + (b - a) t / 2^log2, t < 2^log2, 16 < log2 < 24, within 1/2 + 1/256 of it. Three products. b - a must not
/// overflow.
int32_t tl_lerp_fine(int32_t a, int32_t b, uint32_t t, unsigned log2);

/// A positive ratio numerator/denominator kept for multiplying: mantissa * 2^(shift - 32), 2^31 <= mantissa.
typedef struct {
    uint32_t mantissa;
    int8_t shift;
} tl_scale_t;

/// The ratio to 2^-32 of itself. Both at least 1 and below 2^31. One 64-bit division: for load time.
tl_scale_t tl_scale_of(uint32_t numerator, uint32_t denominator);

/// x * ratio, rounded down, for x < 2^31 and a result below 2^31 (the caller sees to that). No division.
static inline TL_FAST uint32_t tl_scale(uint32_t x, tl_scale_t ratio) {
    return ratio.shift >= 0 ? tl_mul_high(x << ratio.shift, ratio.mantissa)
                            : tl_mul_high(x, ratio.mantissa) >> -ratio.shift;
}

#ifdef __cplusplus
}
#endif

#endif
