#include "effect.h"

#include <math.h>

enum { SIN, COS, SIN2, COS2, PERIOD, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"encoder_sin", 0, "unit", "amplitude in phase with q = 0"},
    {"encoder_cos", 0, "unit", "amplitude a quarter turn on"},
    {"encoder_sin2", 0, "unit", "the same twice a turn"},
    {"encoder_cos2", 0, "unit", "and an eighth of a turn on"},
    {"encoder_period", 1, "unit", "q per turn"},
};

static int present(const double *v) {
    return v[SIN] != 0.0 || v[COS] != 0.0 || v[SIN2] != 0.0 || v[COS2] != 0.0;
}

// The encoder errs by where its shaft is, x = q + error(x).
static double shaft(const double *v, double q) {
    const double turn = 6.283185307179586 / v[PERIOD];
    double x = q;
    for (int i = 0; i < 3; i++) {
        const double s = sin(turn * x), c = cos(turn * x), s2 = 2.0 * s * c, c2 = c * c - s * s;
        const double error = v[SIN] * s + v[COS] * c + v[SIN2] * s2 + v[COS2] * c2;
        const double slope = turn * (v[SIN] * c - v[COS] * s + 2.0 * v[SIN2] * c2 - 2.0 * v[COS2] * s2);
        x -= (x - q - error) / fmax(1.0 - slope, 0.2);
    }
    return x;
}

const struct effect effect_encoder_periodic = {"actuator.encoder_periodic", PLACE_ENCODER, PARAMETERS, COUNT,
                                               .present = present,          .shaft = shaft};
