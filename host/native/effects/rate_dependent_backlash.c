#include "effect.h"

#include <math.h>

enum { WIDTH_PER_SPEED, SATURATION, TIME, HELD, PRESSED, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"width_per_speed", 0, "s", "width added per speed, at a tenth of the grid"},
    {"speed_saturation", 0, "",
     "0: the width grows evenly; k > 0: all but exp(-k) of it is there at a tenth of the grid; < 0: logarithmically"},
    {"speed_time", 0.02, "s", "time in which the width follows the speed"},
    {"width_held", 0, "", "1 if a motor that rests or turns moves nothing, 0 if closing"},
    {"speed_pressed", 0, "", "share of it that goes with the place as B does"},
};
enum { SPEED, UNSETTLED };             // state
static const double SHORTEST_S = 2e-3; // tolerance: least step while the width follows the speed

// Of the width that a tenth of the grid a second adds: (1 - exp(-k r)) / (1 - exp(-k)), or, as of rate-and-state
// friction, for k < 0 log(1 + m r) / log(1 + m) with log(1 + m) = -k; r for k = 0.
static double share(const double *v, double relative) {
    const double k = v[SATURATION];
    if (fabs(k) < 1e-9) {
        return relative;
    }
    return k > 0.0 ? expm1(-k * relative) / expm1(-k) : log1p(expm1(-k) * relative) / -k;
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
        to->extra += v[WIDTH_PER_SPEED] * usual * share(v, relative) * effect_pressed(v[PRESSED], now->wide);
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
