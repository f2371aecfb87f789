#include "../../../firmware/estimator/src/tl_takeup.h"

#include "../takeups.h"

static tl_takeup_t takeup;
static tl_table_t table;

static int32_t any_jump(void) {
    return Frama_C_int_interval(-INT32_MAX, INT32_MAX);
}

int main(void) {
    tl_takeup_start(&takeup);
    takeup = any_takeup();
    table.takeup_speed_q8 = Frama_C_int_interval(1, INT32_MAX);
    table.takeup_accel = Frama_C_int_interval(1, INT32_MAX);
    tl_takeup_set_limits(&takeup, &table, Frama_C_unsigned_int_interval(16, 100000));
    //@ assert 0 < takeup.next_accel_q36 <= QUICK_Q36 && 0 < takeup.next_speed_max_q36 <= QUICK_Q36;
    takeup = any_takeup();
    tl_takeup_add(&takeup, any_jump());
    tl_takeup_step(&takeup);
    tl_takeup_rest(&takeup);
    tl_takeup_done(&takeup);
    tl_takeup_set(&takeup, any_jump());
    tl_takeup_rest(&takeup);
    tl_takeup_step(&takeup);
    return 0;
}
