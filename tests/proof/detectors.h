// A detector of any content, with as many samples as it may hold.
#ifndef TAUTLINE_PROOF_DETECTORS_H
#define TAUTLINE_PROOF_DETECTORS_H

#include "sums.h"

static tl_onset_detector_t d;

static void any_detector(void) {
    d.direction = (int8_t)Frama_C_nondet(-1, 1);
    d.oldest = (uint8_t)Frama_C_unsigned_int_interval(0, TL_ONSET_WINDOW - 1U);
    d.held = (uint8_t)Frama_C_unsigned_int_interval(1, TL_ONSET_WINDOW);
    d.config.frames_max = (uint8_t)Frama_C_unsigned_int_interval(3, TL_ONSET_WINDOW - 2U);
    d.reference_u = ANY();
    d.reference_v = ANY();
    d.reversal.q1 = ANY();
    d.all = any_sums();
    for (unsigned i = 0; i < TL_ONSET_WINDOW; i++) {
        d.window[i].q = ANY();
        d.window[i].u = ANY();
        d.window[i].v = ANY();
        d.window[i].weight = Frama_C_int_interval(1, 64);
    }
}

#endif
