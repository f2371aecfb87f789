#include "tautline/tl_fixed.h"

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
