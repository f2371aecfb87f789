#include "effect.h"

enum { OFFSET, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"offset", 0, "unit", "of the motor against the tables"},
};

static int present(const double *v) {
    return v[OFFSET] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state, (void)now;
    to->q += v[OFFSET];
}

const struct effect effect_offset = {
    "transmission.offset", PLACE_DRIVE, PARAMETERS, COUNT, .present = present, .drive = drive};
