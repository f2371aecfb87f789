#include "effect.h"

#include <math.h>

enum { WIDTH, GAIN, OFFSET, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"width_per_load", 0, "1/mNm", "of the width, relative"},
    {"gain_per_load", 0, "1/mNm", "of c's distance from c(middle), relative"},
    {"offset_per_load", 0, "unit/mNm", "of the centre coordinate"},
};

static int present(const double *v) {
    return v[WIDTH] != 0.0 || v[GAIN] != 0.0 || v[OFFSET] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state;
    to->q += v[OFFSET] * now->load;
    to->scale = fmax(0.0, to->scale * (1.0 + v[WIDTH] * now->load));
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    (void)state;
    const double gain = 1.0 + v[GAIN] * now->load;
    bend->c = bend->middle + (bend->c - bend->middle) * gain;
    bend->gain *= gain;
}

const struct effect effect_load_dependence = {
    "transmission.load_dependence", PLACE_GAIN, PARAMETERS, COUNT, .present = present, .drive = drive,
    .configure = configure};
