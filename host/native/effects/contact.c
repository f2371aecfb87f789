#include "effect.h"

#include <math.h>

enum { HOLD, FROM, SIDE, SOFT, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"contact_hold", 0, "", "share of the motion far beyond contact_c that is held back"},
    {"contact_c", 0, "deg", "where the obstacle begins"},
    {"contact_side", 1, "", "+1 holds back c above contact_c, -1 below"},
    {"contact_soft", 0, "deg", "how far c goes until the obstacle holds in full; 0 a corner"},
};

static int present(const double *v) {
    return v[HOLD] != 0.0;
}

static void configure(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend) {
    (void)state, (void)now;
    const double beyond = (bend->c - v[FROM]) * v[SIDE], soft = v[SOFT];
    if (beyond > 0.0) {
        const double yields = soft > 0.0 ? exp(-beyond / soft) : 0.0;
        bend->c -= v[HOLD] * (beyond - soft * (1.0 - yields)) * v[SIDE];
        bend->gain *= 1.0 - v[HOLD] * (1.0 - yields);
    }
}

const struct effect effect_contact = {"configuration.contact", PLACE_CONTACT,         PARAMETERS, COUNT,
                                      .present = present,      .configure = configure};
