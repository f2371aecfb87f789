#include "effects.h"

#include <math.h>

enum { PLAYS = 9 }; // thresholds that stand for a spread one: the corner becomes a polygon of as many pieces

struct span_cursor {
    size_t i; // the span looked at last: motion is continuous, so the next is near
};

static size_t seek(const struct effect_tables *tables, struct span_cursor *cursor, double x) {
    const size_t last = tables->nodes - 2;
    size_t i = cursor->i;
    while (i > 0 && x < tables->grid[i]) {
        i--;
    }
    while (i < last && x >= tables->grid[i + 1]) {
        i++;
    }
    cursor->i = i;
    return i;
}

static double interpolate(const struct effect_tables *tables, const double *values, struct span_cursor *cursor,
                          double x) {
    const double *grid = tables->grid;
    if (x <= grid[0]) {
        return values[0];
    }
    if (x >= grid[tables->nodes - 1]) {
        return values[tables->nodes - 1];
    }
    const size_t i = seek(tables, cursor, x);
    return values[i] + (values[i + 1] - values[i]) * (x - grid[i]) / (grid[i + 1] - grid[i]);
}

// f_remain goes on with its end slopes: a motor that leaves the table still moves the tip.
static double configuration(const struct effect_tables *tables, struct span_cursor *cursor, double p) {
    const size_t i = seek(tables, cursor, p);
    const double *grid = tables->grid;
    const double slope = (tables->c_deg[i + 1] - tables->c_deg[i]) / (grid[i + 1] - grid[i]);
    return tables->c_deg[i] + slope * (p - grid[i]);
}

// p with p + s w(p) = q, where w = (scale B(p) + extra) / 2.
static double envelope(const struct effect_tables *tables, struct span_cursor *cursor, double q, double s, double scale,
                       double extra) {
    const double *grid = tables->grid;
    const double *width = tables->width;
    const double half = 0.5 * s * scale;
    const double x = q - 0.5 * s * extra;
    const size_t last = tables->nodes - 1;
    if (x <= grid[0] + half * width[0]) {
        return x - half * width[0];
    }
    if (x >= grid[last] + half * width[last]) {
        return x - half * width[last];
    }
    size_t i = cursor->i;
    while (i > 0 && x < grid[i] + half * width[i]) {
        i--;
    }
    while (i < last - 1 && x >= grid[i + 1] + half * width[i + 1]) {
        i++;
    }
    cursor->i = i;
    const double low = grid[i] + half * width[i];
    const double high = grid[i + 1] + half * width[i + 1];
    return grid[i] + (x - low) * (grid[i + 1] - grid[i]) / (high - low);
}

struct play {
    double p;
    double late; // what asymmetry still holds back on the side that it delays
    struct span_cursor width_at, low_at, high_at;
    signed char side;
};

struct play_step {
    double q, moved, scale, extra, asymmetry, asymmetry_travel;
};

static void play_move(const struct effect_tables *tables, struct play *play, const struct play_step *step) {
    const double width = step->scale * interpolate(tables, tables->width, &play->width_at, play->p) + step->extra;
    const double late_up = step->asymmetry > 0.0 ? play->late : 0.0;
    const double late_down = step->asymmetry < 0.0 ? play->late : 0.0;
    const double up = step->q - late_up;
    const double down = step->q + late_down;
    if (up > play->p + 0.5 * width) {
        play->p = envelope(tables, &play->low_at, up, 1.0, step->scale, step->extra);
        play->side = 1;
    } else if (down < play->p - 0.5 * width) {
        play->p = envelope(tables, &play->high_at, down, -1.0, step->scale, step->extra);
        play->side = -1;
    } else {
        return;
    }
    const double delayed = step->asymmetry > 0.0 ? 1.0 : -1.0;
    if (play->side * delayed < 0.0) {
        play->late = fabs(step->asymmetry);
    } else if (play->late != 0.0) {
        play->late *= exp(-fabs(step->moved) / step->asymmetry_travel);
    }
}

void effects_simulate(const struct effect_parameters *e, const struct effect_tables *tables,
                      const struct effect_motion *motion, double p0, double *c_deg, double *p, signed char *side) {
    const double turn = 6.283185307179586 / e->encoder_period;
    const int plays = e->onset_spread != 0.0 ? PLAYS : 1;
    struct play play[PLAYS] = {0};
    struct span_cursor c_at = {0};
    double lagged = 0.0, slow = 0.0, held = 0.0, before = 0.0, speed = 0.0;
    const size_t middle_node = tables->nodes / 2;
    const double c_middle = tables->c_deg[middle_node];

    for (size_t k = 0; k < motion->samples; k++) {
        const double dt = k > 0 ? motion->t_s[k] - motion->t_s[k - 1] : 0.0;
        const double load = motion->load ? motion->load[k] : 0.0;
        double q = motion->q[k];
        q += e->encoder_sin * sin(turn * q) + e->encoder_cos * cos(turn * q);
        q += e->offset_drift * motion->t_s[k] + e->offset_per_load * load;
        if (k == 0) {
            before = q;
        }
        const double moved = q - before;
        before = q;
        // Encoder steps make the difference quotient spiky: 20 ms is shorter than any motion's own time.
        if (dt > 0.0 && e->width_per_speed != 0.0 && (moved != 0.0 || e->width_held == 0.0)) {
            speed += (moved / dt - speed) * (1.0 - exp(-dt / 0.02));
        }
        struct play_step step = {
            .q = q,
            .moved = moved,
            .scale = fmax(0.0, (1.0 + e->width_per_load * load) * (1.0 + e->width_drift * motion->t_s[k])),
            .extra = e->width_per_speed * fabs(speed),
            .asymmetry = e->asymmetry,
            .asymmetry_travel = e->asymmetry_travel,
        };
        double sum = 0.0;
        const double scale = step.scale;
        for (int i = 0; i < plays; i++) {
            const double x = plays > 1 ? (2.0 * i + 1.0) / plays - 1.0 : 0.0;
            step.scale = scale * fmax(0.0, 1.0 + e->onset_spread * x);
            if (k == 0) {
                play[i].p = isnan(p0) ? q : p0;
                play[i].late = fabs(e->asymmetry);
            }
            play_move(tables, &play[i], &step);
            sum += play[i].p;
        }
        const double centre = sum / plays;
        p[k] = centre;
        side[k] = play[plays / 2].side;

        if (k == 0) {
            lagged = slow = held = centre;
        }
        lagged = e->lag > 0.0 ? lagged + (centre - lagged) * (1.0 - exp(-dt / e->lag)) : centre;
        if (e->creep_share != 0.0) {
            slow += (lagged - slow) * (1.0 - exp(-dt / e->creep_time));
        }
        const double late = e->creep_share != 0.0 ? lagged - e->creep_share * (lagged - slow) : lagged;
        if (fabs(late - held) >= e->stick) {
            held = late;
        }

        double c = configuration(tables, &c_at, held);
        c = c_middle + (c - c_middle) * (1.0 + e->gain_per_load * load);
        if (motion->translation) {
            c += e->c_per_translation * motion->translation[k];
        }
        if (motion->rotation) {
            c += e->c_per_rotation * motion->rotation[k];
        }
        const double beyond = (c - e->contact_c) * e->contact_side;
        if (beyond > 0.0) {
            c -= e->contact_hold * beyond * e->contact_side;
        }
        c_deg[k] = c;
    }
}
