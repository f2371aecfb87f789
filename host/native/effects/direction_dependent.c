#include "effect.h"

#include <math.h>

// How the instrument turns over in its channel; projection.h says by how much it is then tilted.
enum { TRAVEL, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"tilt_travel", 0, "unit", "the tip's travel in which the instrument turns over"},
};

static int present(const double *v) {
    return v[TRAVEL] > 0.0;
}

static double lie(const double *v, double lies, int side, double travelled) {
    return lies + (side - lies) * (1.0 - exp(-travelled / v[TRAVEL]));
}

const struct effect effect_direction_dependent = {
    "registration.direction_dependent", PLACE_CHANNEL, PARAMETERS, COUNT, .present = present, .lie = lie};
