#include "effect.h"

#include <math.h>

enum { TRANSLATION, ROTATION, JOINT, PLAY, TRANSLATION_PLAY, ROTATION_PLAY, BEFORE, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"c_per_translation", 0, "deg/mm", "of the instrument's translation"},
    {"c_per_rotation", 0, "deg/deg", "of the instrument's rotation"},
    {"c_per_joint", 0, "deg", "of another joint, for each of its unit"},
    {"joint_play", 0, "", "of that joint, in its unit"},
    {"translation_play", 0, "mm", "of the translation"},
    {"rotation_play", 0, "deg", "of the rotation"},
    {"coupled_before", 0, "", "1 if it moves the tendon before the play, 0 the tip behind it"},
};
enum { WITH_TRANSLATION, WITH_ROTATION, WITH_JOINT }; // state: where each has carried its own play

static int present(const double *v) {
    return v[TRANSLATION] != 0.0 || v[ROTATION] != 0.0 || v[JOINT] != 0.0;
}

static void carry(double *at, double play, double to, int first) {
    *at = first ? to : fmin(fmax(*at, to - 0.5 * play), to + 0.5 * play);
}

// What they add to the angle, deg.
static double coupled(const double *v, const double *state) {
    return v[TRANSLATION] * state[WITH_TRANSLATION] + v[ROTATION] * state[WITH_ROTATION] + v[JOINT] * state[WITH_JOINT];
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    carry(&state[WITH_TRANSLATION], v[TRANSLATION_PLAY], now->translation, now->first);
    carry(&state[WITH_ROTATION], v[ROTATION_PLAY], now->rotation, now->first);
    carry(&state[WITH_JOINT], v[PLAY], now->other, now->first);
    if (v[BEFORE] != 0.0) {
        to->q += coupled(v, state) / now->slope;
    }
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    (void)now;
    if (v[BEFORE] == 0.0) {
        bend->c += coupled(v, state);
    }
}

const struct effect effect_axis_coupling = {
    "configuration.axis_coupling", PLACE_COUPLING, PARAMETERS, COUNT, .present = present, .drive = drive,
    .configure = configure};
