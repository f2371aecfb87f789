#include "effect.h"

enum { SHARE, TIME, SLOW, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"creep_share", 0, "", "share of the motion that comes late; -1 to 1, below 0 it comes back"},
    {"creep_time", 1, "s", "its time constant"},
    {"creep_slow", 0, "", "share of it that is five times slower; 0 to 1"},
};
enum { FAST, SLOWLY, OUT };       // state
static const double SLOWER = 5.0; // equation: as creep_slow says

static int present(const double *v) {
    return v[SHARE] != 0.0;
}

static void start(const double *v, double *state, double centre) {
    (void)v;
    state[FAST] = state[SLOWLY] = state[OUT] = centre;
}

static void follow(const double *v, double *state, struct effect_chain *chain, double u0, double u1, double dt) {
    const double before = state[OUT];
    state[FAST] = effect_first_order(state[FAST], u0, u1, dt, v[TIME]);
    state[SLOWLY] = effect_first_order(state[SLOWLY], u0, u1, dt, SLOWER * v[TIME]);
    state[OUT] = u1 - v[SHARE] * (u1 - (1.0 - v[SLOW]) * state[FAST] - v[SLOW] * state[SLOWLY]);
    effect_pass(chain, before, state[OUT], dt);
}

const struct effect effect_creep = {"transmission.creep", PLACE_CREEP,    PARAMETERS,      COUNT,
                                    .present = present,   .start = start, .follow = follow};
