/* Several play elements on one backlash table, float64: the transmission whose motion starts gradually.
 *
 * A warp x = G(q), strictly rising, makes every width one: G(p + B(p)/2) - G(p - B(p)/2) = 1. g is its inverse. With
 * elements 0 <= r_1 < ... < r_n of weights w_i > 0, sum w_i = 1, sum w_i r_i = 1/2:
 *     z_i[k] = min(max(z_i[k-1], x - r_i), x + r_i),   y = sum w_i z_i,   p = (g(y + 1/2) + g(y - 1/2)) / 2
 * so that p + B(p)/2 = q on the rising stroke and p - B(p)/2 = q on the falling one, whatever n is.
 * Its inverse splits the first element off, s = z_1, and undoes the others as plays on y:
 *     s = sum v_j play_{rho_j}(y),  W_j = sum_{i<=j} w_i,  rho_j = sum_{i<=j} w_i (r_j - r_i),  v_j = 1/W_j - 1/W_{j-1}
 *     x = s + r_1 while s rises, s - r_1 while it falls, held at rest;   q = g(x)
 * Where B(p) < narrow one element on the table itself is used instead: no warp is of use where nothing is lost. So it
 * is everywhere where there is no warp: a single play. Or friction (friction.h) stands for all plays.
 */
#ifndef TAUTLINE_ELEMENTS_H
#define TAUTLINE_ELEMENTS_H

#include "friction.h"
#include "play.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ELEMENTS_MAX = 12 };

/* G: straight between knots, both columns strictly rising; beyond the ends it goes on with the last slopes. */
struct warp {
    const double *q;
    const double *x;
    size_t knots; /* 2 or more; 0: there is none */
};

/* A backlash table, its warp and the elements on it. Without a warp it is one element, of the table's width. */
struct elements {
    struct play_table table;
    struct warp warp;
    const double *r;          /* (n) rising from 0 or more; not read without a warp, nor is w */
    const double *w;          /* (n) > 0 */
    size_t n;                 /* 1 .. ELEMENTS_MAX */
    double narrow;            /* 0: nowhere */
    struct friction friction; /* of kind 0: plays */
};

/* Where a look-up was last: motion is continuous, so the next is near. */
struct warp_cursor {
    size_t at;
};

/* G(q), and g(x). O(log of the knots passed). */
double warp_to(const struct warp *warp, struct warp_cursor *cursor, double q);
double warp_from(const struct warp *warp, struct warp_cursor *cursor, double x);

/* What goes along with the elements while they move. */
struct elements_course {
    struct warp_cursor in[2]; /* of the falling and the rising end */
    struct warp_cursor out[2];
    size_t width_at;
};

/* The table that an element moves on: play_push's `table`. */
static inline const struct play_table *elements_table(const struct elements *e) {
    return e->warp.knots ? NULL : &e->table;
}

/* Where the motor at q is for its rising (side 1) or falling end, in the elements' coordinate. */
static inline double elements_motor(const struct elements *e, struct elements_course *course, double q, int side) {
    return e->warp.knots ? warp_to(&e->warp, &course->in[side > 0], q) : q;
}

/* Puts elements (n) where the centre coordinate is p, the motor being at q: of several in the state nearest to one
 * common value whose mean is there; p is brought within their reach. */
void elements_start(const struct elements *e, double q, double p, struct play *of, struct elements_course *course);

/* The centre coordinate of several whose mean sum w_i z_i is y. single: the play of the table, moved along with them if
 * the table is narrow anywhere. */
double elements_centre(const struct elements *e, struct elements_course *course, double y, const struct play *single);

/* p[k] for the motor positions q[k], k = 0 .. count-1. p0 is the centre coordinate before q[0]; NaN: p0 = q[0].
 * side[k] (NULL: not wanted): the envelope that last held p, of several elements all of them; +1 rising, -1 falling, 0
 * as long as none did. Once they have lain on both, p does not depend on p0. lean[k] and share[k] (NULL: not wanted)
 * are p's derivatives where B is constant: dp/dB = -lean / 2, each element leaning to the side that last pushed it, and
 * dp/dq = share, of the weights that moved. by (count, FRICTION_VALUES) or NULL: p's derivatives by friction's values.
 * O(count n). */
void elements_forward(const struct elements *e, const double *q, size_t count, double p0, double *p, int8_t *side,
                      double *lean, double *share, double *by);

/* q[k] that lead forward's p along p[k], k = 0 .. count-1, the motor being at q0 with the tip at p0 before p[0]. While
 * p rests so does q. Exact within |q - p| <= B(p)/2 of the start; where the tip comes within B of a place that is
 * narrow, to `narrow`. O(count n). */
void elements_inverse(const struct elements *e, const double *p, size_t count, double q0, double p0, double *q);

#ifdef __cplusplus
}
#endif
#endif
