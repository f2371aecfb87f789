#include "effect.h"

#include <math.h>

enum { LAG, SECOND, HELD, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"lag", 0, "s", "time constant"},
    {"lag_second", 0, "", "share of it in a second stage; 0 to 0.5"},
    {"lag_held", 0, "",
     "1 if friction holds the tip that lags: drag beside it; 0 if the tip lags behind what it holds"},
};
enum { ONE, TWO }; // state: the stages

static int present(const double *v) {
    return v[LAG] > 0.0;
}

static double first(const double *v) {
    return v[LAG] * (1.0 - v[SECOND]);
}

static double drag_s(const double *v) {
    return v[HELD] != 0.0 ? first(v) : 0.0;
}

static void start(const double *v, double *state, double centre) {
    (void)v;
    state[ONE] = state[TWO] = centre;
}

static void follow(const double *v, double *state, struct effect_chain *chain, double u0, double u1, double dt) {
    const double one = v[HELD] != 0.0 ? 0.0 : first(v);
    const double two = v[LAG] * v[SECOND];
    // The second stage's input bends: it is cut into straight pieces shorter than the stages.
    const int pieces = two > 0.0 ? (int)fmin(16.0, 1.0 + dt / (0.3 * two)) : 1;
    for (int i = 0; i < pieces; i++) {
        const double from = u0 + (u1 - u0) * i / pieces;
        const double to = u0 + (u1 - u0) * (i + 1) / pieces;
        const double before = state[ONE], left = state[TWO];
        state[ONE] = effect_first_order(before, from, to, dt / pieces, one);
        state[TWO] = effect_first_order(left, before, state[ONE], dt / pieces, two);
        effect_pass(chain, left, state[TWO], dt / pieces);
    }
}

const struct effect effect_lag = {"transmission.lag", PLACE_LAG,      PARAMETERS,       COUNT,
                                  .present = present, .start = start, .follow = follow, .drag_s = drag_s};
