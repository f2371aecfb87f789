#include "../../../firmware/estimator/src/tl_takeup.h"

#include "__fc_builtin.h"

#define FAR   ((int64_t)1 << 60)
#define QUICK ((int64_t)1 << 55) // 2^31 Q8 counts a second, in 16 ticks

static tl_takeup_t takeup;
static tl_table_t table;

static void any_takeup(void) {
    takeup.heading = Frama_C_nondet(1, -1);
    takeup.ahead_q36 = Frama_C_long_long_interval(-FAR, FAR);
    takeup.spare_q36 = Frama_C_long_long_interval(-4 * FAR, FAR);
    takeup.speed_q36 = Frama_C_long_long_interval(0, QUICK);
    takeup.accel_q36 = Frama_C_long_long_interval(0, QUICK);
    takeup.speed_max_q36 = Frama_C_long_long_interval(0, QUICK);
    takeup.next_accel_q36 = Frama_C_long_long_interval(0, QUICK);
    takeup.next_speed_max_q36 = Frama_C_long_long_interval(0, QUICK);
    takeup.limits_pending = Frama_C_unsigned_int_interval(0, 1);
}

static int32_t any_jump(void) {
    return Frama_C_int_interval(-INT32_MAX, INT32_MAX);
}

int main(void) {
    tl_takeup_start(&takeup);
    any_takeup();
    table.takeup_speed_q8 = Frama_C_int_interval(1, INT32_MAX);
    table.takeup_accel = Frama_C_int_interval(1, INT32_MAX);
    tl_takeup_set_limits(&takeup, &table, Frama_C_unsigned_int_interval(16, 100000));
    //@ assert 0 < takeup.next_accel_q36 <= QUICK && 0 < takeup.next_speed_max_q36 <= QUICK;
    any_takeup();
    tl_takeup_add(&takeup, any_jump());
    tl_takeup_step(&takeup);
    tl_takeup_rest(&takeup);
    tl_takeup_done(&takeup);
    tl_takeup_set(&takeup, any_jump());
    tl_takeup_rest(&takeup);
    tl_takeup_step(&takeup);
    return 0;
}
