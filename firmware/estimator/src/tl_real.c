#include "tl_real.h"

tl_real_t tl_real(int64_t value, int32_t e) {
    uint64_t magnitude = value < 0 ? 0U - (uint64_t)value : (uint64_t)value;
    if (magnitude == 0) {
        return (tl_real_t){0, 0};
    }
    for (int32_t step = 32; step > 0; step /= 2) {
        if (magnitude >> (31 + step - 1)) {
            magnitude >>= step;
            e += step;
        }
    }
    for (int32_t step = 16; step > 0; step /= 2) {
        if (magnitude >> (31 - step) == 0) {
            magnitude <<= step;
            e -= step;
        }
    }
    return (tl_real_t){value < 0 ? -(int32_t)magnitude : (int32_t)magnitude, e};
}

tl_real_t tl_real_mul(tl_real_t a, tl_real_t b) {
    return tl_real((int64_t)a.m * b.m, a.e + b.e);
}

tl_real_t tl_real_square(tl_real_t a) {
    return tl_real_mul(a, a);
}

tl_real_t tl_real_div(tl_real_t a, tl_real_t b) {
    if (b.m == 0) {
        return (tl_real_t){INT32_MAX, 1 << 20};
    }
    return tl_real((int64_t)a.m * ((int64_t)1 << 31) / b.m, a.e - 31 - b.e);
}

tl_real_t tl_real_add(tl_real_t a, tl_real_t b) {
    if (a.m == 0 || (b.m != 0 && a.e < b.e)) {
        const tl_real_t swap = a;
        a = b;
        b = swap;
    }
    const int32_t shift = a.e - b.e;
    if (b.m == 0 || shift > 30) {
        return a;
    }
    return tl_real((int64_t)a.m * ((int64_t)1 << 30) + (int64_t)b.m * ((int64_t)1 << (30 - shift)), a.e - 30);
}

tl_real_t tl_real_neg(tl_real_t a) {
    return (tl_real_t){-a.m, a.e};
}

bool tl_real_less(tl_real_t a, tl_real_t b) {
    return tl_real_add(a, tl_real_neg(b)).m < 0;
}

tl_real_t tl_real_sqrt(tl_real_t a) {
    if (a.m <= 0) {
        return (tl_real_t){0, 0};
    }
    const bool odd = (a.e & 1) != 0;
    uint64_t rest = (uint64_t)a.m << (odd ? 31 : 32);
    uint64_t root = 0;
    for (uint64_t bit = (uint64_t)1 << 62; bit != 0; bit >>= 2) {
        if (rest >= root + bit) {
            rest -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
    }
    return tl_real((int64_t)root, (a.e - (odd ? 31 : 32)) / 2);
}

int32_t tl_real_to_q(tl_real_t a, int32_t bits) {
    const int32_t e = a.e + bits;
    if (a.m == 0 || e < -31) {
        return 0;
    }
    if (e > 0) {
        return a.m < 0 ? INT32_MIN : INT32_MAX;
    }
    const int64_t half = e < 0 ? (int64_t)1 << (-e - 1) : 0;
    const int64_t magnitude = ((a.m < 0 ? -(int64_t)a.m : (int64_t)a.m) + half) >> -e;
    return (int32_t)(a.m < 0 ? -magnitude : magnitude);
}
