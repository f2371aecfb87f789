#include "effect.h"

#include <math.h>

enum { WIDTH, TIME, TRAVEL, PRESSED, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"rest_width", 0, "unit", "width that a rest of a second adds before the tip moves again"},
    {"rest_time", 1, "s", "rest from which on the width grows with its logarithm"},
    {"rest_travel", 1, "unit", "travel that wears it off"},
    {"rest_pressed", 0, "", "share of it that goes with the place as B does"},
};

static int present(const double *v) {
    return v[WIDTH] != 0.0;
}

static double growth(const double *v, double age_s) {
    return log1p(age_s / v[TIME]);
}

static double late(const double *v, int side, const struct effect_contact *contact) {
    (void)side;
    const double of_a_second = fmax(v[WIDTH], 0.0) * effect_pressed(v[PRESSED], contact->wide);
    return of_a_second * growth(v, contact->age_s) / growth(v, 1.0);
}

static void slide(const double *v, struct effect_contact *contact, double way) {
    contact->age_s = v[TIME] * expm1(growth(v, contact->age_s) * exp(-way / v[TRAVEL]));
}

// Its age remembers a rest of any length, so no side begins anew.
const struct effect effect_rest_dependent_backlash = {"transmission.rest_dependent_backlash",
                                                      PLACE_PLAY,
                                                      PARAMETERS,
                                                      COUNT,
                                                      .present = present,
                                                      .late = late,
                                                      .slide = slide};
