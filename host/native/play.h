/* The play operator in motor space, float64: the host's simulations and fits.
 *
 * A backlash table is `width[i]` at `grid[i]` (motor units, i = 0 .. n-1, n >= 1, grid strictly rising, width >= 0,
 * |width'| < 2), linear between its nodes and held beyond its ends. p is the centre coordinate, B(p) the table:
 *     p[k] = min(max(p[k-1], p_lo(q[k])), p_hi(q[k])),   p_lo + B(p_lo)/2 = q,   p_hi - B(p_hi)/2 = q
 * Both solutions are exact on the linear table. (brief "The method"; the paper's eq. 3 in motor space.)
 */
#ifndef TAUTLINE_PLAY_H
#define TAUTLINE_PLAY_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What holds p at a sample. */
enum { PLAY_INSIDE = 0, PLAY_RISING = 1, PLAY_FALLING = -1 };

/* Whether the table satisfies the conditions above. O(n). */
int play_table_valid(const double *grid, const double *width, size_t n);

/* The p that solves p + side B(p)/2 = q, side 1 or -1. *at is a node to start from (0), left at the node found. O(nodes
 * passed). */
double play_envelope(double q, double side, const double *grid, const double *width, size_t n, size_t *at);

/* p[k] for the motor positions q[k], k = 0 .. count-1. p0 is the state before q[0]; NaN: p0 = q[0].
 * side[k] (NULL: not wanted): the envelope that last moved p, PLAY_INSIDE as long as none did.
 * anchor[k] (NULL: not wanted): the sample that last moved p, -1 as long as none did. At it q[anchor] and p[k] are
 * joined by the envelope `side`, so dp/dtheta = -side (dB/dtheta)/2 / (1 + side B'(p)/2).
 * O(count + nodes passed). */
void play_forward(const double *q, size_t count, const double *grid, const double *width, size_t n, double p0,
                  double *p, int8_t *side, int32_t *anchor);

/* Indices of the samples at which q turns, into turns[0 .. count-1]; returns how many. A turn is the first sample at an
 * extreme from which q then goes back by more than `hysteresis` (>= 0, q's unit): an encoder that dithers by less does
 * not turn. O(count). */
size_t play_turns(const double *q, size_t count, double hysteresis, int32_t *turns);

#ifdef __cplusplus
}
#endif
#endif
