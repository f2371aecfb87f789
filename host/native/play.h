/* The play element, float64: the one that the host's simulations, fits and effects are made of.
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

/* Which side of its width an element lies against. */
enum { PLAY_INSIDE = 0, PLAY_RISING = 1, PLAY_FALLING = -1 };

struct play_table {
    const double *grid;
    const double *width;
    size_t n;
};

/* An element and where it stands. One that has a table moves in the motor's coordinate; one that has none moves in a
 * warp's (elements.h), where its width is the same everywhere. */
struct play {
    double at;       /* p, or its place in the warp */
    double half;     /* half its width there */
    double lean;     /* side times the scale it was pushed with (without a table: times its width): dp/dB = -lean / 2
                      * where B is constant, else divided by 1 + lean B'(p) / 2; 0 until it is pushed */
    size_t spans[2]; /* of the table, where the falling and the rising end were last: motion is continuous */
    int8_t side;     /* that last pushed it; PLAY_INSIDE until one does */
};

/* The span [i, i + 1] of `rising` (n >= 2, strictly) that x belongs to, from `at` on; the outermost ones reach beyond
 * the ends. O(log of the spans passed). */
size_t play_span(const double *rising, size_t n, size_t at, double x);

/* Whether the table satisfies the conditions above. O(n). */
int play_table_valid(const struct play_table *table);

/* B(p). *at is a span to start from (0), left at the span found. O(log of the spans passed). */
double play_width(const struct play_table *table, double p, size_t *at);

/* Where p is in a table: at and along of the span of length `step`; 0 beyond the ends, where a table is held. */
struct play_place {
    size_t at;
    double along, step;
};

/* Looks from span `from` (0 .. n-2) on. O(log of the spans passed). */
struct play_place play_find(const struct play_table *table, double p, size_t from);

/* There, of values on the table's grid. */
static inline double play_slope(const struct play_place *here, const double *values) {
    return here->step > 0.0 ? (values[here->at + 1] - values[here->at]) / here->step : 0.0;
}

static inline double play_value(const struct play_place *here, const double *values) {
    return values[here->at] + here->along * play_slope(here, values);
}

/* Mean width over the grid; of one node that node's. O(n). */
double play_mean_width(const struct play_table *table);

/* An element with a table at p. */
struct play play_start(const struct play_table *table, double p);

/* play_end from span *at on, for any q; by: half the scale, times side. */
double play_end_far(const struct play_table *table, double q, double by, size_t *at, double *half);

/* The p that solves p + side scale B(p)/2 = q, side 1 or -1, 0 <= scale, scale |B'| < 2; *half = B(p)/2. *at as in
 * play_width. O(1) where the grid is even and B changes little over the spans passed, else O(spans passed). */
static inline double play_end(const struct play_table *table, double q, double side, double scale, size_t *at,
                              double *half) {
    const double *grid = table->grid, *width = table->width;
    const double by = 0.5 * side * scale;
    size_t i = *at;
    if (i + 1 >= table->n) {
        return play_end_far(table, q, by, at, half);
    }
    double left = grid[i] + by * width[i], right = grid[i + 1] + by * width[i + 1];
    double share = (q - left) / (right - left);
    if (!(share > 0.0 && share < 1.0)) { /* as many spans on as of this one's length */
        const double on = (double)i + share, most = (double)(table->n - 2);
        *at = i = on < 0.0 ? 0 : (size_t)(on < most ? on : most);
        left = grid[i] + by * width[i];
        right = grid[i + 1] + by * width[i + 1];
        share = (q - left) / (right - left);
        if (!(share > 0.0 && share < 1.0)) {
            return play_end_far(table, q, by, at, half);
        }
    }
    *half = 0.5 * (width[i] + share * (width[i + 1] - width[i]));
    return grid[i] + share * (grid[i + 1] - grid[i]);
}

/* Pushes an element by its end on `side` (1 or -1), widths scaled, if the motor at q (in the element's coordinate) is
 * beyond it. table NULL: its width is the same everywhere. Returns by how far q is beyond the place at which it begins
 * to push: 0 where it pushes nothing. An infinite q against `side` never pushes. A few ns. */
static inline double play_push(struct play *play, const struct play_table *table, double q, double side, double scale) {
    const double beyond = side * (q - play->at) - scale * play->half;
    if (!(beyond > 0.0)) {
        return 0.0;
    }
    double half = play->half;
    const double at =
        table ? play_end(table, q, side, scale, &play->spans[side > 0.0], &half) : q - side * scale * half;
    if (!(side * (at - play->at) > 0.0)) {
        return 0.0; /* beyond by rounding only: it is at rest */
    }
    play->at = at;
    play->half = half;
    play->lean = side * scale * (table ? 1.0 : 2.0 * half);
    play->side = (int8_t)side;
    return beyond;
}

/* Indices of the samples at which q turns, into turns[0 .. count-1]; returns how many. A turn is the first sample at an
 * extreme from which q then goes back by more than `hysteresis` (>= 0, q's unit): an encoder that dithers by less does
 * not turn. O(count). */
size_t play_turns(const double *q, size_t count, double hysteresis, int32_t *turns);

#ifdef __cplusplus
}
#endif
#endif
