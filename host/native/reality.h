// The transmission of a second, independent instrument: other equations than those of effects.h, for blind tests.
#ifndef TAUTLINE_REALITY_H
#define TAUTLINE_REALITY_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// NAME(meaning). 0 is absent; a travel, time or scale that is not given is 1.
#define REALITY_FIELDS(X)                                                                                              \
    X(softness, "bristles: share of the slack over which they bend before they slide; 0 is a hard play")               \
    X(latch, "unit: friction that only one way has to break loose; > 0 rising, < 0 falling")                           \
    X(latch_travel, "unit: travel in which what it held back is caught up (half a cosine)")                            \
    X(viscosity, "s: slack per speed, saturating at speed_scale")                                                      \
    X(speed_scale, "unit/s")                                                                                           \
    X(setting, "unit: slack that grease adds which sets while the pin rests, at most")                                 \
    X(setting_time, "s: in which most of it sets")                                                                     \
    X(setting_travel, "unit: travel that breaks it up")                                                                \
    X(dashpot, "s: two equal viscous elements in series, half of it each")                                             \
    X(creep_share, "of the motion that two Kelvin elements give late")                                                 \
    X(creep_time, "s: of the faster; the other is 5 times slower")                                                     \
    X(static_grip, "unit: stretch at which the tip breaks loose; 0 slides")                                            \
    X(kinetic_grip, "share of static_grip that stays stretched after a slip")                                          \
    X(grip_scatter, "relative, of the static grip from slip to slip")                                                  \
    X(ring_hz, "a tip that rings: natural frequency, 0 none")                                                          \
    X(ring_damping, "of critical")                                                                                     \
    X(bulge, "unit: Bouc-Wen hysteresis inside the envelopes")                                                         \
    X(bulge_travel, "unit")

struct reality {
#define X(name, meaning) double name;
    REALITY_FIELDS(X)
#undef X
};

struct reality_tables {
    const double *grid, *width;
    size_t nodes;
};

// q, extra_width (factor) of every sample -> p, the coordinate that f_remain bends; and which way the tip was last
// carried (+1, -1, 0). Times rise strictly.
void reality_transmission(const struct reality *r, const struct reality_tables *tables, const double *t_s,
                          const double *q, const double *width_factor, size_t n, double start, uint64_t seed, double *p,
                          double *way);

// lies[k], -1 to 1: which way the instrument lies in its channel; friction of the tip as it moves to p[k], carried
// `way`, turns it over within about `travel` (unit, > 0) of motion.
void reality_rocking(const double *p, const double *way, size_t n, double travel, double *lies);

#ifdef __cplusplus
}
#endif
#endif
