#include "../contracts.h"

#include "__fc_builtin.h"

#define MOST 65536 // one more than the header can say

static uint8_t bytes[MOST];

int main(void) {
    Frama_C_make_unknown((char *)bytes, sizeof bytes);
    const uint8_t axis = (uint8_t)Frama_C_interval(0, 255);
    //@ loop unroll 200;
    for (unsigned size = 0; size <= 2U * TL_TABLE_SIZE(0U); size++) { // the last `size` bytes: none behind them
        tl_table_check_blob(bytes + MOST - size, size, axis);
    }
    // Of more, what is read at the front lies within those; here that nothing behind the end is.
    tl_table_check_blob(bytes, Frama_C_size_t_interval(0, MOST), axis);
    return 0;
}
