#include "effect.h"

#include <math.h>

// How the instrument turns over in its channel; projection.h says by how much it is then tilted.
enum { TRAVEL, DRIVEN, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"tilt_travel", 0, "unit", "travel in which the instrument turns over"},
    {"tilt_driven", 0, "", "1 if it turns over with the motor, 0 with the tip"},
};

static int present(const double *v) {
    return v[TRAVEL] > 0.0 || v[DRIVEN] != 0.0;
}

// A spring that slides: what pulls it turns over within the travel.
static double lie(const double *v, double lies, double moved, const struct effect_moment *now) {
    const double pulled = v[DRIVEN] != 0.0 ? now->moved : moved;
    return fmin(fmax(lies + 2.0 * pulled / fmax(v[TRAVEL], 1e-9), -1.0), 1.0);
}

const struct effect effect_direction_dependent = {
    "registration.direction_dependent", PLACE_CHANNEL, PARAMETERS, COUNT, .present = present, .lie = lie};
