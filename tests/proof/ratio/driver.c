#include "../../../firmware/estimator/src/tl_ratio.h"

#include "__fc_builtin.h"

// Every number below 2^31, by its bits and its next six: Newton's steps are as near as their start, which is a line.
static void reciprocals(void) {
    //@ loop unroll 40;
    for (unsigned bits = 1; bits <= 31U; bits++) {
        const unsigned below = bits > 7U ? bits - 7U : 0U;
        const uint32_t part = 1U << below, first = 1U << (bits - 1U);
        //@ loop unroll 70;
        for (uint32_t i = 0; i < first >> below; i++) {
            tl_ratio_of(Frama_C_unsigned_int_interval(first + i * part, first + i * part + part - 1U));
        }
    }
}

int main(void) {
    reciprocals();
    tl_fraction(Frama_C_unsigned_int_interval(0, UINT32_MAX), Frama_C_unsigned_int_interval(0, UINT32_MAX),
                Frama_C_unsigned_int_interval(0, UINT16_MAX));
    return 0;
}
