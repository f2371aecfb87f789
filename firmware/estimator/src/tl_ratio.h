/// Fractions without a division: a small reciprocal, an estimate by it, and what is then left by it again.
#ifndef TAUTLINE_TL_RATIO_H
#define TAUTLINE_TL_RATIO_H

#include "tautline/tl_fast.h"
#include "tautline/tl_fixed.h"

#define TL_RATIO_BITS 20U ///< to which the whole is scaled

static inline TL_FAST uint32_t tl_bits(uint32_t x) {
    uint32_t bits = 0;
    if (x >> 16 != 0U) {
        bits = 16U;
        x >>= 16;
    }
    if (x >> 8 != 0U) {
        bits += 8U;
        x >>= 8;
    }
    if (x >> 4 != 0U) {
        bits += 4U;
        x >>= 4;
    }
    return bits + (x >= 8U ? 4U : (x >= 4U ? 3U : (x >= 2U ? 2U : x)));
}

static inline TL_FAST uint32_t tl_to_ratio_bits(uint32_t x, uint32_t bits) {
    return bits <= TL_RATIO_BITS ? x << (TL_RATIO_BITS - bits) : x >> (bits - TL_RATIO_BITS);
}

/// 2^30 / (`whole` scaled to 20 bits), rounded down to 11 bits, and above them the bits that `whole` has. whole > 0,
/// below 2^31. 16 bits in all. Two steps of Newton's method; six products, about 70 cycles on a Cortex-M0+.
static inline uint32_t tl_ratio_of(uint32_t whole) {
    const uint32_t bits = tl_bits(whole), scaled = tl_to_ratio_bits(whole, bits);
    const uint32_t d = scaled >> 4;           // 16 bits
    uint32_t x = 92521U - (d * 61681U >> 16); // 2^31 / d to 1/17: 48/17 - 32/17 d
    x += (uint32_t)((int32_t)x * ((int32_t)(0x80000000U - d * x) >> 15) >> 16);
    x += (uint32_t)((int32_t)x * ((int32_t)(0x80000000U - d * x) >> 15) >> 16);
    uint32_t ratio = (x - 4U) >> 5; // not too large, and too small by 1 at most
    if (ratio < 2047U && (ratio + 1U) * scaled <= 1U << 30) {
        ratio++;
    }
    return bits << 11 | ratio;
}

/// part / whole in Q31 for part < whole, to 2^-19; ratio: tl_ratio_of(whole). Three products.
static inline uint32_t tl_fraction(uint32_t part, uint32_t whole, uint32_t ratio) {
    const uint32_t bits = ratio >> 11, reciprocal = ratio & 0x7FFU;
    part = tl_to_ratio_bits(part, bits);
    whole = tl_to_ratio_bits(whole, bits);
    const uint32_t estimate = part * reciprocal >> 19; // Q11, never too large
    const uint32_t left = (part << 11) - whole * estimate;
    return (estimate << 20) + ((left >> 2) * reciprocal >> 8);
}

#endif
