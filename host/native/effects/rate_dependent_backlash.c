#include "effect.h"

#include <math.h>

enum { WIDTH_PER_SPEED, SATURATION, TIME, HELD, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"width_per_speed", 0, "s", "width added per speed, at a tenth of the grid"},
    {"speed_saturation", 0, "",
     "0: the width grows without end; k: all but exp(-k) of it is there at a tenth of the grid"},
    {"speed_time", 0.02, "s", "time in which the width follows the speed"},
    {"width_held", 0, "", "1 if a motor that rests or turns moves nothing, 0 if closing"},
};
enum { SPEED, UNSETTLED };             // state
static const double SHORTEST_S = 2e-3; // tolerance: least step while the width follows the speed

// Of the width that a tenth of the grid a second adds: (1 - exp(-k r)) / (1 - exp(-k)), which is r for k = 0.
static double share(const double *v, double relative) {
    const double k = v[SATURATION];
    return k > 1e-9 ? expm1(-k * relative) / expm1(-k) : relative;
}

static int present(const double *v) {
    return v[WIDTH_PER_SPEED] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    const double usual = now->usual_speed, resting = 1e-5 * usual;
    if (now->dt > 0.0 && (fabs(now->moved) > resting * now->dt || v[HELD] == 0.0)) {
        const double speed = now->moved / now->dt;
        state[SPEED] += (speed - state[SPEED]) * (1.0 - exp(-now->dt / v[TIME]));
        state[UNSETTLED] = fabs(speed - state[SPEED]) > 0.01 * usual;
    }
    if (now->at_knot) {
        state[UNSETTLED] = 1.0;
    }
    const double relative = fabs(state[SPEED]) / usual;
    if (relative > 0.0) {
        to->extra += v[WIDTH_PER_SPEED] * usual * share(v, relative);
    }
    if (v[HELD] != 0.0) {
        to->way = now->moved > 0.0 ? 1.0 : -1.0;
    }
    if (state[UNSETTLED] != 0.0) {
        to->again_s = fmin(to->again_s, fmax(0.25 * v[TIME], SHORTEST_S));
    }
}

const struct effect effect_rate_dependent_backlash = {
    "transmission.rate_dependent_backlash", PLACE_DRIVE, PARAMETERS, COUNT, .present = present, .drive = drive};
