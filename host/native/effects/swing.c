#include "effect.h"

#include <math.h>

enum { SHARE, PERIOD, DAMPING, CARRIED, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"swing_share", 0, "", "share of the motion that a spring carries; 1: all of it"},
    {"swing_period", 1, "s", "of the swing without damping"},
    {"swing_damping", 0.1, "", "of critical; 0.01 to 0.95"},
    {"swing_carried", 0, "",
     "share of the damper that goes with what moves the tip, not with the ground; above 1 the "
     "tip lags less than before it swung"},
};
enum { AT, RATE, OUT }; // state

static int present(const double *v) {
    return v[SHARE] != 0.0;
}

static void start(const double *v, double *state, double centre) {
    (void)v;
    state[AT] = state[OUT] = centre;
    state[RATE] = 0.0;
}

// y'' + 2 damping w (y' - carried u') + w^2 (y - u) = 0, exactly for a straight u: y lags the ramp by
// 2 damping (1 - carried) / w, and what is off that line dies away in a swing.
static void follow(const double *v, double *state, struct effect_chain *chain, double u0, double u1, double dt) {
    const double before = state[OUT];
    if (dt > 0.0) {
        const double w = 6.283185307179586 / v[PERIOD], decay = v[DAMPING] * w;
        const double turn = w * sqrt(1.0 - v[DAMPING] * v[DAMPING]);
        const double slope = (u1 - u0) / dt, behind = 2.0 * v[DAMPING] * (1.0 - v[CARRIED]) / w * slope;
        const double off = state[AT] - (u0 - behind), rate = state[RATE] - slope;
        const double s = sin(turn * dt), c = cos(turn * dt), left = exp(-decay * dt);
        const double other = (rate + decay * off) / turn;
        state[AT] = u1 - behind + left * (off * c + other * s);
        state[RATE] = slope + left * ((other * turn - decay * off) * c - (off * turn + decay * other) * s);
    }
    state[OUT] = u1 + v[SHARE] * (state[AT] - u1);
    effect_pass(chain, before, state[OUT], dt);
}

const struct effect effect_swing = {"configuration.swing", PLACE_SWING,    PARAMETERS,      COUNT,
                                    .present = present,    .start = start, .follow = follow};
