#include "effect.h"

enum { TRANSLATION, ROTATION, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"c_per_translation", 0, "deg/mm", "of the instrument's translation"},
    {"c_per_rotation", 0, "deg/deg", "of the instrument's rotation"},
};

static int present(const double *v) {
    return v[TRANSLATION] != 0.0 || v[ROTATION] != 0.0;
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    (void)state;
    bend->c += v[TRANSLATION] * now->translation + v[ROTATION] * now->rotation;
}

const struct effect effect_axis_coupling = {
    "configuration.axis_coupling", PLACE_COUPLING, PARAMETERS, COUNT, .present = present, .configure = configure};
