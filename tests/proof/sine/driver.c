#include "__fc_builtin.h"

#include "../../../firmware/estimator/src/tl_undo.c"

int main(void) {
    //@ loop unroll 1024;
    for (uint32_t i = 0; i < 1024U; i++) {
        const int32_t value = sine(Frama_C_unsigned_int_interval(i << 22, (i << 22) + (1U << 22) - 1U));
        //@ assert -40000 <= value <= 40000;
    }
    return 0;
}
