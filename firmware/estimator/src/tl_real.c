#include "tl_real.h"

#include "tautline/tl_fast.h"

static TL_FAST int32_t mantissa(tl_real_t a) {
    return (int32_t)(uint32_t)((uint64_t)a >> 32);
}

static TL_FAST int32_t exponent(tl_real_t a) {
    return (int32_t)(uint32_t)a;
}

static TL_FAST tl_real_t pack(int32_t m, int32_t e) {
    return (tl_real_t)((uint64_t)(uint32_t)m << 32 | (uint32_t)e);
}

TL_FAST tl_real_t tl_real(int64_t value, int32_t e) {
    uint64_t magnitude = value < 0 ? 0U - (uint64_t)value : (uint64_t)value;
    if (magnitude == 0) {
        return 0;
    }
    uint32_t m = (uint32_t)magnitude;
    uint32_t high = (uint32_t)(magnitude >> 32);
    if (high != 0 || m >> 31) { // at most 2^63: shift right by 1 to 33
        int32_t shift = 1;
        for (int32_t step = 16; step > 0; step /= 2) {
            if (high >> step) {
                high >>= step;
                shift += step;
            }
        }
        shift += high != 0 ? 1 : 0;
        m = (uint32_t)(magnitude >> shift);
        e += shift;
    } else {
        for (int32_t step = 16; step > 0; step /= 2) {
            if (m >> (31 - step) == 0) {
                m <<= step;
                e -= step;
            }
        }
    }
    return pack(value < 0 ? -(int32_t)m : (int32_t)m, e);
}

TL_FAST tl_real_t tl_real_mul(tl_real_t a, tl_real_t b) {
    return tl_real((int64_t)mantissa(a) * mantissa(b), exponent(a) + exponent(b));
}

TL_FAST tl_real_t tl_real_square(tl_real_t a) {
    return tl_real_mul(a, a);
}

TL_FAST tl_real_t tl_real_shift(tl_real_t a, int32_t e) {
    return a == 0 ? 0 : pack(mantissa(a), exponent(a) + e);
}

TL_FAST tl_real_t tl_real_div(tl_real_t a, tl_real_t b) {
    if (b == 0) {
        return pack(INT32_MAX, 1 << 20);
    }
    return tl_real((int64_t)mantissa(a) * ((int64_t)1 << 31) / mantissa(b), exponent(a) - 31 - exponent(b));
}

TL_FAST tl_real_t tl_real_add(tl_real_t a, tl_real_t b) {
    if (a == 0 || (b != 0 && exponent(a) < exponent(b))) {
        const tl_real_t swap = a;
        a = b;
        b = swap;
    }
    const int32_t shift = exponent(a) - exponent(b);
    if (b == 0 || shift > 30) {
        return a;
    }
    return tl_real((int64_t)mantissa(a) * ((int64_t)1 << 30) + (int64_t)mantissa(b) * ((int64_t)1 << (30 - shift)),
                   exponent(a) - 30);
}

TL_FAST tl_real_t tl_real_sub(tl_real_t a, tl_real_t b) {
    return tl_real_add(a, pack(-mantissa(b), exponent(b)));
}

TL_FAST bool tl_real_less(tl_real_t a, tl_real_t b) {
    return tl_real_sub(a, b) < 0;
}

TL_FAST tl_real_t tl_real_sqrt(tl_real_t a) {
    if (a <= 0) {
        return 0;
    }
    const int32_t shift = (exponent(a) & 1) != 0 ? 31 : 32; // an even exponent remains
    uint64_t rest = (uint64_t)(uint32_t)mantissa(a) << shift;
    uint64_t root = 0;
    for (uint64_t bit = (uint64_t)1 << 62; bit != 0; bit >>= 2) {
        if (rest >= root + bit) {
            rest -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
    }
    return tl_real((int64_t)root, (exponent(a) - shift) / 2);
}

TL_FAST int32_t tl_real_to_q(tl_real_t a, int32_t bits) {
    const int32_t e = exponent(a) + bits;
    if (a == 0 || e < -31) {
        return 0;
    }
    if (e > 0) {
        return a < 0 ? INT32_MIN : INT32_MAX;
    }
    const int64_t half = e < 0 ? (int64_t)1 << (-e - 1) : 0;
    const int64_t size = ((a < 0 ? -(int64_t)mantissa(a) : (int64_t)mantissa(a)) + half) >> -e;
    return (int32_t)(a < 0 ? -size : size);
}
