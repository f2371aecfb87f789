#include "elements.h"

#include <math.h>

static double along(const double *from, const double *to, size_t knots, struct warp_cursor *cursor, double value) {
    const size_t i = cursor->at = play_span(from, knots, cursor->at, value);
    return to[i] + (value - from[i]) * (to[i + 1] - to[i]) / (from[i + 1] - from[i]);
}

double warp_to(const struct warp *warp, struct warp_cursor *cursor, double q) {
    return along(warp->q, warp->x, warp->knots, cursor, q);
}

double warp_from(const struct warp *warp, struct warp_cursor *cursor, double x) {
    return along(warp->x, warp->q, warp->knots, cursor, x);
}

/* The warp belongs to a width that is nowhere below `narrow`. */
static double mean_of(const struct elements *e, struct warp_cursor *cursor, double p, double width) {
    return warp_to(&e->warp, cursor, p - 0.5 * fmax(width, e->narrow)) + 0.5;
}

static double clamped(double value, double low, double high) {
    return value < low ? low : (value > high ? high : value);
}

/* sum w_i z_i is a rising, piecewise straight function of the common value, with corners at x -+ r_i. */
static void share_out(const struct elements *e, double x, double y, double *z) {
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

void elements_start(const struct elements *e, double q, double p, struct play *of, struct elements_course *course) {
    *course = (struct elements_course){0};
    of[0] = play_start(&e->table, p);
    if (!e->warp.knots) {
        return;
    }
    double z[ELEMENTS_MAX];
    const double x = elements_motor(e, course, q, PLAY_RISING);
    share_out(e, x, mean_of(e, &course->in[0], p, 2.0 * of[0].half), z);
    for (size_t i = 0; i < e->n; i++) {
        of[i] = (struct play){.at = z[i], .half = e->r[i]};
    }
}

double elements_centre(const struct elements *e, struct elements_course *course, double y, const struct play *single) {
    const double low = warp_from(&e->warp, &course->out[0], y - 0.5);
    const double p = 0.5 * (low + warp_from(&e->warp, &course->out[1], y + 0.5));
    const int alone = e->narrow > 0.0 && play_width(&e->table, p, &course->width_at) < e->narrow;
    return alone ? single->at : p;
}

/* Pushes one element by a motor at x of its coordinate. Whether it moved. */
static inline int push(struct play *play, const struct play_table *table, double x) {
    return play_push(play, table, x, 1.0, 1.0) > 0.0 || play_push(play, table, x, -1.0, 1.0) > 0.0;
}

static void single_forward(const struct elements *e, const double *q, size_t count, double p0, double *p, int8_t *side,
                           double *lean, double *share) {
    struct play play = play_start(&e->table, p0);
    for (size_t k = 0; k < count; k++) {
        const int moved = push(&play, &e->table, q[k]);
        p[k] = play.at;
        if (side) {
            side[k] = play.side;
        }
        if (lean) {
            lean[k] = play.lean;
        }
        if (share) {
            share[k] = moved;
        }
    }
}

static void several_forward(const struct elements *e, const double *q, size_t count, double p0, double *p, int8_t *side,
                            double *lean, double *share) {
    struct play of[ELEMENTS_MAX], single = play_start(&e->table, p0);
    struct elements_course course;
    elements_start(e, q[0], p0, of, &course);
    const struct play *widest = &of[e->n - 1];
    int8_t lies = PLAY_INSIDE;
    for (size_t k = 0; k < count; k++) {
        const double x = elements_motor(e, &course, q[k], PLAY_RISING);
        double y = 0.0, leans = 0.0, moves = 0.0;
        for (size_t i = 0; i < e->n; i++) {
            moves += push(&of[i], NULL, x) ? e->w[i] : 0.0;
            y += e->w[i] * of[i].at;
            leans += e->w[i] * of[i].lean;
        }
        if (e->narrow > 0.0) {
            push(&single, &e->table, q[k]);
        }
        p[k] = elements_centre(e, &course, y, &single);
        lies = widest->at == x - widest->half ? PLAY_RISING : (widest->at == x + widest->half ? PLAY_FALLING : lies);
        if (side) {
            side[k] = lies;
        }
        if (lean) {
            lean[k] = leans;
        }
        if (share) {
            share[k] = moves;
        }
    }
}

static void friction_forward(const struct elements *e, const double *q, size_t count, double p0, double *p,
                             int8_t *side, double *lean, double *share, double *by) {
    struct friction_state state;
    friction_start(&e->friction, &e->table, q[0], p0, &state);
    const int slopes = lean || by;
    for (size_t k = 0; k < count; k++) {
        p[k] = friction_move(&e->friction, &e->table, &state, q[k], 1.0, 0.0, slopes);
        if (side) {
            side[k] = state.side;
        }
        if (lean) {
            lean[k] = friction_lean(&e->friction, &state);
        }
        if (share) {
            share[k] = friction_follows(&state);
        }
        for (int i = 0; by && i < FRICTION_VALUES; i++) {
            by[k * FRICTION_VALUES + (size_t)i] = friction_slope(&state, i);
        }
    }
}

void elements_forward(const struct elements *e, const double *q, size_t count, double p0, double *p, int8_t *side,
                      double *lean, double *share, double *by) {
    if (count == 0) {
        return;
    }
    const double from = isnan(p0) ? q[0] : p0;
    if (e->friction.kind) {
        friction_forward(e, q, count, from, p, side, lean, share, by);
    } else {
        (e->warp.knots ? several_forward : single_forward)(e, q, count, from, p, side, lean, share);
    }
}

/* The plays on y that undo all elements but the first. */
struct undoing {
    double rho[ELEMENTS_MAX];
    double v[ELEMENTS_MAX];
    double state[ELEMENTS_MAX];
};

/* The j-th play on y stands where y would be if all elements below the j-th were where the j-th is. */
static void undoing_start(const struct elements *e, const struct play *of, struct undoing *u) {
    double weight = 0.0, moment = 0.0, inverse = 0.0, above = 0.0;
    for (size_t i = 0; i < e->n; i++) {
        above += e->w[i] * of[i].at;
    }
    for (size_t j = 0; j < e->n; j++) {
        weight += e->w[j];
        moment += e->w[j] * e->r[j];
        above -= e->w[j] * of[j].at;
        u->rho[j] = weight * e->r[j] - moment;
        u->v[j] = 1.0 / weight - inverse;
        inverse = 1.0 / weight;
        u->state[j] = weight * of[j].at + above;
    }
}

/* s where the elements' mean is y. */
static double undone(const struct elements *e, struct undoing *u, double y) {
    double s = 0.0;
    for (size_t j = 0; j < e->n; j++) {
        u->state[j] = clamped(u->state[j], y - u->rho[j], y + u->rho[j]);
        s += u->v[j] * u->state[j];
    }
    return s;
}

static void friction_inverse(const struct elements *e, const double *p, size_t count, double q0, double p0, double *q) {
    struct friction_state state;
    friction_start(&e->friction, &e->table, q0, p0, &state);
    double before = p0;
    for (size_t k = 0; k < count; k++) {
        const double way = p[k] - before;
        q[k] = way == 0.0 ? state.q : friction_seek(&e->friction, &e->table, &state, p[k], way > 0.0 ? 1.0 : -1.0);
        before = p[k];
    }
}

void elements_inverse(const struct elements *e, const double *p, size_t count, double q0, double p0, double *q) {
    if (e->friction.kind) {
        friction_inverse(e, p, count, q0, p0, q);
        return;
    }
    struct elements_course course;
    struct play of[ELEMENTS_MAX];
    struct undoing undo;
    elements_start(e, q0, p0, of, &course);
    double x = elements_motor(e, &course, q0, PLAY_RISING);
    if (e->warp.knots) {
        undoing_start(e, of, &undo);
    }
    double before_s = of[0].at, before_p = p0, here = q0;
    for (size_t k = 0; k < count; k++) {
        const double width = play_width(&e->table, p[k], &course.width_at), way = p[k] - before_p;
        if (e->warp.knots) {
            const double s = undone(e, &undo, mean_of(e, &course.in[0], p[k], width));
            if (way != 0.0 && s != before_s) {
                x = s + (s > before_s ? e->r[0] : -e->r[0]);
            }
            before_s = s;
        }
        if (way != 0.0) {
            const int alone = !e->warp.knots || width < e->narrow;
            here = alone ? p[k] + (way > 0.0 ? 0.5 : -0.5) * width : warp_from(&e->warp, &course.out[0], x);
        }
        before_p = p[k];
        q[k] = here;
    }
}
