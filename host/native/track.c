#include "track.h"

#include <math.h>

enum { TURNS = 60 }; /* limit: more than Newton's method ever takes on a table */

void track_start(struct track_state *state, size_t n, double p) {
    *state = (struct track_state){.p = p};
    for (size_t i = 0; i < n; i++) {
        state->of[i].at = p;
    }
}

/* Pushes an element by `share` of a width that is 2 half here. Which way it went, 0: not at all. */
static int push(struct play *element, double q, double share, double half) {
    element->half = half;
    if (play_push(element, NULL, q, PLAY_RISING, share) > 0.0) {
        return PLAY_RISING;
    }
    return play_push(element, NULL, q, PLAY_FALLING, share) > 0.0 ? PLAY_FALLING : 0;
}

/* sum w_i z_i if the width were that at p, and its slope by p. */
static double carried(const struct track_model *m, const struct play *of, double q, double half, double by_p,
                      double *slope) {
    double sum = 0.0, lean = 0.0;
    for (size_t i = 0; i < m->n; i++) {
        struct play element = {.at = of[i].at};
        lean += m->weight[i] * m->share[i] * push(&element, q, m->share[i], half);
        sum += m->weight[i] * element.at;
    }
    *slope = -0.5 * lean * by_p;
    return sum;
}

/* The place of the p that is its own: carried(p) - p falls strictly while |B'| < 2, so Newton's steps are kept in a
 * bracket. */
static struct play_place solved(const struct track_model *m, struct track_state *state, double q) {
    double low = -INFINITY, high = INFINITY;
    struct play_place here = play_find(&m->table, state->p, state->at);
    for (int turn = 0; turn < TURNS; turn++) {
        const double p = state->p;
        double slope;
        const double off = carried(m, state->of, q, 0.5 * play_value(&here, m->table.width),
                                   play_slope(&here, m->table.width), &slope) -
                           p;
        if (fabs(off) <= 1e-13 * (1.0 + fabs(p))) {
            break;
        }
        if (off > 0.0) {
            low = p;
        } else {
            high = p;
        }
        double next = p + off / (1.0 - slope);
        if (!(next > low && next < high)) {
            next = isinf(low) || isinf(high) ? p + off : 0.5 * (low + high);
        }
        state->p = next;
        here = play_find(&m->table, next, state->at);
        state->at = here.step > 0.0 ? here.at : state->at;
    }
    return here;
}

/* dz_i = dq - way_i (a_i (dB + B' dp) + da_i B) / 2 of those pushed, and dp = sum w_i dz_i. */
static void differentiate(const struct track_model *m, struct track_state *s, const struct play_place *here,
                          double width, const int *way, double *by) {
    const double by_p = play_slope(here, m->table.width);
    for (size_t j = 0; j < 1 + m->bases + m->shapes; j++) {
        const double by_q = j == 0 ? 1.0 : 0.0;
        const double by_width = j >= 1 && j < 1 + m->bases ? play_value(here, m->basis + (j - 1) * m->table.n) : 0.0;
        const double *shape = j > m->bases ? m->shape + (j - 1 - m->bases) * m->n : NULL;
        double sum = 0.0, lean = 0.0;
        for (size_t i = 0; i < m->n; i++) {
            if (way[i] != 0) {
                s->by[i][j] = by_q - 0.5 * way[i] * (m->share[i] * by_width + (shape ? shape[i] * width : 0.0));
                lean += m->weight[i] * m->share[i] * way[i];
            }
            sum += m->weight[i] * s->by[i][j];
        }
        const double by_p_here = sum / (1.0 + 0.5 * lean * by_p);
        for (size_t i = 0; i < m->n; i++) {
            s->by[i][j] -= 0.5 * way[i] * m->share[i] * by_p * by_p_here;
        }
        by[j] = by_p_here;
    }
}

void track_run(const struct track_model *model, struct track_state *state, const double *q, size_t count, double *p,
               double *moving, double *by) {
    state->at = state->at + 1 < model->table.n ? state->at : 0; /* another table's */
    for (size_t k = 0; k < count; k++) {
        int way[TRACK_ELEMENTS] = {0};
        const struct play_place here = solved(model, state, q[k]);
        const double width = play_value(&here, model->table.width);
        p[k] = state->p;
        moving[k] = state->lean = state->driven = 0.0;
        for (size_t i = 0; i < model->n; i++) {
            way[i] = push(&state->of[i], q[k], model->share[i], 0.5 * width);
            moving[k] += model->weight[i] * way[i];
            state->lean += model->weight[i] * model->share[i] * state->of[i].side;
            state->driven += state->of[i].side != PLAY_INSIDE ? model->weight[i] : 0.0;
        }
        if (by) {
            differentiate(model, state, &here, width, way, by + k * (1 + model->bases + model->shapes));
        }
    }
}
