#include "tautline/tl_fixed.h"

#include "tautline/tl_fast.h"

tl_scale_t tl_scale_of(uint32_t numerator, uint32_t denominator) {
    tl_scale_t ratio = {0, 0};
    // Both as 1.x times a power of two; then the quotient lies in (1/2, 2).
    uint32_t n = numerator, d = denominator;
    int shift = 0;
    for (; !(n >> 31); shift--) {
        n <<= 1;
    }
    for (; !(d >> 31); shift++) {
        d <<= 1;
    }
    uint64_t quotient;
    if (n >= d) {
        shift++;
        quotient = ((uint64_t)n << 31) / d;
    } else {
        quotient = ((uint64_t)n << 32) / d;
    }
    ratio.mantissa = (uint32_t)quotient;
    ratio.shift = (int8_t)shift;
    return ratio;
}

TL_FAST int32_t tl_lerp_fine(int32_t a, int32_t b, uint32_t t, unsigned log2) {
    const unsigned extra = log2 - 16U; // bits of t that tl_lerp() has no room for: at most 7
    const int32_t difference = b - a;
    const uint32_t coarse = t >> extra, fine = t & ((1U << extra) - 1U);
    const uint32_t low = ((uint32_t)difference & 0xFFFFU) * coarse + 0x8000U; // with the next one 33 bits: by halves
    const int32_t rest = (int32_t)((uint32_t)((difference >> 8) * (int32_t)fine) << (8U - extra));
    return a + (difference >> 16) * (int32_t)coarse + (rest >> 16) +
           (int32_t)((low >> 16) + (((low & 0xFFFFU) + ((uint32_t)rest & 0xFFFFU)) >> 16));
}
