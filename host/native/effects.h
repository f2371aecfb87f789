// The simulated transmission with every effect of the library that has a path of its own, in float64.
// From the motor's motion to the configuration variable c; sight.h says where the marker is then seen.
#ifndef TAUTLINE_EFFECTS_H
#define TAUTLINE_EFFECTS_H

#include "elements.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// NAME(default, unit, meaning). Every default means "absent"; "unit" is the actuator's unit, mm or deg.
#define EFFECT_PARAMETERS(X)                                                                                           \
    X(encoder_sin, 0, "unit", "actuator.encoder_periodic: amplitude in phase with q = 0")                              \
    X(encoder_cos, 0, "unit", "actuator.encoder_periodic: amplitude a quarter turn on")                                \
    X(encoder_sin2, 0, "unit", "actuator.encoder_periodic: the same twice a turn")                                     \
    X(encoder_cos2, 0, "unit", "actuator.encoder_periodic: and an eighth of a turn on")                                \
    X(encoder_period, 1, "unit", "actuator.encoder_periodic: q per turn")                                              \
    X(onset_spread, 0, "", "transmission.smooth_onset: spread of the play's thresholds, of B; 0 to 1")                 \
    X(onset_tail, 0, "", "transmission.smooth_onset: 0 thresholds spread evenly, 1 exponentially from the least up")   \
    X(asymmetry, 0, "unit", "transmission.asymmetric_backlash: extra play after turning up (-: after turning down)")   \
    X(asymmetry_travel, 1, "unit", "transmission.asymmetric_backlash: travel in which the tip catches up")             \
    X(asymmetry_form, 1, "", "transmission.asymmetric_backlash: exponent; 1 exponential, 2 slow at first")             \
    X(width_per_speed, 0, "s", "transmission.rate_dependent_backlash: width added per speed, at a tenth of the grid")  \
    X(speed_exponent, 1, "", "transmission.rate_dependent_backlash: of the speed that the width grows with")           \
    X(speed_time, 0.02, "s", "transmission.rate_dependent_backlash: time in which the width follows the speed")        \
    X(width_held, 0, "",                                                                                               \
      "transmission.rate_dependent_backlash: 1 if a motor that rests or turns moves nothing, 0 if closing")            \
    X(lag, 0, "s", "transmission.lag: time constant")                                                                  \
    X(lag_second, 0, "", "transmission.lag: share of it in a second stage; 0 to 0.5")                                  \
    X(creep_share, 0, "", "transmission.creep: share of the motion that comes late; 0 to 1")                           \
    X(creep_time, 1, "s", "transmission.creep: its time constant")                                                     \
    X(creep_slow, 0, "", "transmission.creep: share of it that is five times slower; 0 to 1")                          \
    X(stick, 0, "unit", "transmission.stick_slip: motion held back until the tip jumps")                               \
    X(held_back, 0, "unit", "transmission.stick_slip: by how much it widens the play in the mean")                     \
    X(offset_drift, 0, "unit/s", "transmission.drift: of the centre coordinate, at first")                             \
    X(width_drift, 0, "1/s", "transmission.drift: of the width, relative, at first")                                   \
    X(drift_decay, 0, "1/s", "transmission.drift: 1 / the time in which it ends; 0 if it goes on")                     \
    X(width_per_load, 0, "1/mNm", "transmission.load_dependence: of the width, relative")                              \
    X(gain_per_load, 0, "1/mNm", "transmission.load_dependence: of c's distance from c(middle), relative")             \
    X(offset_per_load, 0, "unit/mNm", "transmission.load_dependence: of the centre coordinate")                        \
    X(c_per_translation, 0, "deg/mm", "configuration.axis_coupling")                                                   \
    X(c_per_rotation, 0, "deg/deg", "configuration.axis_coupling")                                                     \
    X(contact_hold, 0, "", "configuration.contact: share of the motion far beyond contact_c that is held back")        \
    X(contact_c, 0, "deg", "configuration.contact: where the obstacle begins")                                         \
    X(contact_side, 1, "", "configuration.contact: +1 holds back c above contact_c, -1 below")                         \
    X(contact_soft, 0, "deg", "configuration.contact: how far c goes until the obstacle holds in full; 0 a corner")    \
    X(tilt_travel, 0, "unit", "registration.direction_dependent: the tip's travel in which the instrument turns over")

struct effect_parameters {
#define X(name, absent, unit, meaning) double name;
    EFFECT_PARAMETERS(X)
#undef X
};

// Tables are linear between nodes and held beyond the ends (f_remain goes on with its end slopes); grid rises strictly;
// |dwidth| < 2 dgrid, width >= 0.
struct effect_tables {
    const double *grid;
    const double *width;
    const double *c_deg;
    size_t nodes;
    const struct elements *elements; // on grid and width; NULL: a single play
};

// Straight lines between knots, q held before the first and after the last.
struct effect_motion {
    const double *t_s; // (knots) rises
    const double *q;
    const double *load; // mNm or NULL, from which its reference has been taken away
    size_t knots;       // 1 or more
};

// When the path is asked for.
struct effect_times {
    const double *t_s;         // (count) rises
    const double *translation; // mm or NULL
    const double *rotation;    // deg or NULL
    size_t count;
    double session_s; // added to all times where an effect counts from the session's start (drift)
};

// Where the tip is, (count) each.
struct effect_path {
    double *c_deg;
    double *p;         // the play's centre coordinate
    double *tip;       // after lag, creep and stick: c = f_remain(tip) but for the configuration's effects
    double *gain;      // dc / df_remain
    double *way;       // which way the instrument lies in its channel, -1 to 1
    signed char *side; // the envelope that last carried the tip: +1 rising q, -1 falling, 0 not yet
};

// p0 NaN starts on the centre line. The play is exact at any sampling of a monotone q; lag and creep are exact for the
// straight lines between knots, asked times and the moments at which the tip is caught.
// About 80 ns per knot and time, 50 more for each element, 1 us with onset_spread.
void effects_simulate(const struct effect_parameters *e, const struct effect_tables *tables,
                      const struct effect_motion *motion, const struct effect_times *times, double p0,
                      const struct effect_path *path);

enum { EFFECT_CHANNELS = 4 };

// Which samples of `channels` (1 to EFFECT_CHANNELS, one after the other, each as long as t_s) to keep so that straight
// lines between them stay within `tolerance[channel]` of all samples. Both ends and the ends of every rest (no channel
// changes for longer than rest_s) are kept. keep[k] is 0 or 1. About 10 ns per value.
void effects_thin(const double *t_s, size_t samples, const double *values, const double *tolerance, size_t channels,
                  double rest_s, unsigned char *keep);

#ifdef __cplusplus
}
#endif
#endif
