#include "__fc_builtin.h"

#include "tl_real.h"

/*@ assigns \result \from a;
    ensures \result == 0 || 0x40000000 <= \result <= 0x7FFFFFFF || -0x7FFFFFFF <= \result <= -0x40000000; */
static int32_t mantissa(tl_real_t a); // as tl_real packs it

/*@ assigns \result \from a; ensures -0x20000000 <= \result <= 0x20000000; */
static int32_t exponent(tl_real_t a); // see proof.toml

#include "../../../firmware/estimator/src/tl_real.c"

#define LONG() Frama_C_long_long_interval(INT64_MIN + 1, INT64_MAX)

static int32_t any_exponent(int32_t most) {
    return Frama_C_int_interval(-most, most);
}

int main(void) {
    const int32_t most = 1 << 29;
    tl_real(LONG(), any_exponent(most));
    const tl_real_t a = LONG(), b = LONG();
    tl_real_add(a, b);
    tl_real_sub(a, b);
    tl_real_mul(a, b);
    tl_real_square(a);
    tl_real_div(a, b);
    tl_real_sqrt(a);
    tl_real_less(a, b);
    tl_real_shift(a, any_exponent(most));
    tl_real_to_q(a, any_exponent(most));
    return 0;
}
