#include "effect.h"

#include <math.h>

enum { TIMES = 4, COUNT = 2 * TIMES };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"slip_1", 0, "unit", "of the motor against the tables, once it has happened"},
    {"slip_2", 0, "unit", "the next one, on top of it"},
    {"slip_3", 0, "unit", "the third"},
    {"slip_4", 0, "unit", "the fourth"},
    {"slip_time_1", 0, "s", "of the session, when it happens"},
    {"slip_time_2", 0, "s", ""},
    {"slip_time_3", 0, "s", ""},
    {"slip_time_4", 0, "s", ""},
};
static const double AT_ONCE_S = 1e-9; // tolerance: far below a frame, far above the last digit of a session's seconds

static int present(const double *v) {
    return v[0] != 0.0 || v[1] != 0.0 || v[2] != 0.0 || v[3] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state;
    for (int i = 0; i < TIMES; i++) {
        const double until = v[TIMES + i] - now->session_s;
        if (until < -AT_ONCE_S) {
            to->q += v[i];
        } else if (v[i] != 0.0) { // as far as the tip is carried until then, and at once from there
            to->again_s = fmin(to->again_s, until > AT_ONCE_S ? until : 3.0 * AT_ONCE_S);
        }
    }
}

const struct effect effect_slip = {"transmission.slip", PLACE_DRIVE,   PARAMETERS, COUNT,
                                   .present = present,  .drive = drive};
