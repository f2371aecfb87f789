#include "effect.h"

#include <math.h>

enum { PULL, PLACE, DRAG, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"loose_pull", 0, "1/s^2",
     "acceleration over the way to loose_place of what is free within B; below 0 away from it"},
    {"loose_place", 0, "unit", "where its load pulls to neither side"},
    {"loose_drag", 5, "1/s", "deceleration over its speed"},
};
static const double LONGEST_S = 2e-3; // tolerance: step of what falls: a hundredth of its swing at 900 / s^2

static int present(const double *v) {
    return v[PULL] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)v, (void)state, (void)now;
    to->again_s = fmin(to->again_s, LONGEST_S);
}

// Implicit in the drag, so that any drag is stable.
static void fall(const double *v, double dt, double *at, double *speed) {
    *speed = (*speed - v[PULL] * (*at - v[PLACE]) * dt) / (1.0 + v[DRAG] * dt);
    *at += *speed * dt;
}

const struct effect effect_loose = {"transmission.loose", PLACE_PLAY,     PARAMETERS,  COUNT,
                                    .present = present,   .drive = drive, .fall = fall};
