/// The onset detector written again: in long double, without a ring and without sums that are shifted, from what
/// tl_onset.h, tl_hinge.h and tl_confirm.h say. What it keeps between frames is whole numbers, as in the detector.
#ifndef ONSET_MODEL_H
#define ONSET_MODEL_H

#include "tautline/tl_onset.h"

#include <math.h>
#include <string.h>

typedef long double real_t;

typedef struct {
    int64_t t, q, u, v, w;
} frame_t;

typedef struct {
    int64_t n, w, x, xx, u, v, xu, xv, yy;
} sums_t;

typedef struct {
    tl_onset_config_t config;
    frame_t window[TL_ONSET_WINDOW], newest, waiting, believed;
    int held, known; // known: 0 no frame, 1 one that waits, 2 and one before it, 3 that one is in doubt
    int direction;
    bool placed, crossing, on_envelope, entered, settled, told, measured;
    int64_t high, low, extreme, extreme_us, scanned_us, seen_us, arrival_us;
    int64_t noise_sum, noise_dof, reference_u, reference_v;
    int64_t ignored, lost, missed;
    sums_t all, approach;
    int approach_scale;
    real_t approach_span;
    tl_onset_t reversal;
    real_t slack_us;     // of start_us: a knot may be rounded the other way
    int64_t noise_slack; // of noise_sum
    real_t slack;        // of sigmas, relative
} model_t;

typedef struct {
    real_t x, variance, slope, gain;
} meeting_t;

/// A hinge, or a break, and what it proves.
typedef struct {
    real_t gain, residual, knot, variance, slope, span, unit, required, total;
    sums_t level;
    int beyond;
    int64_t dof;
    bool confirmed, jumped;
} proof_t;

static real_t square(real_t x) {
    return x * x;
}

// -- sums -------------------------------------------------------------------------------------------------------------

static int64_t image(int64_t at, int64_t reference) { // Q8 px, to 1024 px
    const int64_t limit = (1 << 18) - 1, off = (at - reference) / 16;
    return off > limit ? limit : (off < -limit ? -limit : off);
}

static int64_t travel(const model_t *m, int i, int64_t origin) {
    return m->direction * (m->window[i].q - origin);
}

static int scale_of(const model_t *m, int first, int64_t origin) {
    int scale = 0;
    for (int i = first; i < m->held; i++) {
        const int64_t x = travel(m, i, origin);
        while (x >= (int64_t)1 << (17 + scale) || x < -((int64_t)1 << (17 + scale))) {
            scale++;
        }
    }
    return scale;
}

/// Adds frame i at x.
static void add(const model_t *m, sums_t *s, int i, int64_t x) {
    const frame_t *f = &m->window[i];
    const int64_t u = image(f->u, m->reference_u), v = image(f->v, m->reference_v);
    s->n += 1;
    s->w += f->w;
    s->x += f->w * x;
    s->xx += f->w * x * x;
    s->u += f->w * u;
    s->v += f->w * v;
    s->xu += f->w * x * u;
    s->xv += f->w * x * v;
    s->yy += f->w * (u * u + v * v);
}

static sums_t rest(const sums_t *all, const sums_t *part) {
    return (sums_t){.n = all->n - part->n,
                    .w = all->w - part->w,
                    .u = all->u - part->u,
                    .v = all->v - part->v,
                    .yy = all->yy - part->yy};
}

static real_t scatter(const sums_t *s) {
    const real_t left = (real_t)s->yy - (square((real_t)s->u) + square((real_t)s->v)) / (real_t)s->w;
    return left > 0 ? left : 0;
}

/// Where line and level meet; units of the line's x.
static bool meet(const sums_t *line, const sums_t *level, meeting_t *out) {
    const int64_t det = line->w * line->xx - line->x * line->x;
    const int64_t cu = line->w * line->xu - line->x * line->u, cv = line->w * line->xv - line->x * line->v;
    if (level->n < 1 || line->n < 2 || det <= 0 || (cu == 0 && cv == 0)) {
        return false;
    }
    const real_t bu = (real_t)cu / (real_t)det, bv = (real_t)cv / (real_t)det, b2 = bu * bu + bv * bv;
    const real_t w = (real_t)line->w, lw = (real_t)level->w;
    const real_t du = (real_t)level->u / lw - (real_t)line->u / w, dv = (real_t)level->v / lw - (real_t)line->v / w;
    const real_t from_mean = (bu * du + bv * dv) / b2;
    out->x = (real_t)line->x / w + from_mean;
    out->variance = (1 / lw + 1 / w + square(from_mean) * w / (real_t)det) / b2;
    out->slope = sqrtl(b2);
    out->gain = b2 * (real_t)det / w;
    return true;
}

// -- the hinge --------------------------------------------------------------------------------------------------------

typedef struct {
    int first, scale;
    int64_t origin;
} walk_t;

static walk_t walk_of(const model_t *m) {
    const int span = m->config.frames_max + 2, first = m->held > span ? m->held - span : 0;
    const int64_t origin = m->window[first].q;
    return (walk_t){first, scale_of(m, first, origin), origin};
}

static int64_t place(const model_t *m, const walk_t *walk, int i) {
    return travel(m, i, walk->origin) / ((int64_t)1 << walk->scale);
}

static sums_t beyond(const model_t *m, const walk_t *walk, int first, int64_t knot) {
    sums_t s = {0};
    for (int i = first; i < m->held; i++) {
        add(m, &s, i, place(m, walk, i) - knot);
    }
    return s;
}

/// C_xx, and T; T is 0 where C_xx is.
static real_t gain_of(const model_t *m, const sums_t *b, real_t *cxx) {
    const sums_t *a = &m->all;
    const real_t cu = (real_t)(a->w * b->xu - b->x * a->u), cv = (real_t)(a->w * b->xv - b->x * a->v);
    *cxx = (real_t)(a->w * b->xx - b->x * b->x);
    *cxx = *cxx > 0 ? *cxx : 0;
    return *cxx > 0 ? (cu * cu + cv * cv) / *cxx / (real_t)a->w : 0;
}

static real_t glance(const model_t *m) {
    const walk_t walk = walk_of(m);
    real_t best = 0, cxx;
    for (int n = 2; m->held - n > walk.first; n *= 2) {
        const int k = m->held - n - 1;
        const sums_t b = beyond(m, &walk, k + 1, place(m, &walk, k));
        best = fmaxl(best, gain_of(m, &b, &cxx));
    }
    return best;
}

typedef struct {
    sums_t beyond;
    int64_t knot;
    real_t gain, cxx;
} best_t;

/// Takes a knot before the frame `first` if it gains more.
static void try
    (const model_t *m, const walk_t *walk, int first, int64_t knot, best_t *best) {
        const best_t here = {.beyond = beyond(m, walk, first, knot), .knot = knot};
        real_t cxx;
        const real_t gain = gain_of(m, &here.beyond, &cxx);
        if (cxx > 0 && (best->cxx <= 0 || gain > best->gain)) {
            *best = here;
            best->gain = gain;
            best->cxx = cxx;
        }
    }

/// Where the line of the frames from `first` on meets the level of the others, if between two places.
static void try_meeting(const model_t *m, const walk_t *walk, int first, int64_t low, int64_t high, best_t *best) {
    const sums_t line = beyond(m, walk, first, 0), level = rest(&m->all, &line);
    meeting_t meeting;
    if (meet(&line, &level, &meeting)) {
        const int64_t x = (int64_t)roundl(meeting.x);
        if (x >= low && x <= high) {
            try
                (m, walk, first, x, best);
        }
    }
}

static bool fit(const model_t *m, proof_t *p) {
    if (m->held < 2 || m->all.n < 3) {
        return false;
    }
    const walk_t walk = walk_of(m);
    best_t best = {.cxx = 0};
    int at = -1;
    for (int k = m->held - 2; k >= walk.first; k--) {
        const real_t before = best.gain;
        const bool none = best.cxx <= 0;
        try
            (m, &walk, k + 1, place(m, &walk, k), &best);
        at = best.gain > before || (none && best.cxx > 0) ? k : at;
    }
    if (at < 0) {
        return false;
    }
    const int64_t corner = best.knot;
    try_meeting(m, &walk, at + 1, corner, place(m, &walk, at + 1), &best);
    if (at > walk.first) {
        try_meeting(m, &walk, at, place(m, &walk, at - 1), corner, &best);
    }
    const sums_t *b = &best.beyond;
    const real_t unit = ldexpl(1, walk.scale), det = (real_t)(b->w * b->xx - b->x * b->x);
    p->level = rest(&m->all, b);
    p->beyond = (int)b->n;
    p->gain = best.gain;
    p->residual = fmaxl(scatter(&m->all) - best.gain, 0);
    const real_t slope = sqrtl(best.gain * (real_t)m->all.w / best.cxx);
    p->variance = ((real_t)b->xx / det + 1 / (real_t)p->level.w) / square(slope) * square(unit);
    p->slope = slope / unit;
    p->knot = (real_t)best.knot * unit + (real_t)travel(m, walk.first, m->reversal.q1);
    p->span = (real_t)(place(m, &walk, m->held - 1) - best.knot) * unit;
    return true;
}

// -- what it proves ---------------------------------------------------------------------------------------------------

static real_t unit_variance(const model_t *m, real_t residual, int64_t dof) {
    return fmaxl(((real_t)m->noise_sum + residual) / (real_t)(m->noise_dof + dof), 26);
}

/// nu (e^(threshold / nu) - 1), as (1 + x / 256)^256 - 1.
static real_t required(const model_t *m, real_t unit, int64_t dof) {
    const real_t nu = (real_t)(m->noise_dof + dof);
    return nu * unit * (powl(1 + m->config.threshold / 16.0L / nu / 256, 256) - 1);
}

static real_t bias2(const model_t *m, real_t span) {
    return square(ldexpl(m->config.curvature, -28) * square(span) / 12);
}

static real_t encoder_variance(void) {
    return 2 * 65536.0L / 12;
}

/// `of`: what the residual is of, a difference of numbers with 31 bits.
static void remember(model_t *m, real_t residual, int64_t dof, const sums_t *of) {
    m->noise_slack = 16 + of->yy / (1 << 28);
    m->slack = 2e-7L + ldexpl((real_t)of->yy, -28) / ((real_t)m->noise_sum + residual);
    if (!m->measured && dof >= 16) {
        m->measured = true;
        m->noise_sum = m->noise_dof = 0;
    }
    if (dof > 0) {
        m->noise_sum += (int64_t)roundl(residual / 16) * 16;
        m->noise_dof += dof;
    }
    for (; m->noise_dof > 512; m->noise_dof /= 2) {
        m->noise_sum /= 2;
    }
}

/// The break with the largest gain over the level alone takes the hinge's place where it gains enough more.
static void look_for_jump(const model_t *m, proof_t *p) {
    const walk_t walk = walk_of(m);
    real_t most = -1;
    int at = -1;
    for (int k = m->held - 4; k >= walk.first; k--) {
        const sums_t b = beyond(m, &walk, k + 1, 0), level = rest(&m->all, &b);
        meeting_t line;
        if (meet(&b, &level, &line)) {
            const real_t gain = scatter(&m->all) - scatter(&level) - scatter(&b) + line.gain;
            at = at < 0 || gain > most ? k : at;
            most = at == k ? gain : most;
        }
    }
    const real_t unit = at < 0 ? 0 : unit_variance(m, p->residual - (most - p->gain), p->dof);
    if (at < 0 || most - p->gain <= required(m, unit, p->dof)) {
        return;
    }
    const int64_t low = travel(m, at, m->reversal.q1), high = travel(m, at + 1, m->reversal.q1);
    const sums_t b = beyond(m, &walk, at + 1, 0);
    p->knot = (real_t)(low + high) / 2;
    p->level = rest(&m->all, &b);
    p->beyond = (int)b.n;
    p->unit = unit;
    p->total = square((real_t)(high - low)) / 12 + encoder_variance();
    p->jumped = true;
}

static bool evaluate(const model_t *m, proof_t *p) {
    if (!fit(m, p)) {
        return false;
    }
    p->dof = 2 * m->all.n - 5; // a coordinate each, less level, slope and knot
    p->unit = unit_variance(m, p->residual, p->dof);
    p->required = required(m, p->unit, p->dof);
    p->total = p->variance * p->unit + encoder_variance() + bias2(m, p->span);
    p->confirmed = p->beyond >= 2 && p->gain > p->required;
    p->jumped = false;
    const real_t known = (real_t)m->noise_sum / (real_t)m->noise_dof;
    if (p->confirmed && p->beyond >= m->config.frames_min && p->residual > known * (real_t)(p->dof + 12)) {
        look_for_jump(m, p);
    }
    return true;
}

static bool near_enough(const model_t *m) {
    const int64_t dof = 2 * m->all.n - 5;
    if (m->held < m->config.frames_min || dof < 1) {
        return false;
    }
    const real_t gain = glance(m);
    return 2 * gain > required(m, unit_variance(m, scatter(&m->all) - gain, dof), dof);
}

static bool may_improve(const model_t *m, const proof_t *p) {
    return !p->jumped && (p->beyond < m->config.frames_min ||
                          (p->beyond < m->config.frames_max && p->total > square((real_t)m->config.sigma_wanted) &&
                           4 * bias2(m, p->span) < p->variance * p->unit));
}

static real_t sigma_of(const model_t *m, const proof_t *p) {
    if (p->jumped || 4 * p->total < square(p->span / p->beyond)) { // two sigma within a frame
        return sqrtl(p->total);
    }
    const walk_t walk = walk_of(m);
    real_t spread = 0, cxx;
    for (int k = walk.first; k < m->held - 1; k++) {
        const sums_t b = beyond(m, &walk, k + 1, place(m, &walk, k));
        if (gain_of(m, &b, &cxx) >= p->gain - 4 * p->unit && cxx > 0) {
            spread = fmaxl(spread, fabsl((real_t)travel(m, k, m->reversal.q1) - p->knot));
        }
    }
    return fmaxl(sqrtl(p->total), spread / 2);
}

#endif
