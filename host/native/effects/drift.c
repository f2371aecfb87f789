#include "effect.h"

#include <math.h>

enum { OFFSET, WIDTH, DECAY, FROM, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"offset_drift", 0, "unit/s", "of the centre coordinate, at first"},
    {"width_drift", 0, "1/s", "of the width, relative, at first"},
    {"drift_decay", 0, "1/s", "1 / the time in which it ends; 0 if it goes on"},
    {"drift_from", 0, "s", "of the session, when it began"},
};

static int present(const double *v) {
    return v[OFFSET] != 0.0 || v[WIDTH] != 0.0;
}

static void drive(const double *v, double *state, const struct effect_moment *now, struct effect_drive *to) {
    (void)state;
    const double since = fmax(0.0, now->session_s - v[FROM]);
    const double gone = v[DECAY] > 0.0 ? (1.0 - exp(-v[DECAY] * since)) / v[DECAY] : since;
    to->q += v[OFFSET] * gone;
    to->scale = fmax(0.0, to->scale * (1.0 + v[WIDTH] * gone));
}

const struct effect effect_drift = {"transmission.drift", PLACE_DRIVE,   PARAMETERS, COUNT,
                                    .present = present,   .drive = drive};
