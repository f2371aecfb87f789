// The simulated transmission with every effect of the library that has a path of its own, in float64.
// From motor samples to the configuration variable c; geometry and camera follow in Python.
#ifndef TAUTLINE_EFFECTS_H
#define TAUTLINE_EFFECTS_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// NAME(default, unit, meaning). Every default means "absent"; "unit" is the actuator's unit, mm or deg.
#define EFFECT_PARAMETERS(X)                                                                                           \
    X(encoder_sin, 0, "unit", "actuator.encoder_periodic: amplitude in phase with q = 0")                              \
    X(encoder_cos, 0, "unit", "actuator.encoder_periodic: amplitude a quarter turn on")                                \
    X(encoder_period, 1, "unit", "actuator.encoder_periodic: q per turn")                                              \
    X(onset_spread, 0, "", "transmission.smooth_onset: spread of the play's thresholds, of B; 0 to 1")                 \
    X(asymmetry, 0, "unit", "transmission.asymmetric_backlash: extra play after turning up (-: after turning down)")   \
    X(asymmetry_travel, 1, "unit", "transmission.asymmetric_backlash: travel in which the tip catches up")             \
    X(width_per_speed, 0, "s", "transmission.rate_dependent_backlash: width added per speed")                          \
    X(width_held, 0, "",                                                                                               \
      "transmission.rate_dependent_backlash: 1 if the width stays while the motor rests, 0 if it closes")              \
    X(lag, 0, "s", "transmission.lag: time constant")                                                                  \
    X(creep_share, 0, "", "transmission.creep: share of the motion that comes late; 0 to 1")                           \
    X(creep_time, 1, "s", "transmission.creep: its time constant")                                                     \
    X(stick, 0, "unit", "transmission.stick_slip: motion held back until the tip jumps")                               \
    X(offset_drift, 0, "unit/s", "transmission.drift: of the centre coordinate")                                       \
    X(width_drift, 0, "1/s", "transmission.drift: of the width, relative")                                             \
    X(width_per_load, 0, "1/mNm", "transmission.load_dependence: of the width, relative")                              \
    X(gain_per_load, 0, "1/mNm", "transmission.load_dependence: of c's distance from c(middle), relative")             \
    X(offset_per_load, 0, "unit/mNm", "transmission.load_dependence: of the centre coordinate")                        \
    X(c_per_translation, 0, "deg/mm", "configuration.axis_coupling")                                                   \
    X(c_per_rotation, 0, "deg/deg", "configuration.axis_coupling")                                                     \
    X(contact_hold, 0, "", "configuration.contact: share of the motion beyond contact_c that is held back; 0 to 1")    \
    X(contact_c, 0, "deg", "configuration.contact: where the obstacle begins")                                         \
    X(contact_side, 1, "", "configuration.contact: +1 holds back c above contact_c, -1 below")

struct effect_parameters {
#define X(name, absent, unit, meaning) double name;
    EFFECT_PARAMETERS(X)
#undef X
};

// Tables are linear between nodes and held beyond the ends; grid rises strictly; |dwidth| < 2 dgrid, width >= 0.
struct effect_tables {
    const double *grid;
    const double *width;
    const double *c_deg;
    size_t nodes;
};

struct effect_motion {
    const double *t_s; // rises strictly; drift counts from t = 0
    const double *q;
    const double *translation; // mm or NULL
    const double *rotation;    // deg or NULL
    const double *load;        // mNm or NULL, from which its reference has been taken away
    size_t samples;
};

// Writes c (deg), p (centre coordinate the tip follows, before lag, creep and stick) and side (the envelope
// that last carried the tip: +1 rising q, -1 falling, 0 not yet) for every motor sample.
// p0 NaN starts on the centre line. About 60 ns a sample; 0.4 us with onset_spread.
void effects_simulate(const struct effect_parameters *e, const struct effect_tables *tables,
                      const struct effect_motion *motion, double p0, double *c_deg, double *p, signed char *side);

#ifdef __cplusplus
}
#endif
#endif
