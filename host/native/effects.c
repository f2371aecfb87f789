#include "effects.h"

#include <math.h>

// effects/*.c, collected by the build.
extern const struct effect *const effects_library[];
extern const size_t effects_library_count;

enum { MOST = 24 }; // effects that are present at once

// An effect that is present.
struct active {
    const struct effect *effect;
    const double *v;
    double *state;
};

// Those that are present, in the order of their places.
struct all {
    struct active of[MOST];
    size_t count;
};

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

// p with p + s w(p) = q, where w = (scale B(p) + extra) / 2; and B(p).
static double envelope(const struct effect_tables *tables, struct span_cursor *cursor, double q, double s, double scale,
                       double extra, double *width_at) {
    const double *grid = tables->grid;
    const double *width = tables->width;
    const double half = 0.5 * s * scale;
    const double x = q - 0.5 * s * extra;
    const size_t last = tables->nodes - 1;
    if (x <= grid[0] + half * width[0]) {
        *width_at = width[0];
        return x - half * width[0];
    }
    if (x >= grid[last] + half * width[last]) {
        *width_at = width[last];
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
    const double share = (x - low) / (high - low);
    *width_at = width[i] + share * (width[i + 1] - width[i]);
    return grid[i] + share * (grid[i + 1] - grid[i]);
}

struct play {
    double p;     // of an element of several: in its warp
    double width; // B(p); of an element of several: 2 r
    double share; // of the motion
    double since; // travel since the delayed side began to carry
    struct span_cursor low_at, high_at;
    struct warp_cursor in, out[2];
    signed char side;
};

// How far beyond the play's end on side s the motor is, at which it begins to carry it.
static double beyond_end(const struct warp *warp, struct play *play, const struct effect_drive *drive, double s,
                         double scale) {
    if (!warp) {
        return s * (drive->q - play->p) - 0.5 * (scale * play->width + drive->extra);
    }
    const double end = warp_from(warp, &play->out[s > 0], play->p + 0.5 * s * scale * play->width);
    return s * (drive->q - end) - 0.5 * drive->extra;
}

// Moves the play, in the warp if it is an element of several, to `drive`. Returns how much of q's last step carried it.
// late: an effect that holds a side back, or NULL.
static double play_move(const struct active *late, const struct effect_tables *tables, const struct warp *warp,
                        struct play *play, const struct effect_drive *drive, double spread) {
    const double scale = drive->scale * spread;
    for (int s = -1; s <= 1; s += 2) {
        if (s * drive->way < 0.0) {
            continue;
        }
        double since = play->side == s ? play->since : 0.0;
        double held = late ? late->effect->late(late->v, s, since) : 0.0;
        const double carried = beyond_end(warp, play, drive, s, scale) - held;
        if (carried <= 0.0) {
            continue;
        }
        if (late) {
            since += carried;
            held = late->effect->late(late->v, s, since);
        }
        const double q = drive->q - s * held;
        if (warp) {
            play->p = warp_to(warp, &play->in, q - 0.5 * s * drive->extra) - 0.5 * s * scale * play->width;
        } else {
            play->p = envelope(tables, s > 0 ? &play->low_at : &play->high_at, q, s, scale, drive->extra, &play->width);
        }
        play->side = (signed char)s;
        play->since = since;
        return carried;
    }
    return 0.0;
}

// All plays: of each lot of thresholds one, or one for each element.
struct plays {
    struct play of[EFFECT_LOTS * ELEMENTS_MAX];
    double spread[EFFECT_LOTS];
    size_t each, count, middle; // the one that half of all have moved before
    struct play single;         // beside several elements, for where B is narrow
    struct warp_cursor low_at, high_at;
    struct span_cursor at;
};

static void find_plays(const struct all *all, const struct elements *elements, struct plays *plays) {
    double share[EFFECT_LOTS] = {1.0};
    *plays = (struct plays){.spread = {1.0}, .each = elements ? elements->n : 1};
    size_t lots = 1;
    for (size_t i = 0; i < all->count; i++) {
        if (all->of[i].effect->lots) {
            lots = all->of[i].effect->lots(all->of[i].v, plays->spread, share);
        }
    }
    plays->count = lots * plays->each;
    double above = 1.0, weight = 0.0;
    for (size_t i = 0; i < lots && above > 0.5; above -= share[i++]) {
        plays->middle = i * plays->each;
    }
    for (size_t i = 0; i < plays->count; i++) {
        plays->of[i].share = share[i / plays->each] * (elements ? elements->w[i % plays->each] : 1.0);
    }
    for (size_t i = 0; elements && i < elements->n; i++) {
        plays->middle += weight < 0.5 && i > 0;
        weight += elements->w[i];
    }
}

static void plays_start(const struct effect_tables *tables, struct plays *plays, double q, double p) {
    const struct elements *elements = tables->elements;
    struct warp_cursor in = {0}, centre = {0};
    double z[ELEMENTS_MAX] = {0};
    if (elements) {
        elements_start(elements, warp_to(&elements->warp, &in, q), elements_centre(elements, &centre, p), z);
    }
    plays->single.p = p;
    plays->single.width = interpolate(tables, tables->width, &plays->at, p);
    for (size_t i = 0; i < plays->count; i++) {
        const size_t element = i % plays->each;
        plays->of[i].p = elements ? z[element] : p;
        plays->of[i].width = elements ? 2.0 * elements->r[element] : plays->single.width;
    }
}

// The centre coordinate after all plays have moved; *carried as play_move returns.
static double plays_move(const struct active *late, const struct effect_tables *tables, struct plays *plays,
                         const struct effect_drive *drive, double *carried) {
    const struct elements *elements = tables->elements;
    const struct warp *warp = elements ? &elements->warp : NULL;
    double sum = 0.0;
    *carried = 0.0;
    for (size_t i = 0; i < plays->count; i++) {
        struct play *play = &plays->of[i];
        *carried = fmax(*carried, play_move(late, tables, warp, play, drive, plays->spread[i / plays->each]));
        sum += play->share * play->p;
    }
    double centre = elements ? elements_position(elements, &plays->low_at, &plays->high_at, sum) : sum;
    if (elements && elements->narrow > 0.0) {
        play_move(late, tables, NULL, &plays->single, drive, 1.0);
        if (interpolate(tables, tables->width, &plays->at, centre) < elements->narrow) {
            centre = plays->single.p;
        }
    }
    return centre;
}

double effect_first_order(double y, double u0, double u1, double dt, double time) {
    if (time <= 0.0) {
        return u1;
    }
    if (dt <= 0.0) {
        return y;
    }
    const double decay = exp(-dt / time);
    const double lead = (u1 - u0) * time / dt;
    return u1 - lead + (y - u0 + lead) * decay;
}

struct effect_chain {
    const struct active *const *next, *const *end;
    double out; // where the last piece ended
};

void effect_pass(struct effect_chain *chain, double u0, double u1, double dt) {
    if (chain->next == chain->end) {
        chain->out = u1;
        return;
    }
    const struct active *a = *chain->next++;
    a->effect->follow(a->v, a->state, chain, u0, u1, dt);
    chain->next--;
}

size_t effects_parameter_count(void) {
    size_t count = 0;
    for (size_t i = 0; i < effects_library_count; i++) {
        count += effects_library[i]->count;
    }
    return count;
}

static const struct effect *owner(size_t *i) {
    const struct effect *const *at = effects_library;
    while (*i >= (*at)->count) {
        *i -= (*at++)->count;
    }
    return *at;
}

const struct effect_parameter *effects_parameter(size_t i) {
    const struct effect *of = owner(&i);
    return &of->parameters[i];
}

const char *effects_owner(size_t i) {
    return owner(&i)->id;
}

static void find_present(const double *values, double state[MOST][EFFECT_STATES], struct all *all) {
    all->count = 0;
    for (size_t i = 0; i < effects_library_count && all->count < MOST; i++) {
        const struct effect *effect = effects_library[i];
        if (effect->present(values)) {
            size_t at = all->count;
            for (; at > 0 && all->of[at - 1].effect->place > effect->place; at--) {
                all->of[at] = all->of[at - 1];
            }
            all->of[at] = (struct active){effect, values, state[all->count++]};
        }
        values += effect->count;
    }
}

// A channel of the motion at t, between the knot before `knot` and itself; NULL: 0.
static double at(const struct effect_motion *motion, size_t knot, int at_knot, double t, const double *values) {
    const size_t last = motion->knots - 1;
    if (!values) {
        return 0.0;
    }
    if (at_knot || knot == 0 || knot > last) {
        return values[knot > last ? last : knot];
    }
    const double span = motion->t_s[knot] - motion->t_s[knot - 1];
    const double share = span > 0.0 ? (t - motion->t_s[knot - 1]) / span : 1.0;
    return values[knot - 1] + share * (values[knot] - values[knot - 1]);
}

void effects_simulate(const double *values, const struct effect_tables *tables, const struct effect_motion *motion,
                      const struct effect_times *times, double p0, const struct effect_path *path) {
    double state[MOST][EFFECT_STATES] = {{0}};
    struct all all;
    find_present(values, state, &all);
    const struct active *following[MOST], *late = NULL;
    size_t follows = 0;
    for (size_t i = 0; i < all.count; i++) {
        late = all.of[i].effect->late ? &all.of[i] : late;
        if (all.of[i].effect->follow) {
            following[follows++] = &all.of[i];
        }
    }
    struct effect_chain chain = {following, following + follows, 0.0};
    struct plays plays;
    find_plays(&all, tables->elements, &plays);
    struct span_cursor c_at = {0};
    const double usual_speed = 0.1 * (tables->grid[tables->nodes - 1] - tables->grid[0]);
    const double c_middle = tables->c_deg[tables->nodes / 2];
    const double c_slope = (tables->c_deg[tables->nodes - 1] - tables->c_deg[0]) / (10.0 * usual_speed);
    double before_t = 0.0, before_q = 0.0, centre = 0.0, lies = 0.0, again_s = INFINITY;
    const size_t last = motion->knots - 1;
    size_t knot = 0, asked = 0;
    int started = 0;

    while (asked < times->count) {
        // The next moment: a knot, a time that is asked for, or one that an effect asked for.
        int at_knot = knot <= last && motion->t_s[knot] <= times->t_s[asked];
        double t = at_knot ? motion->t_s[knot] : times->t_s[asked];
        if (t > before_t + again_s) {
            t = before_t + again_s;
            at_knot = 0;
        }
        const double rest = at(motion, knot, at_knot, t, motion->q);
        const double q_before = started ? before_q : rest;
        const struct effect_moment now = {
            .session_s = t + times->session_s,
            .dt = started ? t - before_t : 0.0,
            .moved = rest - q_before,
            .load = at(motion, knot, at_knot, t, motion->load),
            .other = at(motion, knot, at_knot, t, motion->other),
            .translation = times->translation ? times->translation[asked] : 0.0,
            .rotation = times->rotation ? times->rotation[asked] : 0.0,
            .usual_speed = usual_speed,
            .first = !started,
            .at_knot = at_knot,
        };
        struct effect_drive drive = {.q = rest, .scale = 1.0, .again_s = INFINITY};
        for (size_t i = 0; i < all.count; i++) {
            const struct active *a = &all.of[i];
            if (a->effect->shaft) {
                drive.q = a->effect->shaft(a->v, drive.q);
            }
            if (a->effect->drive) {
                a->effect->drive(a->v, a->state, &now, &drive);
            }
        }
        again_s = drive.again_s;
        const double from = centre;
        double carried;
        if (!started) {
            plays_start(tables, &plays, drive.q, isnan(p0) ? drive.q : p0);
        }
        centre = plays_move(late, tables, &plays, &drive, &carried);
        for (size_t i = 0; !started && i < all.count; i++) {
            if (all.of[i].effect->start) {
                all.of[i].effect->start(all.of[i].v, all.of[i].state, centre);
            }
        }
        chain.out = started ? chain.out : centre;
        if (follows > 0 && started) {
            // Caught within the step: at rest before, on the move after.
            const double share = plays.count == 1 && now.moved != 0.0 ? fmin(carried / fabs(now.moved), 1.0) : 1.0;
            if (share < 1.0 - 1e-9) {
                effect_pass(&chain, from, from, (1.0 - share) * now.dt);
            }
            effect_pass(&chain, from, centre, share * now.dt);
        } else {
            chain.out = centre;
        }
        const signed char side = plays.of[plays.middle].side;
        double tip = chain.out, lies_next = side;
        for (size_t i = 0; i < all.count; i++) {
            const struct active *a = &all.of[i];
            if (a->effect->hold) {
                tip = a->effect->hold(a->v, a->state, tip);
            }
            if (a->effect->lie && started) {
                lies_next = a->effect->lie(a->v, lies, side, fabs(centre - from));
            }
        }
        lies = lies_next;
        started = 1;
        before_t = t;
        before_q = rest;
        knot += (size_t)at_knot;
        if (t < times->t_s[asked]) {
            continue;
        }
        struct effect_bend bend = {configuration(tables, &c_at, tip), 1.0, c_middle, c_slope};
        for (size_t i = 0; i < all.count; i++) {
            if (all.of[i].effect->configure) {
                all.of[i].effect->configure(all.of[i].v, all.of[i].state, &now, &bend);
            }
        }
        path->c_deg[asked] = bend.c;
        path->gain[asked] = bend.gain;
        path->p[asked] = centre;
        path->tip[asked] = tip;
        path->way[asked] = lies;
        path->side[asked] = side;
        asked++;
    }
}
