#include "track.h"

#include <math.h>

#include "play.h"

enum { TURNS = 60 }; /* more than Newton's method ever takes on a table */

void track_start(struct track_state *state, size_t n, double p) {
    *state = (struct track_state){.p = p};
    for (size_t i = 0; i < n; i++) {
        state->z[i] = p;
    }
}

/* Where p is in the table, and how far beyond its nodes' left one. */
struct place {
    size_t at;
    double along, step;
};

static struct place place_of(const struct track_model *m, size_t at, double p) {
    const size_t last = m->nodes - 1;
    if (last == 0 || p <= m->grid[0]) {
        return (struct place){0, 0.0, 0.0};
    }
    if (p >= m->grid[last]) {
        return (struct place){last, 0.0, 0.0};
    }
    const size_t i = play_span(m->grid, m->nodes, at < last ? at : last - 1, p);
    return (struct place){i, p - m->grid[i], m->grid[i + 1] - m->grid[i]};
}

static double slope_at(const struct place *here, const double *table) {
    return here->step > 0.0 ? (table[here->at + 1] - table[here->at]) / here->step : 0.0;
}

static double value_at(const struct place *here, const double *table) {
    return table[here->at] + here->along * slope_at(here, table);
}

/* sum w_i z_i if the width were that at p, and its slope by p. */
static double carried(const struct track_model *m, const double *z, double q, double width, double by_p,
                      double *slope) {
    double sum = 0.0, lean = 0.0;
    for (size_t i = 0; i < m->n; i++) {
        const double reach = 0.5 * m->share[i] * width;
        if (z[i] < q - reach) {
            sum += m->weight[i] * (q - reach);
            lean += m->weight[i] * m->share[i];
        } else if (z[i] > q + reach) {
            sum += m->weight[i] * (q + reach);
            lean -= m->weight[i] * m->share[i];
        } else {
            sum += m->weight[i] * z[i];
        }
    }
    *slope = -0.5 * lean * by_p;
    return sum;
}

/* The p that is its own: carried(p) - p falls strictly while |B'| < 2, so Newton's steps are kept in a bracket. */
static double solved(const struct track_model *m, const struct track_state *state, double q, struct place *here) {
    double p = state->p, low = -INFINITY, high = INFINITY;
    size_t at = state->at;
    for (int turn = 0; turn < TURNS; turn++) {
        double slope;
        *here = place_of(m, at, p);
        at = here->at;
        const double off = carried(m, state->z, q, value_at(here, m->width), slope_at(here, m->width), &slope) - p;
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
        p = next;
    }
    return p;
}

/* Pushes the elements to where they are for the width at p, and says which were pushed. */
static void pushed(const struct track_model *m, struct track_state *s, double q, double width, signed char *way) {
    s->lean = s->driven = 0.0;
    for (size_t i = 0; i < m->n; i++) {
        const double reach = 0.5 * m->share[i] * width;
        way[i] = s->z[i] < q - reach ? 1 : (s->z[i] > q + reach ? -1 : 0);
        if (way[i] != 0) {
            s->z[i] = q - way[i] * reach;
            s->side[i] = way[i];
        }
        s->lean += m->weight[i] * m->share[i] * s->side[i];
        s->driven += s->side[i] != 0 ? m->weight[i] : 0.0;
    }
}

/* dz_i = dq - way_i (a_i (dB + B' dp) + da_i B) / 2 of those pushed, and dp = sum w_i dz_i. */
static void differentiate(const struct track_model *m, struct track_state *s, const struct place *here, double width,
                          const signed char *way, double *by) {
    const double by_p = slope_at(here, m->width);
    for (size_t j = 0; j < 1 + m->bases + m->shapes; j++) {
        const double by_q = j == 0 ? 1.0 : 0.0;
        const int is_width = j >= 1 && j < 1 + m->bases;
        const double by_width = is_width ? value_at(here, m->basis + (j - 1) * m->nodes) : 0.0;
        const double *shape = j > m->bases ? m->shape + (j - 1 - m->bases) * m->n : 0;
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
    for (size_t k = 0; k < count; k++) {
        struct place here;
        signed char way[TRACK_ELEMENTS] = {0};
        const double found = solved(model, state, q[k], &here);
        const double width = value_at(&here, model->width);
        pushed(model, state, q[k], width, way);
        state->p = p[k] = found;
        state->at = here.at;
        moving[k] = 0.0;
        for (size_t i = 0; i < model->n; i++) {
            moving[k] += model->weight[i] * way[i];
        }
        if (by) {
            differentiate(model, state, &here, width, way, by + k * (1 + model->bases + model->shapes));
        }
    }
}
