#include "effect.h"

#include <math.h>

enum { ASYMMETRY, TRAVEL, FORM, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"asymmetry", 0, "unit", "extra play after turning up (-: after turning down)"},
    {"asymmetry_travel", 1, "unit", "travel in which the tip catches up"},
    {"asymmetry_form", 1, "", "exponent; 1 exponential, 2 slow at first"},
};

static int present(const double *v) {
    return v[ASYMMETRY] != 0.0;
}

static double late(const double *v, int side, double since) {
    if (side * v[ASYMMETRY] < 0.0) {
        return 0.0;
    }
    return fabs(v[ASYMMETRY]) * exp(-pow(since / v[TRAVEL], v[FORM]));
}

const struct effect effect_asymmetric_backlash = {
    "transmission.asymmetric_backlash", PLACE_PLAY, PARAMETERS, COUNT, .present = present, .late = late};
