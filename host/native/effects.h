// The simulated transmission with every effect of the library that has a path of its own, in float64.
// From the motor's motion to the configuration variable c; projection.h says where the marker is then seen.
#ifndef TAUTLINE_EFFECTS_H
#define TAUTLINE_EFFECTS_H

#include "effect.h"
#include "elements.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// The parameters of all effects (effects/*.c), one effect after the other in the build's order.
size_t effects_parameter_count(void);
const struct effect_parameter *effects_parameter(size_t i);
const char *effects_owner(size_t i); // the id of the effect that parameter i belongs to

// A play's thresholds in lots (EFFECT_LOTS at most), in units of its own, and how many of all are in each: their
// number.
size_t effects_lots(const double *values, double *spread, double *share);

// The rest, s, after which a side that these hold back begins to carry anew; INFINITY: none does.
double effects_renewed_s(const double *values);

// f_remain on the nodes of the elements' backlash table (2 or more), linear between them; it goes on with its end
// slopes.
struct effect_tables {
    const struct elements *elements;
    const double *c_deg;
};

// Straight lines between knots, q held before the first and after the last.
struct effect_motion {
    const double *t_s; // (knots) rises
    const double *q;
    const double *load;        // mNm or NULL, from which its reference has been taken away
    const double *other;       // another joint that moves along, or NULL
    const double *translation; // of the instrument, mm or NULL
    const double *rotation;    // deg or NULL
    size_t knots;              // 1 or more
};

// When the path is asked for.
struct effect_times {
    const double *t_s; // (count) rises
    size_t count;
    double session_s; // added to all times where an effect counts from the session's start (drift)
};

// Where the tip is, (count) each.
struct effect_path {
    double *c_deg;
    double *p;                      // the play's centre coordinate
    double *tip;                    // after lag, creep and stick: c = f_remain(tip) but for the configuration's effects
    double *gain;                   // dc / df_remain
    double *way;                    // which way the instrument lies in its channel, -1 to 1
    double *lean;                   // -2 dp/dB where B is constant, of all elements
    double *translation, *rotation; // of the instrument, or NULL
    signed char *side;              // the envelope that last carried the tip: +1 rising q, -1 falling, 0 not yet
};

// values: of all parameters, in order. p0 NaN starts on the centre line. The play is exact at any sampling of a
// monotone q; lag and creep are exact for the straight lines between knots, asked times and the moments at which the
// tip is caught. About 80 ns per knot and time, 50 more for each element, 1 us with a spread onset.
void effects_simulate(const double *values, const struct effect_tables *tables, const struct effect_motion *motion,
                      const struct effect_times *times, double p0, const struct effect_path *path);

#ifdef __cplusplus
}
#endif
#endif
