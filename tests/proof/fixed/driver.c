#include "tautline/tl_fixed.h"

#include "__fc_builtin.h"

#define ANY()          Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define ANY_UNSIGNED() Frama_C_unsigned_int_interval(0, UINT32_MAX)

static uint32_t any_of_bits(unsigned bits) { // that has so many
    return Frama_C_unsigned_int_interval(1U << (bits - 1U), (uint32_t)((1ULL << bits) - 1U));
}

static void ratios(void) {
    //@ loop unroll 40;
    for (unsigned n = 1; n < 32; n++) {
        //@ loop unroll 40;
        for (unsigned d = 1; d < 32; d++) {
            const tl_scale_t ratio = tl_scale_of(any_of_bits(n), any_of_bits(d));
            tl_scale(Frama_C_unsigned_int_interval(0, INT32_MAX), ratio);
        }
    }
}

int main(void) {
    const int32_t a = ANY(), b = ANY();
    tl_add_sat(a, b);
    tl_sub_sat(a, b);
    tl_clamp(a, b, ANY());
    tl_abs_sat(a);
    tl_mul_high(ANY_UNSIGNED(), ANY_UNSIGNED());
    tl_times(Frama_C_long_long_interval(INT64_MIN, INT64_MAX), Frama_C_unsigned_int_interval(0, 0xFFFF));
    ratios();
    return 0;
}
