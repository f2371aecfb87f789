#include "effect.h"

#include <math.h>

enum { TRANSLATION, ROTATION, JOINT, PLAY, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"c_per_translation", 0, "deg/mm", "of the instrument's translation"},
    {"c_per_rotation", 0, "deg/deg", "of the instrument's rotation"},
    {"c_per_joint", 0, "deg", "of another joint, for each of its unit"},
    {"joint_play", 0, "", "of that joint, in its unit"},
};
enum { CARRIED }; // state: where the joint has carried its own play

static int present(const double *v) {
    return v[TRANSLATION] != 0.0 || v[ROTATION] != 0.0 || v[JOINT] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)to;
    const double half = 0.5 * v[PLAY], before = now->first ? now->other : state[CARRIED];
    state[CARRIED] = fmin(fmax(before, now->other - half), now->other + half);
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    bend->c += v[TRANSLATION] * now->translation + v[ROTATION] * now->rotation + v[JOINT] * state[CARRIED];
}

const struct effect effect_axis_coupling = {
    "configuration.axis_coupling", PLACE_COUPLING, PARAMETERS, COUNT, .present = present, .drive = drive,
    .configure = configure};
