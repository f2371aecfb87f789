#include "elements.h"

#include <math.h>

#include "play.h"

/* The span of `rising` that x belongs to, from `at` on; the outermost ones reach beyond the ends. */
static size_t span_of(const double *rising, size_t knots, size_t at, double x) {
    size_t low = at;
    size_t high = at + 1;
    for (size_t step = 1; low > 0 && x < rising[low]; step *= 2) {
        high = low;
        low = low > step ? low - step : 0;
    }
    for (size_t step = 1; high < knots - 1 && x >= rising[high]; step *= 2) {
        low = high;
        high = high + step < knots - 1 ? high + step : knots - 1;
    }
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (x < rising[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return low;
}

static double along(const double *from, const double *to, size_t knots, struct warp_cursor *cursor, double value) {
    const size_t i = cursor->at = span_of(from, knots, cursor->at, value);
    return to[i] + (value - from[i]) * (to[i + 1] - to[i]) / (from[i + 1] - from[i]);
}

double warp_to(const struct warp *warp, struct warp_cursor *cursor, double q) {
    return along(warp->q, warp->x, warp->knots, cursor, q);
}

double warp_from(const struct warp *warp, struct warp_cursor *cursor, double x) {
    return along(warp->x, warp->q, warp->knots, cursor, x);
}

static double width_at(const struct elements *e, double p, size_t *at) {
    const size_t last = e->nodes - 1;
    if (last == 0 || p <= e->grid[0]) {
        return e->width[0];
    }
    if (p >= e->grid[last]) {
        return e->width[last];
    }
    const size_t i = *at = span_of(e->grid, e->nodes, *at, p);
    return e->width[i] + (p - e->grid[i]) * (e->width[i + 1] - e->width[i]) / (e->grid[i + 1] - e->grid[i]);
}

/* The warp belongs to a width that is nowhere below `narrow`. */
static double warped_width(const struct elements *e, double p, size_t *at) {
    return fmax(width_at(e, p, at), e->narrow);
}

double elements_centre(const struct elements *e, struct warp_cursor *cursor, double p) {
    size_t at = 0;
    return warp_to(&e->warp, cursor, p - 0.5 * warped_width(e, p, &at)) + 0.5;
}

double elements_position(const struct elements *e, struct warp_cursor *low, struct warp_cursor *high, double y) {
    return 0.5 * (warp_from(&e->warp, low, y - 0.5) + warp_from(&e->warp, high, y + 0.5));
}

static double clamped(double value, double low, double high) {
    return fmin(fmax(value, low), high);
}

/* sum w_i z_i is a rising, piecewise straight function of the common value, with corners at x -+ r_i. */
void elements_start(const struct elements *e, double x, double y, double *z) {
    double common = clamped(y, x - 0.5, x + 0.5) - x;
    const double sign = common < 0.0 ? -1.0 : 1.0;
    double left = fabs(common);
    double rest = 1.0; /* the weight of those that are not yet at their ends */
    double from = 0.0;
    for (size_t i = 0; i < e->n; i++) {
        if (left <= rest * (e->r[i] - from)) {
            break;
        }
        left -= rest * (e->r[i] - from);
        from = e->r[i];
        rest -= e->w[i];
    }
    common = from + (rest > 1e-9 ? left / rest : 0.0);
    for (size_t i = 0; i < e->n; i++) {
        z[i] = x + sign * fmin(common, e->r[i]);
    }
}

/* The single play beside the elements. */
struct beside {
    double p;
    size_t low_at, high_at, width_at;
};

static void beside_move(const struct elements *e, struct beside *single, double q) {
    const double low = play_envelope(q, 1.0, e->grid, e->width, e->nodes, &single->low_at);
    const double high = play_envelope(q, -1.0, e->grid, e->width, e->nodes, &single->high_at);
    single->p = clamped(single->p, low, high);
}

void elements_forward(const struct elements *e, const double *q, size_t count, double p0, double *p, int8_t *side,
                      double *lean, double *share) {
    struct warp_cursor in = {0}, low = {0}, high = {0};
    struct beside single = {0};
    double z[ELEMENTS_MAX] = {0};
    double pushed[ELEMENTS_MAX] = {0};
    int8_t lies = 0;
    if (count > 0) {
        single.p = isnan(p0) ? q[0] : p0;
        elements_start(e, warp_to(&e->warp, &in, q[0]), elements_centre(e, &low, single.p), z);
    }
    for (size_t k = 0; k < count; k++) {
        const double x = warp_to(&e->warp, &in, q[k]);
        double y = 0.0, leans = 0.0, moves = 0.0;
        for (size_t i = 0; i < e->n; i++) {
            const double before = z[i];
            z[i] = clamped(before, x - e->r[i], x + e->r[i]);
            y += e->w[i] * z[i];
            if (z[i] != before) {
                pushed[i] = z[i] > before ? 1.0 : -1.0;
                moves += e->w[i];
            }
            leans += 2.0 * e->w[i] * e->r[i] * pushed[i];
        }
        if (lean) {
            lean[k] = leans;
        }
        if (share) {
            share[k] = moves;
        }
        p[k] = elements_position(e, &low, &high, y);
        if (e->narrow > 0.0) {
            beside_move(e, &single, q[k]);
            if (width_at(e, p[k], &single.width_at) < e->narrow) {
                p[k] = single.p;
            }
        }
        if (side) {
            const double widest = e->r[e->n - 1];
            lies = z[e->n - 1] == x - widest ? 1 : (z[e->n - 1] == x + widest ? -1 : lies);
            side[k] = lies;
        }
    }
}

/* The plays on y that undo all elements but the first. */
struct undoing {
    double rho[ELEMENTS_MAX];
    double v[ELEMENTS_MAX];
    double state[ELEMENTS_MAX];
};

/* The j-th play on y stands where y would be if all elements below the j-th were where the j-th is. */
static void undoing_start(const struct elements *e, const double *z, struct undoing *u) {
    double weight = 0.0, moment = 0.0, inverse = 0.0, above = 0.0;
    for (size_t i = 0; i < e->n; i++) {
        above += e->w[i] * z[i];
    }
    for (size_t j = 0; j < e->n; j++) {
        weight += e->w[j];
        moment += e->w[j] * e->r[j];
        above -= e->w[j] * z[j];
        u->rho[j] = weight * e->r[j] - moment;
        u->v[j] = 1.0 / weight - inverse;
        inverse = 1.0 / weight;
        u->state[j] = weight * z[j] + above;
    }
}

void elements_inverse(const struct elements *e, const double *p, size_t count, double q0, double p0, double *q) {
    struct warp_cursor in = {0}, out = {0};
    struct undoing undo;
    double z[ELEMENTS_MAX];
    size_t at = 0;
    double x = warp_to(&e->warp, &out, q0);
    elements_start(e, x, elements_centre(e, &in, p0), z);
    undoing_start(e, z, &undo);
    double before_s = z[0], before_p = p0, here = q0;
    for (size_t k = 0; k < count; k++) {
        const double width = width_at(e, p[k], &at);
        const double y = warp_to(&e->warp, &in, p[k] - 0.5 * fmax(width, e->narrow)) + 0.5;
        double s = 0.0;
        for (size_t j = 0; j < e->n; j++) {
            undo.state[j] = clamped(undo.state[j], y - undo.rho[j], y + undo.rho[j]);
            s += undo.v[j] * undo.state[j];
        }
        const double way = p[k] - before_p;
        if (way != 0.0) {
            x = s != before_s ? s + (s > before_s ? e->r[0] : -e->r[0]) : x;
            here = width < e->narrow ? p[k] + (way > 0.0 ? 0.5 : -0.5) * width : warp_from(&e->warp, &out, x);
        }
        before_s = s;
        before_p = p[k];
        q[k] = here;
    }
}
