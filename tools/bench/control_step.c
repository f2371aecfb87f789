// What one control step costs: the inverse with take-up, the forward play and c of it, in fixed point as on the board
// and in float32 by the same equations. Prints one JSON object; the last figures say that both computed the same.
#include "tautline/tl_compensator.h"
#include "tautline/tl_play.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { NODES = 158, COMMANDS = 1 << 16, RATE_HZ = 5000, ROUNDS = 15 };

static tl_table_t table;
static tl_lookup_t lookup;
static tl_deg_q16_t command[COMMANDS];
static float command_f[COMMANDS];

// Float32 twin: counts and degrees; divisions where the fixed point keeps reciprocals. --------------

static struct {
    float q0, step, per_step, width[NODES], angle[NODES];
} ftable;

typedef struct {
    float p, anchor, rest, speed, stop, play;
    int side, heading;
} fstate_t;

static float between(const float *values, float p) {
    const float x = (p - ftable.q0) * ftable.per_step;
    if (x <= 0.0F) {
        return values[0];
    }
    const int span = (int)x;
    if (span >= NODES - 1) {
        return values[NODES - 1];
    }
    return values[span] + (values[span + 1] - values[span]) * (x - (float)span);
}

static float angle_inverse(float c) {
    int span = 0;
    for (int bit = 128; bit != 0; bit >>= 1) {
        if (span + bit < NODES - 1 && ftable.angle[span + bit] <= c) {
            span += bit;
        }
    }
    const float part = (c - ftable.angle[span]) / (ftable.angle[span + 1] - ftable.angle[span]);
    return ftable.q0 + ftable.step * ((float)span + part);
}

// p with p + share B(p) = q
static float envelope_inverse(float q, float share) {
    int span = 0;
    for (int bit = 128; bit != 0; bit >>= 1) {
        const int at = span + bit;
        if (at < NODES - 1 && ftable.q0 + ftable.step * (float)at + share * ftable.width[at] <= q) {
            span = at;
        }
    }
    const float p = ftable.q0 + ftable.step * (float)span;
    const float rise = ftable.step + share * (ftable.width[span + 1] - ftable.width[span]);
    return p + ftable.step * (q - p - share * ftable.width[span]) / rise;
}

static float step_float(fstate_t *s, float c) {
    const float speed_max = 10000.0F / RATE_HZ, accel = 100000.0F / RATE_HZ / RATE_HZ, band = 2.0F;
    s->p = angle_inverse(c);
    const float half = 0.5F * between(ftable.width, s->p), ahead = s->p - s->anchor;
    if (s->side != 0 && (s->side > 0 ? ahead >= 0.0F : ahead <= 0.0F)) {
        s->anchor = s->p;
    } else if (fabsf(ahead) > band) {
        const int side = ahead > 0.0F ? 1 : -1;
        s->rest += half * (float)(side - s->side);
        s->side = side;
        s->anchor = s->p;
    }
    if (s->heading == 0) {
        s->heading = s->rest > 0.0F ? 1 : (s->rest < 0.0F ? -1 : 0);
    }
    if (s->heading != 0) {
        const float left = s->heading > 0 ? s->rest : -s->rest;
        if (left < s->stop) {
            s->stop -= s->speed;
            s->speed -= accel;
        } else if (s->speed + accel <= speed_max && left >= s->stop + s->speed + accel) {
            s->speed += accel;
            s->stop += s->speed;
        }
        if (s->speed < 0.5F * accel) { // what rounding left of it
            s->speed = s->stop = 0.0F;
        }
        const float moved = s->speed == 0.0F && left > 0.0F && left < accel ? left : s->speed;
        s->rest -= s->heading > 0 ? moved : -moved;
        s->heading = s->speed == 0.0F ? 0 : s->heading;
    }
    const float q = s->p + (float)s->side * half - s->rest;
    const float width = between(ftable.width, s->play);
    if (2.0F * (q - s->play) > width) {
        s->play = envelope_inverse(q, 0.5F);
    } else if (2.0F * (s->play - q) > width) {
        s->play = envelope_inverse(q, -0.5F);
    }
    return between(ftable.angle, s->play);
}

// ----------------------------------------------------------------------------------------------------

static void prepare(void) {
    table.step_log2 = 14;
    table.nodes = NODES;
    table.strength_q15 = TL_RATIO_ONE;
    table.nano_units_per_count = 1000000;
    table.q0 = table.q_min = -5000 * TL_COUNT_ONE;
    table.q_max = 5000 * TL_COUNT_ONE;
    table.coarse_c_min = -60 * TL_DEG_ONE;
    table.coarse_c_max = 60 * TL_DEG_ONE;
    table.speed_max_q8 = TL_TABLE_VALUE_MAX;
    table.takeup_speed_q8 = 10000 * TL_COUNT_ONE;
    table.takeup_accel = 100000;
    table.band = 2 * TL_COUNT_ONE;
    for (int i = 0; i < NODES; i++) {
        const double x = (double)i / (NODES - 1) - 0.5;
        table.width[i] = (int32_t)lrint(256.0 * (300.0 + 400.0 * exp(-x * x / 0.02)));
        table.angle[i] = (int32_t)lrint(65536.0 * (120.0 * x - 5.0 * sin(6.283 * x)));
        ftable.width[i] = (float)table.width[i] / 256.0F;
        ftable.angle[i] = (float)table.angle[i] / 65536.0F;
    }
    ftable.q0 = -5000.0F;
    ftable.step = 64.0F;
    ftable.per_step = 1.0F / 64.0F;
    if (tl_lookup_derive(&lookup, &table, 0) != TL_TABLE_OK) {
        fprintf(stderr, "control_step: the table is not valid\n");
        exit(1);
    }
    for (int i = 0; i < COMMANDS; i++) { // strokes of many lengths; a reversal every 0.2 s or so
        const double t = (double)i / RATE_HZ;
        command_f[i] = (float)(25.0 * sin(1.3 * t) + 15.0 * sin(16.0 * t) + 2.0 * sin(41.0 * t));
        command[i] = (tl_deg_q16_t)lrintf(command_f[i] * 65536.0F);
    }
}

static double seconds(void) {
    struct timespec now;
    timespec_get(&now, TIME_UTC);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static float reached[2][COMMANDS];

int main(void) {
    prepare();
    double fixed_ns = INFINITY, float_ns = INFINITY; // the least: everything else that runs only adds to it
    for (int round = 0; round < ROUNDS; round++) {
        tl_compensator_t compensator;
        tl_play_t play;
        uint32_t flags = 0;
        const tl_count_q8_t first = tl_lookup_angle_inverse(&lookup, command[0], &flags);
        tl_compensator_start(&compensator, &lookup, RATE_HZ, TL_MODE_FULL, first, command[0]);
        tl_play_start(&play, &lookup, first);
        double start = seconds();
        for (int i = 0; i < COMMANDS; i++) {
            (void)tl_play_step(&play, tl_compensator_step(&compensator, command[i]));
            reached[0][i] = (float)tl_play_angle(&play);
        }
        fixed_ns = fmin(fixed_ns, (seconds() - start) / COMMANDS * 1e9);
        fstate_t state;
        memset(&state, 0, sizeof state);
        state.p = state.anchor = state.play = angle_inverse(command_f[0]);
        start = seconds();
        for (int i = 0; i < COMMANDS; i++) {
            reached[1][i] = step_float(&state, command_f[i]);
        }
        float_ns = fmin(float_ns, (seconds() - start) / COMMANDS * 1e9);
    }
    double apart = 0.0;
    for (int i = 0; i < COMMANDS; i++) {
        apart = fmax(apart, fabs((double)reached[0][i] / 65536.0 - (double)reached[1][i]));
    }
    printf("{\"fixed_ns\": %.1f, \"float_ns\": %.1f, \"apart_deg\": %.5f}\n", fixed_ns, float_ns, apart);
    return 0;
}
