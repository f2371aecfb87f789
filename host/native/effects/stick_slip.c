#include "effect.h"

#include <math.h>

enum { STICK, HELD_BACK, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"stick", 0, "unit", "motion held back until the tip jumps"},
    {"mean_stick_lag", 0, "unit", "by how much it widens the play in the mean"},
};

static int present(const double *v) {
    return v[STICK] > 0.0 || v[HELD_BACK] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state, (void)now;
    to->extra += v[HELD_BACK];
}

static void start(const double *v, double *state, double centre) {
    (void)v;
    state[0] = centre;
}

static double hold(const double *v, double *state, double tip) {
    if (v[STICK] <= 0.0) {
        return tip;
    }
    state[0] += v[STICK] * trunc((tip - state[0]) / v[STICK]); // as many jumps as it takes
    return state[0];
}

const struct effect effect_stick_slip = {"transmission.stick_slip", PLACE_STICK,    PARAMETERS,     COUNT,
                                         .present = present,        .drive = drive, .start = start, .hold = hold};
