#include "tl_hinge.h"

#include "tautline/tl_fast.h"

#define TRAVEL_MAX (((int32_t)1 << 17) - 1) ///< of a point, units of x
#define IMAGE_MAX  (((int32_t)1 << 18) - 1) ///< of a point, Q8 px: 1024 px from the reference

// What follows is asked for in many places: small code first, an estimator's home is a controller's memory.
#define ONCE __attribute__((noinline))

ONCE TL_FAST const tl_onset_sample_t *tl_hinge_sample(const tl_onset_detector_t *d, int32_t i) {
    return &d->window[((uint32_t)d->oldest + (uint32_t)i) % TL_ONSET_WINDOW];
}

/// a b - c d
static ONCE TL_FAST int64_t cross(const int64_t *a, const int64_t *b, const int64_t *c, const int64_t *d) {
    return *a * *b - *c * *d;
}

static ONCE TL_FAST tl_real_t quotient(int64_t numerator, int64_t denominator) {
    return tl_real_div(tl_real(numerator, 0), tl_real(denominator, 0));
}

static ONCE TL_FAST int32_t travel(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin) {
    const int32_t q = tl_hinge_sample(d, i)->q;
    return d->direction < 0 ? tl_sub_sat(origin, q) : tl_sub_sat(q, origin);
}

TL_FAST tl_hinge_point_t tl_hinge_point(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin, int32_t scale) {
    const tl_onset_sample_t *s = tl_hinge_sample(d, i);
    return (tl_hinge_point_t){
        .x = tl_clamp(travel(d, i, origin) / ((int32_t)1 << scale), -TRAVEL_MAX, TRAVEL_MAX),
        .u = tl_clamp(tl_sub_sat(s->u, d->reference_u) / 16, -IMAGE_MAX, IMAGE_MAX),
        .v = tl_clamp(tl_sub_sat(s->v, d->reference_v) / 16, -IMAGE_MAX, IMAGE_MAX),
        .w = s->weight,
    };
}

TL_FAST tl_hinge_point_t tl_hinge_image(const tl_onset_detector_t *d, int32_t i) {
    return tl_hinge_point(d, i, tl_hinge_sample(d, i)->q, 0);
}

TL_FAST int32_t tl_hinge_scale(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin) {
    int32_t farthest = 0;
    for (; i < d->held; i++) {
        const int32_t x = travel(d, i, origin);
        const int32_t distance = x < 0 ? -(x + 1) : x;
        farthest = distance > farthest ? distance : farthest;
    }
    int32_t scale = 0;
    while (farthest >> scale > TRAVEL_MAX) {
        scale++;
    }
    return scale;
}

static ONCE TL_FAST void add_product(int64_t *sum, int32_t a, int32_t b) {
    *sum += (int64_t)a * b;
}

TL_FAST void tl_hinge_add(tl_onset_sums_t *sums, const tl_hinge_point_t *point) {
    const int32_t x = point->x, u = point->u, v = point->v, w = point->w, wu = w * u, wv = w * v; // below 2^24
    sums->n++;
    sums->w += w;
    add_product(&sums->x, w, x);
    add_product(&sums->xx, w * x, x);
    add_product(&sums->u, w, u);
    add_product(&sums->v, w, v);
    add_product(&sums->xu, wu, x);
    add_product(&sums->xv, wv, x);
    add_product(&sums->yy, wu, u);
    add_product(&sums->yy, wv, v);
}

TL_FAST tl_onset_sums_t tl_hinge_without(const tl_onset_sums_t *sums, const tl_onset_sums_t *part) {
    return (tl_onset_sums_t){
        .w = sums->w - part->w,
        .u = sums->u - part->u,
        .v = sums->v - part->v,
        .yy = sums->yy - part->yy,
        .n = sums->n - part->n,
    };
}

/// Moves the origin of x back by `delta`: every x grows by it.
static TL_FAST void shift(tl_onset_sums_t *sums, int64_t delta) {
    sums->xx += delta * (2 * sums->x + delta * sums->w);
    sums->x += delta * sums->w;
    sums->xu += delta * sums->u;
    sums->xv += delta * sums->v;
}

static TL_FAST tl_real_t square_sum(int64_t a, int64_t b) {
    return tl_real_add(tl_real_square(tl_real(a, 0)), tl_real_square(tl_real(b, 0)));
}

TL_FAST tl_real_t tl_hinge_scatter(const tl_onset_sums_t *sums) {
    const tl_real_t mean = tl_real_div(square_sum(sums->u, sums->v), tl_real(sums->w, 0));
    const tl_real_t scatter = tl_real_sub(tl_real(sums->yy, 0), mean);
    return scatter > 0 ? scatter : tl_real(0, 0);
}

TL_FAST bool tl_hinge_meet(const tl_onset_sums_t *line, const tl_onset_sums_t *level, int32_t scale,
                           tl_hinge_meeting_t *meeting) {
    const int64_t determinant = cross(&line->w, &line->xx, &line->x, &line->x);
    const int64_t cu = cross(&line->w, &line->xu, &line->x, &line->u);
    const int64_t cv = cross(&line->w, &line->xv, &line->x, &line->v);
    const tl_real_t c2 = square_sum(cu, cv);
    if (level->n < 1 || line->n < 2 || determinant <= 0 || c2 == 0) {
        return false;
    }
    const tl_real_t d = tl_real(determinant, 0);
    const tl_real_t line_w = tl_real(line->w, 0);
    // The line at its mean (x_m, y_m): x = x_m + b (level - y_m) / |b|^2 with b = c / d.
    const tl_real_t gap_u = tl_real_sub(quotient(level->u, level->w), quotient(line->u, line->w));
    const tl_real_t gap_v = tl_real_sub(quotient(level->v, level->w), quotient(line->v, line->w));
    const tl_real_t along = tl_real_add(tl_real_mul(tl_real(cu, 0), gap_u), tl_real_mul(tl_real(cv, 0), gap_v));
    const tl_real_t from_mean = tl_real_div(tl_real_mul(along, d), c2);
    const tl_real_t mean_x = quotient(line->x, line->w);
    const tl_real_t b2 = tl_real_div(c2, tl_real_square(d));
    // var = (1/W_level + 1/W + (x - x_m)^2 W / d) / |b|^2
    tl_real_t var = tl_real_div(tl_real_mul(tl_real_square(from_mean), line_w), d);
    var = tl_real_add(var, quotient(1, line->w));
    var = tl_real_add(var, quotient(1, level->w));
    *meeting = (tl_hinge_meeting_t){
        .x = tl_real_shift(tl_real_add(mean_x, from_mean), scale),
        .variance = tl_real_shift(tl_real_div(var, b2), 2 * scale),
        .slope = tl_real_shift(tl_real_sqrt(b2), -scale),
        .gain = tl_real_div(c2, tl_real_mul(d, line_w)),
    };
    return true;
}

/// T as numerator and denominator, so that trying a knot needs no division.
typedef struct {
    tl_real_t numerator;
    tl_real_t denominator; ///< C_xx > 0; 0: no knot tried yet
} gain_t;

static ONCE TL_FAST gain_t gain_at(const tl_onset_sums_t *beyond, const tl_onset_sums_t *all) {
    const int64_t cu = cross(&all->w, &beyond->xu, &beyond->x, &all->u);
    const int64_t cv = cross(&all->w, &beyond->xv, &beyond->x, &all->v);
    const int64_t cxx = cross(&all->w, &beyond->xx, &beyond->x, &beyond->x);
    return (gain_t){square_sum(cu, cv), tl_real(cxx > 0 ? cxx : 0, 0)};
}

/// Makes *best the gain of the knot at which `beyond` begins, if that is greater.
static TL_FAST bool improves(gain_t *best, const tl_onset_sums_t *beyond, const tl_onset_sums_t *all) {
    const gain_t gain = gain_at(beyond, all);
    if (gain.denominator == 0 ||
        (best->denominator != 0 && !tl_real_less(tl_real_mul(best->numerator, gain.denominator),
                                                 tl_real_mul(gain.numerator, best->denominator)))) {
        return false;
    }
    *best = gain;
    return true;
}

/// T itself.
static TL_FAST tl_real_t value_of(const gain_t *gain, const tl_onset_sums_t *all) {
    return tl_real_div(tl_real_div(gain->numerator, gain->denominator), tl_real(all->w, 0));
}

/// Moves the knot of `beyond` to where its line meets the level of the other samples, if that lies between
/// `low` and `high`. Returns how far; 0 leaves it.
static TL_FAST int32_t refine(tl_onset_sums_t *beyond, const tl_onset_sums_t *all, int32_t low, int32_t high) {
    const tl_onset_sums_t level = tl_hinge_without(all, beyond);
    tl_hinge_meeting_t meeting;
    if (!tl_hinge_meet(beyond, &level, 0, &meeting)) {
        return 0;
    }
    const int32_t x = tl_real_to_q(meeting.x, 0);
    if (x < low || x > high) {
        return 0;
    }
    shift(beyond, -(int64_t)x);
    return x;
}

/// Candidate knots at the window's samples, from the last but one backwards.
typedef struct {
    tl_count_q8_t origin; ///< of x: sample `first`
    int32_t scale;
    int32_t first;          ///< the last candidate
    int32_t k;              ///< this candidate
    tl_hinge_point_t here;  ///< sample k
    tl_onset_sums_t beyond; ///< samples after k, x from sample k
} walk_t;

static TL_FAST int32_t walk_begins(const tl_onset_detector_t *d) {
    const int32_t span = d->config.frames_max + 2;
    return d->held > span ? d->held - span : 0;
}

static TL_FAST void begin_walk(const tl_onset_detector_t *d, walk_t *walk) {
    walk->first = walk_begins(d);
    walk->origin = tl_hinge_sample(d, walk->first)->q;
    walk->scale = tl_hinge_scale(d, walk->first, walk->origin);
    walk->k = d->held - 1;
    walk->here = tl_hinge_point(d, walk->k, walk->origin, walk->scale);
    walk->beyond = (tl_onset_sums_t){0};
}

static TL_FAST bool walk_on(const tl_onset_detector_t *d, walk_t *walk) {
    if (walk->k == walk->first) {
        return false;
    }
    tl_hinge_point_t last = walk->here;
    walk->k--;
    walk->here = tl_hinge_point(d, walk->k, walk->origin, walk->scale);
    const int32_t step = last.x - walk->here.x;
    last.x = 0;
    tl_hinge_add(&walk->beyond, &last);
    shift(&walk->beyond, step);
    return true;
}

TL_FAST tl_real_t tl_hinge_glance(const tl_onset_detector_t *d) {
    gain_t best = {0, 0};
    walk_t walk;
    int32_t next = 2;
    begin_walk(d, &walk);
    while (walk_on(d, &walk)) {
        if (walk.beyond.n == next) {
            improves(&best, &walk.beyond, &d->all);
            next *= 2;
        }
    }
    return best.denominator == 0 ? 0 : value_of(&best, &d->all);
}

/// The best of the samples as knots: its place in the window, -1 where there is none.
static TL_FAST int32_t best_sample(const tl_onset_detector_t *d, tl_onset_sums_t *beyond, gain_t *best) {
    int32_t at = -1;
    walk_t walk;
    begin_walk(d, &walk);
    *best = (gain_t){0, 0};
    while (walk_on(d, &walk)) {
        if (improves(best, &walk.beyond, &d->all)) {
            *beyond = walk.beyond;
            at = walk.k;
        }
    }
    return at;
}

/// What remains to be said of a hinge whose knot is found: `beyond` counts x from it.
static TL_FAST void describe(const tl_onset_detector_t *d, const tl_onset_sums_t *beyond, const gain_t *best,
                             int32_t scale, tl_hinge_t *fit) {
    const int64_t determinant = cross(&beyond->w, &beyond->xx, &beyond->x, &beyond->x);
    const tl_real_t slope = tl_real_div(tl_real_sqrt(best->numerator), best->denominator);
    fit->level = tl_hinge_without(&d->all, beyond);
    fit->beyond = beyond->n;
    tl_real_t variance = quotient(beyond->xx, determinant > 0 ? determinant : 0);
    variance = tl_real_add(variance, quotient(1, fit->level.w));
    fit->variance = tl_real_shift(tl_real_div(variance, tl_real_square(slope)), 2 * scale);
    fit->slope = tl_real_shift(slope, -scale);
    fit->gain = value_of(best, &d->all);
    fit->residual = tl_real_sub(tl_hinge_scatter(&d->all), fit->gain);
    fit->residual = fit->residual > 0 ? fit->residual : 0;
}

TL_FAST bool tl_hinge_fit(const tl_onset_detector_t *d, tl_hinge_t *fit) {
    tl_onset_sums_t beyond;
    gain_t best;
    if (d->held < 2 || d->all.n < 3) {
        return false;
    }
    const int32_t at = best_sample(d, &beyond, &best);
    if (at < 0) {
        return false;
    }
    // Between the best sample and its neighbours the optimum is a meeting point of line and level.
    const int32_t first = walk_begins(d);
    const tl_count_q8_t origin = tl_hinge_sample(d, first)->q;
    const int32_t scale = tl_hinge_scale(d, first, origin);
    tl_hinge_point_t here = tl_hinge_point(d, at, origin, scale);
    const int32_t corner = here.x;
    int32_t knot = corner;
    tl_onset_sums_t trial = beyond;
    int32_t moved = refine(&trial, &d->all, 0, tl_hinge_point(d, at + 1, origin, scale).x - corner);
    if (moved != 0 && improves(&best, &trial, &d->all)) {
        beyond = trial;
        knot = corner + moved;
    }
    if (at > first) {
        shift(&trial, moved);
        here.x = 0;
        tl_hinge_add(&trial, &here);
        moved = refine(&trial, &d->all, tl_hinge_point(d, at - 1, origin, scale).x - corner, 0);
        if (moved != 0 && improves(&best, &trial, &d->all)) {
            beyond = trial;
            knot = corner + moved;
        }
    }
    describe(d, &beyond, &best, scale, fit);
    fit->knot = tl_real_add(tl_real(knot, scale), tl_real(travel(d, first, d->reversal.q1), 0));
    fit->span = tl_real((int64_t)tl_hinge_point(d, d->held - 1, origin, scale).x - knot, scale);
    return true;
}

TL_FAST bool tl_hinge_break(const tl_onset_detector_t *d, tl_hinge_break_t *fit) {
    bool found = false;
    walk_t walk;
    begin_walk(d, &walk);
    while (walk_on(d, &walk)) {
        const tl_onset_sums_t level = tl_hinge_without(&d->all, &walk.beyond);
        tl_hinge_meeting_t line;
        if (walk.beyond.n < 3 || !tl_hinge_meet(&walk.beyond, &level, walk.scale, &line)) {
            continue;
        }
        const tl_real_t scatter = tl_real_add(tl_hinge_scatter(&level), tl_hinge_scatter(&walk.beyond));
        const tl_real_t gain = tl_real_add(tl_real_sub(tl_hinge_scatter(&d->all), scatter), line.gain);
        if (!found || tl_real_less(fit->gain, gain)) {
            fit->gain = gain;
            fit->low = travel(d, walk.k, d->reversal.q1);
            fit->high = travel(d, walk.k + 1, d->reversal.q1);
            fit->level = level;
            fit->beyond = walk.beyond.n;
            found = true;
        }
    }
    return found;
}

TL_FAST tl_real_t tl_hinge_spread(const tl_onset_detector_t *d, const tl_hinge_t *fit, tl_real_t loss) {
    const tl_real_t least = tl_real_sub(fit->gain, loss);
    tl_real_t spread = tl_real(0, 0);
    walk_t walk;
    begin_walk(d, &walk);
    while (walk_on(d, &walk)) {
        const gain_t gain = gain_at(&walk.beyond, &d->all);
        const tl_real_t needed = tl_real_mul(tl_real_mul(least, tl_real(d->all.w, 0)), gain.denominator);
        if (gain.denominator != 0 && !tl_real_less(gain.numerator, needed)) {
            tl_real_t away = tl_real_sub(tl_real(travel(d, walk.k, d->reversal.q1), 0), fit->knot);
            away = away < 0 ? tl_real_sub(0, away) : away;
            spread = tl_real_less(spread, away) ? away : spread;
        }
    }
    return spread;
}

TL_FAST tl_real_t tl_hinge_blind(const tl_onset_detector_t *d, tl_real_t slope, tl_real_t gain) {
    walk_t walk;
    begin_walk(d, &walk);
    // slope^2 C_xx / W >= gain
    const tl_real_t slope2 = tl_real_square(tl_real_shift(slope, walk.scale));
    const tl_real_t needed = tl_real_div(tl_real_mul(gain, tl_real(d->all.w, 0)), slope2);
    while (walk_on(d, &walk)) {
        if (!tl_real_less(gain_at(&walk.beyond, &d->all).denominator, needed)) {
            const int32_t seen = travel(d, walk.k, d->reversal.q1);
            return tl_real(seen > 0 ? seen : 0, 0);
        }
    }
    return tl_real(0, 0);
}
