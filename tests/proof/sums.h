/// The sums of an onset's least squares, as large as 192 samples have them: 128, and the window's before they halve.
#ifndef TAUTLINE_PROOF_SUMS_H
#define TAUTLINE_PROOF_SUMS_H

#include "tl_hinge.h"

#include "__fc_builtin.h"

#define ANY()    Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define LONG(x)  Frama_C_long_long_interval(-((int64_t)1 << (x)), (int64_t)1 << (x))
#define TO(x)    Frama_C_long_long_interval(0, (int64_t)1 << (x))
#define NUMBER() Frama_C_long_long_interval(INT64_MIN, INT64_MAX)

static tl_onset_sums_t any_sums(void) {
    return (tl_onset_sums_t){.w = Frama_C_long_long_interval(0, 0x3000),
                             .x = LONG(30),
                             .xx = TO(48),
                             .u = LONG(32),
                             .v = LONG(32),
                             .xu = LONG(48),
                             .xv = LONG(48),
                             .yy = TO(50),
                             .n = Frama_C_int_interval(0, 192)};
}

#endif
