#include "tautline/tl_history.h"

#include "__fc_builtin.h"

static tl_history_t history;

int main(void) {
    tl_history_init(&history);
    tl_count_q8_t q;
    while (Frama_C_nondet(0, 1)) {
        tl_history_push(&history, Frama_C_unsigned_long_long_interval(0, UINT64_MAX),
                        Frama_C_int_interval(INT32_MIN, INT32_MAX));
        tl_history_at(&history, Frama_C_unsigned_long_long_interval(0, UINT64_MAX), &q);
    }
    return 0;
}
