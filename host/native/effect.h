// What one effect of the library is made of: its parameters and what it does at each place of the chain. An effect is
// one file, effects/NAME.c, that defines `const struct effect effect_NAME`; the build lists the files.
#ifndef TAUTLINE_EFFECT_H
#define TAUTLINE_EFFECT_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// Every value when absent means that the effect does nothing. "unit" is the actuator's unit, mm or deg.
struct effect_parameter {
    const char *name;
    double absent;
    const char *unit, *meaning;
};

// Where an effect stands among those that change the same thing; the chain goes through them in this order.
enum {
    PLACE_ENCODER,
    PLACE_DRIVE,
    PLACE_PLAY,
    PLACE_LAG,
    PLACE_CREEP,
    PLACE_STICK,
    PLACE_SWING,
    PLACE_GAIN,
    PLACE_COUPLING,
    PLACE_CONTACT,
    PLACE_CHANNEL
};

enum { EFFECT_STATES = 6 }; // numbers that an effect may remember, zero at first

// One moment of the simulation: a knot of the motion, a time that is asked for, or one that an effect asked for.
struct effect_moment {
    double session_s;             // time in the session
    double dt, moved;             // since the moment before: s, and of the motor as it reads; 0 at first
    double load, other;           // mNm beyond its reference; another joint's position, its own unit
    double translation, rotation; // of the instrument, mm, deg
    double usual_speed;           // of the motor: a tenth of the tables' grid per second
    double wide;                  // B where the tip is, over its mean
    double slope;                 // of f_remain over the whole range, deg per unit
    int first, at_knot;
};

// What drives the play.
struct effect_drive {
    double q;       // where the motor is
    double scale;   // of B
    double extra;   // width beside it
    double way;     // of the motor, where a play is carried only in it; else 0
    double again_s; // the next moment comes after so much time at the latest
};

// What a play that slides on one side remembers.
struct effect_contact {
    double since; // travel since that side began to carry
    double age_s; // of what touches: s at rest, less what sliding has worn off
    double wide;  // B there, over its mean
};

// By how much friction differs at a place from its mean, if a share of it (>= 0) goes as B does: what presses there
// presses for all friction, but a clearance is none. wide: B there over its mean.
double effect_pressed(double share, double wide);

struct effect_chain; // the effects that are still to come of those that follow

// Hands a straight piece of the centre's motion, from u0 to u1 in dt s, on to the next.
void effect_pass(struct effect_chain *chain, double u0, double u1, double dt);

struct effect_bend {
    double c, gain; // deg; dc / df_remain
    double middle;  // f_remain in the middle of the range, deg
    double slope;   // of f_remain over the whole range, deg per unit
};

enum { EFFECT_LOTS = 21 }; // of thresholds that stand for a spread one: a corner becomes a polygon of as many pieces

// v: the effect's parameters in their order; state: what it remembers. NULL: it does nothing there.
struct effect {
    const char *id; // stage.name
    int place;
    const struct effect_parameter *parameters;
    size_t count;
    int (*present)(const double *v);
    double (*shaft)(const double *v, double q); // where the motor is that reads q
    void (*drive)(const double *v, double *state, const struct effect_moment *now, struct effect_drive *drive);
    // A play's thresholds in lots, in units of B's, and how many of all are in each; returns the number of lots.
    size_t (*lots)(const double *v, double *spread, double *share);
    double (*late)(const double *v, int side, const struct effect_contact *contact); // play (>= 0) beside B on a side
    void (*slide)(const double *v, struct effect_contact *contact, double way);      // a side that carries
    double (*renewed_s)(const double *v); // after so long a rest a side begins to carry anew
    double (*drag_s)(const double *v);    // in which a play that is pushed comes to where it is pushed to
    // Moves what nothing holds within the play, of place *at and speed *speed, on by dt s; the play's ends stop it.
    void (*fall)(const double *v, double dt, double *at, double *speed);
    void (*start)(const double *v, double *state, double centre);
    void (*follow)(const double *v, double *state, struct effect_chain *chain, double u0, double u1, double dt);
    double (*hold)(const double *v, double *state, double tip); // where the tip stays that would be there
    void (*configure)(const double *v, const double *state, const struct effect_moment *now, struct effect_bend *bend);
    // Which way the instrument lies in its channel after a step. moved: the tip, by f_remain over its mean slope, unit.
    double (*lie)(const double *v, double lies, double moved, const struct effect_moment *now);
};

// A first-order element of state y whose input goes from u0 to u1 in a straight line.
double effect_first_order(double y, double u0, double u1, double dt, double time);

#ifdef __cplusplus
}
#endif
#endif
