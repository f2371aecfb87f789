/// Numbers with a wide range for the few statistics of an onset: mantissa times a power of two, 31
/// significant bits. For once-a-frame work only: an operation is some tens of cycles, a division one 64-bit
/// division. Private.
#ifndef TAUTLINE_TL_REAL_H
#define TAUTLINE_TL_REAL_H

#include <stdbool.h>
#include <stdint.h>

/// A scalar, so that it travels in registers: mantissa (2^30 <= |m| < 2^31, or 0) in the high word, exponent
/// in the low one. Its sign, and whether it is 0, may be read as those of the integer; all else through
/// these.
typedef int64_t tl_real_t;

/// value 2^e; |value| < 2^63.
tl_real_t tl_real(int64_t value, int32_t e);

tl_real_t tl_real_add(tl_real_t a, tl_real_t b);
tl_real_t tl_real_sub(tl_real_t a, tl_real_t b);
tl_real_t tl_real_mul(tl_real_t a, tl_real_t b);
tl_real_t tl_real_square(tl_real_t a);

/// a 2^e
tl_real_t tl_real_shift(tl_real_t a, int32_t e);

/// b = 0 gives a number larger than any other here.
tl_real_t tl_real_div(tl_real_t a, tl_real_t b);

/// 0 for a negative number.
tl_real_t tl_real_sqrt(tl_real_t a);

bool tl_real_less(tl_real_t a, tl_real_t b);

/// Rounded a 2^bits, saturated.
int32_t tl_real_to_q(tl_real_t a, int32_t bits);

#endif
