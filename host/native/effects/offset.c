#include "effect.h"

enum { OFFSET, AT_TIP, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"offset", 0, "unit", "of the motor against the tables"},
    {"offset_at_tip", 0, "", "0: it shifts B and f_remain along the motor; 1: it adds to c, by f_remain's mean slope"},
};

static int present(const double *v) {
    return v[OFFSET] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state, (void)now;
    to->q += v[AT_TIP] != 0.0 ? 0.0 : v[OFFSET];
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    (void)state, (void)now;
    bend->c += v[AT_TIP] != 0.0 ? bend->slope * v[OFFSET] : 0.0;
}

const struct effect effect_offset = {
    "transmission.offset", PLACE_DRIVE, PARAMETERS, COUNT, .present = present, .drive = drive, .configure = configure};
