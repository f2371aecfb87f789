#include "friction.h"

#include <math.h>

#define STEP     0.015625 /* tolerance: of a length: Runge and Kutta's error is then below 1e-8 of B */
#define PIECES   32768    /* limit: of one move, at most: a longer one ends on the envelope */
#define HELD     1e-13    /* tolerance: of 1 - u: nothing is left to rise */
#define NEAR     0.9      /* tolerance: of z, from which p counts as on an envelope */
#define TINY     1e-300   /* tolerance: no logarithm of 0 */
#define LEAST    1e-6     /* tolerance: of L where it is longest */
#define BLUNT    1e-3     /* tolerance: of u, about 0: an exponent below 1 is infinitely steep there */
#define SEEK     60       /* tolerance: halvings, more than a double has digits */
#define FURTHEST 4.0 /* limit: of the distance of the envelopes: no motor has to go further to bring p to a place */

static double power(double base, double exponent) {
    return exponent == 1.0 ? base : pow(base, exponent);
}

/* R of Bouc-Wen, and its derivatives by u, the exponent and beta. */
struct rate {
    double r, by_u, by_exponent, by_beta;
};

static struct rate bouc_wen(const struct friction *f, double u) {
    const double n = f->value[FRICTION_EXPONENT], beta = f->value[FRICTION_BETA];
    const double size = fmax(fabs(u), TINY), side = u > 0.0 ? 1.0 : -1.0;
    const double raised = power(size, n), gain = beta * side + 1.0 - beta;
    return (struct rate){1.0 - gain * raised, -gain * n * side * raised / fmax(size, BLUNT), -gain * raised * log(size),
                         -(side - 1.0) * raised};
}

double friction_rate(const struct friction *f, double u) {
    return f->kind == FRICTION_DAHL ? power(fmax(1.0 - u, 0.0), f->value[FRICTION_EXPONENT]) : bouc_wen(f, u).r;
}

/* u, its derivative by where the step began, and those by exponent and beta for a beginning that does not move. */
struct course {
    double u, by_begin, by_exponent, by_beta;
};

static struct course rise(const struct friction *f, const struct course *at, const struct course *along, double step) {
    const struct course here = {at->u + step * along->u, at->by_begin + step * along->by_begin,
                                at->by_exponent + step * along->by_exponent, at->by_beta + step * along->by_beta};
    const struct rate rate = bouc_wen(f, here.u);
    return (struct course){rate.r, rate.by_u * here.by_begin, rate.by_u * here.by_exponent + rate.by_exponent,
                           rate.by_u * here.by_beta + rate.by_beta};
}

static double mean4(double a, double b, double c, double d) {
    return (a + 2.0 * b + 2.0 * c + d) / 6.0;
}

/* One step of Bouc-Wen's travel h; slopes: with the derivatives. */
static struct course stepped(const struct friction *f, double u, double h, int slopes) {
    if (!slopes) {
        const double a = friction_rate(f, u), b = friction_rate(f, u + 0.5 * h * a),
                     c = friction_rate(f, u + 0.5 * h * b), d = friction_rate(f, u + h * c);
        return (struct course){.u = u + h * mean4(a, b, c, d)};
    }
    const struct course at = {u, 1.0, 0.0, 0.0}, still = {0.0, 0.0, 0.0, 0.0};
    const struct course a = rise(f, &at, &still, 0.0), b = rise(f, &at, &a, 0.5 * h), c = rise(f, &at, &b, 0.5 * h),
                        d = rise(f, &at, &c, h);
    return (struct course){u + h * mean4(a.u, b.u, c.u, d.u),
                           1.0 + h * mean4(a.by_begin, b.by_begin, c.by_begin, d.by_begin),
                           h * mean4(a.by_exponent, b.by_exponent, c.by_exponent, d.by_exponent),
                           h * mean4(a.by_beta, b.by_beta, c.by_beta, d.by_beta)};
}

/* The travel from u < 0 to 0, where Bouc-Wen's R has a corner: Simpson's rule in u. */
static double to_corner(const struct friction *f, double u) {
    return -u * (1.0 / friction_rate(f, u) + 4.0 / friction_rate(f, 0.5 * u) + 1.0) / 6.0;
}

/* log(1 + x) / x */
static double log_share(double x) {
    return fabs(x) < 1e-4 ? 1.0 - x * (0.5 - x / 3.0) : log1p(x) / x;
}

/* Dahl's 1 - u decays by itself: from v to v exp(-d), d being log(1 + k x v^k) / k with k = exponent - 1; from an
 * exponent below 1 on it is nothing after a while. */
static struct course decayed(const struct friction *f, double u, double x) {
    const double k = f->value[FRICTION_EXPONENT] - 1.0, v = 1.0 - u, raised = pow(v, k), gone = k * x * raised;
    if (!(gone > -1.0)) {
        return (struct course){.u = 1.0};
    }
    /* The integral of t exp(k t) from 0 to d, of which the one of exp(k t) is x v^k. */
    const double d = x * raised * log_share(gone), kd = k * d;
    const double first = fabs(kd) < 1e-3 ? d * d * (0.5 + kd * (1.0 / 3.0 + kd / 8.0)) : (d * exp(kd) - x * raised) / k;
    const double left = v * exp(-d), rate = friction_rate(f, 1.0 - left);
    return (struct course){1.0 - left, rate / (v * raised), rate * (log(v) * x - first / raised), 0.0};
}

/* One piece of the way x, of Dahl's all of it, and its length *h. */
static struct course piece_of(const struct friction *f, double u, double x, int slopes, double *h) {
    if (f->kind == FRICTION_DAHL) {
        *h = x;
        return decayed(f, u, x);
    }
    *h = fmin(x, STEP / fmax(1.0, 0.5 * f->value[FRICTION_EXPONENT]));
    const struct course there = stepped(f, u, *h, slopes);
    if (!(u < 0.0 && there.u > 0.0)) {
        return there;
    }
    *h = fmin(fmax(to_corner(f, u), TINY), *h);
    return stepped(f, u, *h, slopes);
}

/* Travels by x >= 0 in the direction in which u rises; the derivatives in by[] are u's. */
static double travelled(const struct friction *f, double u, double x, double by_length, double by_share, int slopes,
                        double *by) {
    for (size_t piece = 0; x > 0.0 && 1.0 - u > HELD; piece++) {
        if (piece == PIECES) {
            u = 1.0;
            break;
        }
        double h;
        const struct course there = piece_of(f, u, x, slopes, &h);
        const double next = fmin(there.u, 1.0);
        if (slopes) {
            const double r = friction_rate(f, next);
            by[FRICTION_LENGTH] = there.by_begin * by[FRICTION_LENGTH] - by_length * h * r;
            by[FRICTION_SHARE] = there.by_begin * by[FRICTION_SHARE] - by_share * h * r;
            by[FRICTION_EXPONENT] = there.by_begin * by[FRICTION_EXPONENT] + there.by_exponent;
            by[FRICTION_BETA] = there.by_begin * by[FRICTION_BETA] + there.by_beta;
        }
        u = next;
        x -= h;
    }
    if (slopes && !(1.0 - u > HELD)) {
        for (int i = 0; i < FRICTION_VALUES; i++) {
            by[i] = 0.0;
        }
    }
    return u;
}

/* L where B is `width`. */
static double length_at(const struct friction *f, double width) {
    return fmax(f->value[FRICTION_LENGTH] + f->value[FRICTION_SHARE] * width, f->least);
}

double friction_least(const struct friction *f, const struct play_table *table) {
    double most = TINY;
    for (size_t i = 0; i < table->n; i++) {
        most = fmax(most, f->value[FRICTION_LENGTH] + f->value[FRICTION_SHARE] * table->width[i]);
    }
    return LEAST * most;
}

/* The integral of dq / L over h, L going straight from a to b. */
static double passed(double h, double a, double b) {
    return h / a * log_share(b / a - 1.0);
}

void friction_travel(const struct friction *f, const struct play_table *table, double *travel) {
    const double *width = table->width;
    const size_t n = table->n;
    travel[0] = travel[n] = travel[2 * n] = 0.0;
    for (size_t i = 1; i < n; i++) {
        const double a = length_at(f, width[i - 1]), b = length_at(f, width[i]);
        const double h = table->grid[i] - table->grid[i - 1];
        travel[i] = travel[i - 1] + passed(h, a, b);
        travel[n + i] = travel[n + i - 1] - h / (a * b);
        travel[2 * n + i] = travel[2 * n + i - 1] - 0.5 * h * (width[i - 1] / (a * a) + width[i] / (b * b));
    }
}

/* The integral and its derivatives up to q. Returns L there. */
static double find_travel(const struct friction *f, const struct play_table *table, struct friction_state *state,
                          double q) {
    const size_t n = table->n, last = n - 1;
    const double *grid = table->grid, *width = table->width;
    size_t i = 0;
    double h = q - grid[0], here = width[0];
    if (q >= grid[last]) {
        i = last;
        h = q - grid[last];
        here = width[last];
    } else if (q > grid[0]) {
        i = state->at = play_span(grid, n, state->at, q);
        h = q - grid[i];
        here = width[i] + h * (width[i + 1] - width[i]) / (grid[i + 1] - grid[i]);
    }
    const double a = length_at(f, width[i]), b = length_at(f, here);
    state->travel = f->travel[i] + passed(h, a, b);
    state->by_travel[0] = f->travel[n + i] - h / (a * b);
    state->by_travel[1] = f->travel[2 * n + i] - 0.5 * h * (width[i] / (a * a) + here / (b * b));
    return b;
}

static void find_ends(const struct play_table *table, struct friction_state *state, double q, double scale,
                      double extra) {
    double half;
    state->low = play_end(table, q - 0.5 * extra, 1.0, scale, &state->spans[1], &half);
    state->high = play_end(table, q + 0.5 * extra, -1.0, scale, &state->spans[0], &half);
}

static double centre(const struct friction_state *state) {
    return 0.5 * ((1.0 + state->z) * state->low + (1.0 - state->z) * state->high);
}

void friction_start(const struct friction *f, const struct play_table *table, double q, double p,
                    struct friction_state *state) {
    *state = (struct friction_state){.q = q};
    if (!f->kind) {
        return;
    }
    find_ends(table, state, q, 1.0, 0.0);
    find_travel(f, table, state, q);
    const double apart = state->high - state->low;
    const double z = apart > 0.0 ? (state->low + state->high - 2.0 * p) / apart : 0.0;
    state->z = fmin(fmax(z, -1.0), 1.0);
}

double friction_move(const struct friction *f, const struct play_table *table, struct friction_state *state, double q,
                     double scale, double extra, int slopes) {
    const double way = q - state->q, before = state->travel;
    const double by_length = state->by_travel[0], by_share = state->by_travel[1];
    find_ends(table, state, q, scale, extra);
    state->by_q = 0.0;
    if (way == 0.0) {
        return centre(state);
    }
    double length = find_travel(f, table, state, q);
    const double s = way > 0.0 ? 1.0 : -1.0, passes = state->travel - before;
    double x = fabs(passes);
    if (scale != 1.0 || extra != 0.0) {
        const double other = length_at(f, state->high - state->low);
        x *= length / other;
        length = other;
    }
    state->q = q;
    for (int i = 0; slopes && i < FRICTION_VALUES; i++) {
        state->by[i] *= s;
    }
    state->z = s * travelled(f, s * state->z, x, (by_length - state->by_travel[0]) / passes,
                             (by_share - state->by_travel[1]) / passes, slopes, state->by);
    for (int i = 0; slopes && i < FRICTION_VALUES; i++) {
        state->by[i] *= s;
    }
    state->by_q = friction_rate(f, s * state->z) / length;
    if (s * state->z > NEAR) {
        state->side = (signed char)s;
    }
    return centre(state);
}

double friction_lean(const struct friction *f, const struct friction_state *state) {
    return state->z + f->value[FRICTION_SHARE] * state->by[FRICTION_SHARE];
}

double friction_follows(const struct friction_state *state) {
    return fmax(1.0 - 0.5 * (state->high - state->low) * state->by_q, 0.0);
}

double friction_slope(const struct friction_state *state, int value) {
    return 0.5 * (state->low - state->high) * state->by[value];
}

double friction_seek(const struct friction *f, const struct play_table *table, struct friction_state *state, double p,
                     double way) {
    double near = 0.0, far = FURTHEST * (state->high - state->low) + 2.0 * fabs(p - centre(state));
    for (int i = 0; i < SEEK; i++) {
        struct friction_state trial = *state;
        const double middle = 0.5 * (near + far);
        if (way * (friction_move(f, table, &trial, state->q + way * middle, 1.0, 0.0, 0) - p) < 0.0) {
            near = middle;
        } else {
            far = middle;
        }
    }
    const double q = state->q + way * far;
    friction_move(f, table, state, q, 1.0, 0.0, 0);
    return q;
}
