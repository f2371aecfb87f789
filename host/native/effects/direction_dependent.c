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

static double lie(const double *v, double lies, int side, double travelled, const struct effect_moment *now) {
    if (v[DRIVEN] != 0.0) { // a spring that slides: the tendon's pull turns over within the travel
        return fmin(fmax(lies + 2.0 * now->moved / fmax(v[TRAVEL], 1e-9), -1.0), 1.0);
    }
    return lies + (side - lies) * (1.0 - exp(-travelled / v[TRAVEL]));
}

const struct effect effect_direction_dependent = {
    "registration.direction_dependent", PLACE_CHANNEL, PARAMETERS, COUNT, .present = present, .lie = lie};
