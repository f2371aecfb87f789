/* Hysteresis of presliding friction, float64: one state instead of plays, on the same full-stroke envelopes.
 *
 * p_lo + B(p_lo)/2 = q and p_hi - B(p_hi)/2 = q are the envelopes of play.h. With z between -1 and 1:
 *     p = ((1 + z) p_lo + (1 - z) p_hi) / 2,   dz = dq R(s z) / L,   s = sgn dq,   L = length + share B(q)
 *     Bouc-Wen:  R(u) = 1 - (beta sgn u + 1 - beta) |u|^exponent
 *     Dahl:      R(u) = (1 - u)^exponent
 * R(1) = 0: on a long rising stroke z = 1 and p = p_lo, whatever the rest is. The tip never goes back while
 * L >= B R(-1) / 2, R(-1) being 2 beta or 2^exponent. Where a share below 0 would make L nothing it is held at a
 * millionth of its most.
 */
#ifndef TAUTLINE_FRICTION_H
#define TAUTLINE_FRICTION_H

#include "play.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { FRICTION_BOUC_WEN = 1, FRICTION_DAHL = 2 };
enum { FRICTION_LENGTH, FRICTION_SHARE, FRICTION_EXPONENT, FRICTION_BETA, FRICTION_VALUES };

struct friction {
    int kind;                      /* 0: there is none */
    double value[FRICTION_VALUES]; /* length, q's unit; share, of B; exponent > 0; beta, 0 .. 1 (Dahl: not read) */
    double least;                  /* of L: friction_least's */
    const double *travel;          /* (3 n): at the table's nodes the integral of dq / L, and its derivatives by length
                                    * and share: friction_travel's */
};

struct friction_state {
    double z, q, travel;
    double low, high;           /* the envelopes at q */
    double by[FRICTION_VALUES]; /* dz / dvalue */
    double by_q;                /* dz / dq of the last step, where it ended */
    double by_travel[2];        /* the integral's derivatives at q, by length and share */
    size_t spans[2], at;
    signed char side; /* of the envelope that p last came near to; PLAY_INSIDE until it does */
};

/* O(n). */
double friction_least(const struct friction *f, const struct play_table *table);

/* Fills f->travel, (3 n). O(n). */
void friction_travel(const struct friction *f, const struct play_table *table, double *travel);

/* R(u). */
double friction_rate(const struct friction *f, double u);

/* The motor at q, the centre coordinate as near to p as the envelopes allow. */
void friction_start(const struct friction *f, const struct play_table *table, double q, double p,
                    struct friction_state *state);

/* The motor goes to q in a straight line, B being scaled and `extra` wider. Returns p. slopes: state->by goes along.
 * Dahl's exactly; Bouc-Wen's by Runge and Kutta's fourth order, in steps that its error allows: about 1 us a length L,
 * less on an envelope. */
double friction_move(const struct friction *f, const struct play_table *table, struct friction_state *state, double q,
                     double scale, double extra, int slopes);

/* dp/dB = -lean / 2 where B is constant, and dp/dq there. */
double friction_lean(const struct friction *f, const struct friction_state *state);
double friction_follows(const struct friction_state *state);

/* dp / dvalue. */
double friction_slope(const struct friction_state *state, int value);

/* The q to which the motor has to go in a straight line from where it is for p to be there, `way` (+-1) being p's
 * way; the state goes along. Bisection, O(60) moves. */
double friction_seek(const struct friction *f, const struct play_table *table, struct friction_state *state, double p,
                     double way);

#ifdef __cplusplus
}
#endif
#endif
