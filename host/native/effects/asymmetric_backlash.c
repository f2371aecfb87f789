#include "effect.h"

#include <math.h>

enum { ASYMMETRY, TRAVEL, FORM, RENEWED, PRESSED, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"asymmetry", 0, "unit", "extra play after turning up (-: after turning down)"},
    {"asymmetry_travel", 1, "unit", "travel in which the tip catches up"},
    {"asymmetry_form", 1, "", "exponent; 1 exponential, 2 slow at first"},
    {"asymmetry_renewed", 0, "", "1 if it is there again after every rest, 0 after a turn alone"},
    {"asymmetry_pressed", 0, "", "share of it that goes with the place as B does"},
};
static const double RENEWED_S = 0.05; // prior: a rest after which static friction is there again

static int present(const double *v) {
    return v[ASYMMETRY] != 0.0;
}

static double late(const double *v, int side, const struct effect_contact *contact) {
    if (side * v[ASYMMETRY] < 0.0) {
        return 0.0;
    }
    const double most = fabs(v[ASYMMETRY]) * effect_pressed(v[PRESSED], contact->wide);
    return most * exp(-pow(contact->since / v[TRAVEL], v[FORM]));
}

static double renewed_s(const double *v) {
    return v[RENEWED] != 0.0 ? RENEWED_S : INFINITY;
}

const struct effect effect_asymmetric_backlash = {"transmission.asymmetric_backlash",
                                                  PLACE_PLAY,
                                                  PARAMETERS,
                                                  COUNT,
                                                  .present = present,
                                                  .late = late,
                                                  .renewed_s = renewed_s};
