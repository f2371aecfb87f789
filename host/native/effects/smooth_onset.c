#include "effect.h"

#include <math.h>

enum { SPREAD, TAIL, COUNT };
static const struct effect_parameter PARAMETERS[COUNT] = {
    {"onset_spread", 0, "", "spread of the play's thresholds, of B; 0 to 1, with a tail of 1 to 2"},
    {"onset_tail", 0, "", "0 thresholds spread evenly, 1 exponentially from the least up"},
};

static int present(const double *v) {
    return v[SPREAD] != 0.0;
}

// The share of all thresholds above the i-th lot: they shrink towards the longest, whose tail is thin.
static double above(size_t i) {
    return pow(1.0 - (double)i / EFFECT_LOTS, 1.5);
}

// The mean threshold of a lot, in units of the spread: over all lots 0, evenly from -1 to 1, or exponentially from
// -1/2.
static double threshold(double tail_share, double most, double least) {
    const double even = 1.0 - most - least;
    const double logs = least > 0.0 ? least * log(least) : 0.0; // the integral of -log v is v - v log v
    const double tail = 0.5 * (logs - most * log(most)) / (most - least);
    return even + tail_share * (tail - even);
}

static size_t lots(const double *v, double *spread, double *share) {
    for (size_t i = 0; i < EFFECT_LOTS; i++) {
        const double most = above(i), least = above(i + 1);
        spread[i] = fmax(0.0, 1.0 + v[SPREAD] * threshold(v[TAIL], most, least));
        share[i] = most - least;
    }
    return EFFECT_LOTS;
}

const struct effect effect_smooth_onset = {"transmission.smooth_onset", PLACE_PLAY,  PARAMETERS, COUNT,
                                           .present = present,          .lots = lots};
