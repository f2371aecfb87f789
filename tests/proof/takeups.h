/// Any state of a take-up: less than 2^32 Q8 counts ahead, no more of them spare, and no less than that by what braking
/// from its speed takes; speeds up to 2^31 Q8 counts a second in 16 ticks, as tl_takeup_set_limits() makes them.
#ifndef TAUTLINE_PROOF_TAKEUPS_H
#define TAUTLINE_PROOF_TAKEUPS_H

#include "tautline/tl_compensator.h"

#include "__fc_builtin.h"

#define FAR_Q36   ((int64_t)1 << 60)
#define QUICK_Q36 ((int64_t)1 << 55)

static tl_takeup_t any_takeup(void) {
    return (tl_takeup_t){.heading = Frama_C_nondet(1, -1),
                         .ahead_q36 = Frama_C_long_long_interval(-FAR_Q36, FAR_Q36),
                         .spare_q36 = Frama_C_long_long_interval(-4 * FAR_Q36, FAR_Q36),
                         .speed_q36 = Frama_C_long_long_interval(0, QUICK_Q36),
                         .accel_q36 = Frama_C_long_long_interval(0, QUICK_Q36),
                         .speed_max_q36 = Frama_C_long_long_interval(0, QUICK_Q36),
                         .next_accel_q36 = Frama_C_long_long_interval(0, QUICK_Q36),
                         .next_speed_max_q36 = Frama_C_long_long_interval(0, QUICK_Q36),
                         .limits_pending = Frama_C_unsigned_int_interval(0, 1)};
}

#endif
