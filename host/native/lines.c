#include "lines.h"

#include "play.h"

double lines_at(const struct lines *lines, double x, size_t *from) {
    const double *knot = lines->x, *y = lines->y;
    const size_t last = lines->knots - 1;
    if (x <= knot[0]) {
        return y[0];
    }
    if (x >= knot[last]) {
        return y[last];
    }
    if (!(x > knot[0])) {
        return x;
    }
    const double ahead = (double)*from + (x - knot[*from]) * lines->a_unit;
    const size_t guess = ahead > 0.0 ? (ahead < (double)last ? (size_t)ahead : last - 1) : 0;
    const size_t i = *from = play_span(knot, lines->knots, guess, x);
    return y[i] + (y[i + 1] - y[i]) / (knot[i + 1] - knot[i]) * (x - knot[i]);
}
