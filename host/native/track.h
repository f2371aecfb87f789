/* The play elements of a model whose tables are being tracked, float64: with a state that is kept from call to call,
 * and with derivatives by every parameter that may have changed.
 *
 * All elements share the width B(p) at the common centre coordinate p, so that B can change without a new warp
 * (elements.h):
 *     z_i[k] = min(max(z_i[k-1], q - a_i B(p)/2), q + a_i B(p)/2),   p = sum w_i z_i
 * solved for p at every sample. Each is a play.h element without a table, pushed by a_i of the width that is the same
 * for all; one element is the play with the table. Full strokes lie on p +- B(p)/2 = q whatever the
 * elements are, as sum w_i a_i = 1; inside, several differ from elements.h by what B changes over B.
 */
#ifndef TAUTLINE_TRACK_H
#define TAUTLINE_TRACK_H

#include "play.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TRACK_ELEMENTS = 12, TRACK_PARAMETERS = 16 };

/* Parameters, in the order of the derivatives: an offset added to q; `bases` tables dB/dtheta on the grid of B, row by
 * row; `shapes` rows da_i/dtheta of the elements' shares. */
struct track_model {
    struct play_table table; /* B */
    const double *share;     /* (n) a_i >= 0 */
    const double *weight;    /* (n) sum 1, sum w_i a_i = 1 */
    size_t n;                /* 1 .. TRACK_ELEMENTS */
    const double *basis;     /* (bases, table.n) */
    size_t bases;
    const double *shape; /* (shapes, n) */
    size_t shapes;
};

struct track_state {
    struct play of[TRACK_ELEMENTS];              /* z_i is where each is at, half that of B(p) */
    double by[TRACK_ELEMENTS][TRACK_PARAMETERS]; /* dz_i/dtheta */
    double lean;                                 /* sum w_i a_i side_i: +1 on the rising envelope, -1 on the falling */
    double driven;                               /* the weight of elements that have been pushed */
    double p;
    size_t at; /* the table's span that p is in */
};

/* All elements at p, pushed by nobody. */
void track_start(struct track_state *state, size_t n, double p);

/* Moves the motor to q[k], k = 0 .. count-1 (the offset is in q already). p (count); moving (count): the weight of
 * elements that are being pushed, with the sign of their way; by (count, 1 + bases + shapes), NULL: without
 * derivatives. O(count n (1 + parameters)). */
void track_run(const struct track_model *model, struct track_state *state, const double *q, size_t count, double *p,
               double *moving, double *by);

#ifdef __cplusplus
}
#endif
#endif
