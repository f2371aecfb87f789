#include "effects.h"

#include <math.h>

// effects/*.c, collected by the build.
extern const struct effect *const effects_library[];
extern const size_t effects_library_count;

enum {
    MOST = 24, // limit: effects that are present at once
    LATES = 2  // limit: of these, those that hold a side of a play back
};

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

// f_remain goes on with its end slopes: a motor that leaves the table still moves the tip.
static double configuration(const struct effect_tables *tables, size_t *at, double p) {
    const struct play_table *table = &tables->elements->table;
    const size_t i = *at = play_span(table->grid, table->n, *at, p);
    const double slope = (tables->c_deg[i + 1] - tables->c_deg[i]) / (table->grid[i + 1] - table->grid[i]);
    return tables->c_deg[i] + slope * (p - table->grid[i]);
}

// Of the chain. Of each lot of thresholds the elements; behind them, if there are several, the single one beside them.
struct chain_play {
    struct play play;
    const struct play_table *table; // NULL: in the warp
    double share;                   // of the motion
    double spread;                  // of its width
    struct effect_contact contact[LATES];
    double rested_s; // since it was last pushed
    double end[2];   // where its falling and its rising end pushed it to, of late
    double speed;    // of what falls within it
    int pushed;      // by which end in the last step, 0 by none
};

struct plays {
    struct chain_play of[EFFECT_LOTS * ELEMENTS_MAX + 1];
    size_t each, count, middle; // the one that half of all have moved before
    struct elements_course course;
    struct warp_cursor end_at[2];
    struct friction_state friction;
};

static size_t find_lots(const struct all *all, double *spread, double *share) {
    size_t lots = 1;
    spread[0] = share[0] = 1.0;
    for (size_t i = 0; i < all->count; i++) {
        if (all->of[i].effect->lots) {
            lots = all->of[i].effect->lots(all->of[i].v, spread, share);
        }
    }
    return lots;
}

static void find_plays(const struct all *all, const struct elements *elements, struct plays *plays) {
    const int several = elements->warp.knots > 0;
    double spread[EFFECT_LOTS], share[EFFECT_LOTS];
    *plays = (struct plays){.each = several ? elements->n : 1};
    const size_t lots = find_lots(all, spread, share);
    plays->count = lots * plays->each;
    double above = 1.0, weight = 0.0;
    for (size_t i = 0; i < lots && above > 0.5; above -= share[i++]) {
        plays->middle = i * plays->each;
    }
    for (size_t i = 0; several && i < elements->n; i++) {
        plays->middle += weight < 0.5 && i > 0;
        weight += elements->w[i];
    }
    for (size_t i = 0; i < plays->count; i++) {
        const size_t lot = i / plays->each;
        plays->of[i].table = elements_table(elements);
        plays->of[i].share = share[lot] * (several ? elements->w[i % plays->each] : 1.0);
        plays->of[i].spread = spread[lot];
    }
    plays->of[plays->count] = (struct chain_play){.table = &elements->table, .spread = 1.0};
}

static void plays_start(const struct elements *elements, struct plays *plays, double q, double p) {
    struct play of[ELEMENTS_MAX];
    friction_start(&elements->friction, &elements->table, q, p, &plays->friction);
    elements_start(elements, q, p, of, &plays->course);
    for (size_t i = 0; i < plays->count; i++) {
        plays->of[i].play = of[i % plays->each];
    }
    plays->of[plays->count].play = play_start(&elements->table, p);
}

// The effects that hold a side back, and the step's time, s, and motion; and of drag beside friction its time, s.
struct lates {
    const struct active *of[LATES];
    size_t count;
    double dt, moved, wide, drag_s;
};

static double held_back(const struct lates *lates, const struct effect_contact *contact, int s) {
    double sum = 0.0;
    for (size_t i = 0; i < lates->count; i++) {
        sum += lates->of[i]->effect->late(lates->of[i]->v, s, &contact[i]);
    }
    return sum;
}

// Pushes a play by its end on side s, which effects hold back by what is left of them after so much travel. q: the
// motor for that end; x: the same in the play's coordinate. As play_push, in the motor's coordinate.
static double push_late(const struct lates *lates, const struct elements *elements, struct plays *plays,
                        struct chain_play *own, double q, double x, int s, double scale) {
    struct play *play = &own->play;
    if (!(s * (x - play->at) - scale * play->half > 0.0)) {
        return 0.0;
    }
    struct effect_contact contact[LATES];
    for (size_t i = 0; i < lates->count; i++) {
        contact[i] = own->contact[i];
        contact[i].age_s += own->rested_s;
        contact[i].wide = lates->wide;
        const struct effect *effect = lates->of[i]->effect;
        if (play->side != s || (effect->renewed_s && own->rested_s > effect->renewed_s(lates->of[i]->v))) {
            contact[i].since = 0.0;
        }
    }
    double from = play->at + s * scale * play->half;
    if (!own->table) {
        from = warp_from(&elements->warp, &plays->end_at[s > 0], from);
    }
    double beyond = s * (q - from) - held_back(lates, contact, s);
    if (!(beyond > 0.0)) {
        return 0.0;
    }
    // It rests until it is caught.
    const double rests = (1.0 - beyond / fmax(fabs(lates->moved), beyond)) * lates->dt;
    for (size_t i = 0; i < lates->count; i++) {
        contact[i].age_s += rests;
    }
    beyond = s * (q - from) - held_back(lates, contact, s);
    if (!(beyond > 0.0)) {
        return 0.0;
    }
    for (size_t i = 0; i < lates->count; i++) {
        contact[i].since += beyond;
        if (lates->of[i]->effect->slide) {
            lates->of[i]->effect->slide(lates->of[i]->v, &contact[i], beyond);
        }
    }
    const double to = q - s * held_back(lates, contact, s);
    if (!(play_push(play, own->table, own->table ? to : elements_motor(elements, &plays->course, to, s), s, scale) >
          0.0)) {
        return 0.0;
    }
    for (size_t i = 0; i < lates->count; i++) {
        own->contact[i] = contact[i];
    }
    return beyond;
}

// Where all plays are driven to: the motor for the falling and the rising end, and the same in the warp.
struct ends {
    double q[2], x[2];
};

static struct ends find_ends(const struct elements *elements, struct plays *plays, const struct effect_drive *drive) {
    struct ends ends;
    for (int s = PLAY_FALLING; s <= PLAY_RISING; s += 2) {
        const double q = s * drive->way < 0.0 ? s > 0 ? -HUGE_VAL : HUGE_VAL : drive->q - 0.5 * s * drive->extra;
        ends.q[s > 0] = q;
        ends.x[s > 0] = elements_motor(elements, &plays->course, q, s);
    }
    return ends;
}

// A play that has been pushed on from `from` comes there in first order, while its end goes there in a straight line:
// viscous drag beside friction, T p' = end - p, as what friction holds is the end's distance from the motor.
static void play_drag(const struct lates *lates, struct chain_play *own, double from, int s) {
    const double begins = isfinite(own->end[s > 0]) ? own->end[s > 0] : from;
    const double to = own->play.at, free = fmax(s * (from - begins), 0.0);
    const double share = 1.0 - free / (free + s * (to - from)); // of the step in which it is pushed
    own->play.at = effect_first_order(from, free > 0.0 ? from : begins, to, share * lates->dt, lates->drag_s);
    if (own->table) {
        own->play.half = 0.5 * play_width(own->table, own->play.at, &own->play.spans[s > 0]);
    }
}

// The same after a step by which it was pushed on side s, 0 on none.
static void plays_drag(const struct lates *lates, struct chain_play *own, const struct ends *ends, double scale,
                       double from, int s) {
    double end[2], half;
    for (int i = 0; i < 2; i++) {
        size_t at = own->play.spans[i];
        const double way = i > 0 ? 1.0 : -1.0;
        end[i] = own->table ? play_end(own->table, ends->q[i], way, scale, &at, &half)
                            : ends->x[i] - way * scale * own->play.half;
    }
    if (s) {
        play_drag(lates, own, from, s);
    }
    own->end[0] = end[0];
    own->end[1] = end[1];
}

// Returns how much of q's last step carried the play.
static inline double play_move(const struct lates *lates, const struct elements *elements, struct plays *plays,
                               struct chain_play *own, const struct ends *ends, double scale) {
    const double from = own->play.at;
    double beyond = 0.0;
    own->pushed = 0;
    for (int s = PLAY_FALLING; s <= PLAY_RISING && !own->pushed; s += 2) {
        const double q = ends->q[s > 0], x = own->table ? q : ends->x[s > 0];
        beyond = lates->count > 0 ? push_late(lates, elements, plays, own, q, x, s, scale * own->spread)
                                  : play_push(&own->play, own->table, x, s, scale * own->spread);
        own->pushed = beyond > 0.0 ? s : 0;
    }
    own->rested_s = own->pushed ? 0.0 : own->rested_s + lates->dt;
    if (lates->drag_s > 0.0) {
        plays_drag(lates, own, ends, scale * own->spread, from, own->pushed);
    }
    return beyond;
}

// Returns how much of it carried the play that it carried furthest.
static inline double push_all(const struct lates *lates, const struct elements *elements, struct plays *plays,
                              const struct ends *ends, double scale) {
    double furthest = 0.0;
    for (struct chain_play *own = plays->of, *end = own + plays->count; own != end; own++) {
        const double beyond = play_move(lates, elements, plays, own, ends, scale);
        furthest = beyond > furthest ? beyond : furthest;
    }
    return furthest;
}

static double mean_place(const struct plays *plays) {
    double sum = 0.0;
    for (const struct chain_play *own = plays->of, *end = own + plays->count; own != end; own++) {
        sum += own->share * own->play.at;
    }
    return sum;
}

// Plays in the motor's coordinate fall by themselves before their ends push them; what is faster than an end that
// pushes it leaves that end.
static void plays_fall(const struct active *falls, struct plays *plays, const struct effect_moment *now) {
    const double end_speed = now->dt > 0.0 ? now->moved / now->dt : 0.0;
    for (struct chain_play *own = plays->of, *end = own + plays->count; own != end; own++) {
        if (!own->table) {
            continue;
        }
        if (own->pushed * (end_speed - own->speed) > 0.0) {
            own->speed = end_speed;
        }
        falls->effect->fall(falls->v, now->dt, &own->play.at, &own->speed);
        own->play.half = 0.5 * play_width(own->table, own->play.at, &own->play.spans[0]);
    }
}

// The centre coordinate after all plays have moved; *carried as of a single one.
static double plays_move(const struct lates *lates, const struct active *falls, const struct elements *elements,
                         struct plays *plays, const struct effect_moment *now, struct effect_drive *drive,
                         double *carried) {
    if (elements->friction.kind) {
        *carried = INFINITY;
        return friction_move(&elements->friction, &elements->table, &plays->friction, drive->q, drive->scale,
                             drive->extra, 1);
    }
    if (falls) {
        drive->way = 0.0; // either end stops what falls
        plays_fall(falls, plays, now);
    }
    const struct ends ends = find_ends(elements, plays, drive);
    *carried = push_all(lates, elements, plays, &ends, drive->scale);
    const double sum = mean_place(plays);
    if (!elements->warp.knots) {
        return sum;
    }
    struct chain_play *single = &plays->of[plays->count];
    if (elements->narrow > 0.0) {
        play_move(lates, elements, plays, single, &ends, drive->scale);
    }
    return elements_centre(elements, &plays->course, sum, &single->play);
}

static double plays_lean(const struct elements *elements, const struct plays *plays) {
    if (elements->friction.kind) {
        return friction_lean(&elements->friction, &plays->friction);
    }
    double lean = 0.0;
    for (size_t i = 0; i < plays->count; i++) {
        lean += plays->of[i].share * plays->of[i].play.lean;
    }
    return lean;
}

double effect_pressed(double share, double wide) {
    return fmax(1.0 + share * (wide - 1.0), 0.0);
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

size_t effects_lots(const double *values, double *spread, double *share) {
    double state[MOST][EFFECT_STATES] = {{0}};
    struct all all;
    find_present(values, state, &all);
    return find_lots(&all, spread, share);
}

double effects_renewed_s(const double *values) {
    double state[MOST][EFFECT_STATES] = {{0}};
    struct all all;
    find_present(values, state, &all);
    double least = INFINITY;
    for (size_t i = 0; i < all.count; i++) {
        if (all.of[i].effect->renewed_s) {
            least = fmin(least, all.of[i].effect->renewed_s(all.of[i].v));
        }
    }
    return least;
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
    const struct active *following[MOST], *falls = NULL;
    struct lates lates = {.count = 0};
    size_t follows = 0;
    for (size_t i = 0; i < all.count; i++) {
        if (all.of[i].effect->late && lates.count < LATES) {
            lates.of[lates.count++] = &all.of[i];
        }
        falls = all.of[i].effect->fall ? &all.of[i] : falls;
        lates.drag_s = all.of[i].effect->drag_s ? all.of[i].effect->drag_s(all.of[i].v) : lates.drag_s;
        if (all.of[i].effect->follow) {
            following[follows++] = &all.of[i];
        }
    }
    struct effect_chain chain = {following, following + follows, 0.0};
    struct plays plays;
    find_plays(&all, tables->elements, &plays);
    const struct play_table *table = &tables->elements->table;
    size_t c_at = 0, bent_at = 0, width_at = 0;
    const double mean_width = play_mean_width(table);
    const double per_mean = all.count > 0 && mean_width > 0.0 ? 1.0 / mean_width : 0.0; // without effects nobody asks
    const double usual_speed = 0.1 * (table->grid[table->n - 1] - table->grid[0]);
    const double c_middle = tables->c_deg[table->n / 2];
    const double c_slope = (tables->c_deg[table->n - 1] - tables->c_deg[0]) / (10.0 * usual_speed);
    double before_t = 0.0, before_q = 0.0, centre = 0.0, lies = 0.0, bent_before = 0.0, again_s = INFINITY;
    const size_t last = motion->knots - 1;
    size_t knot = 0, asked = 0;
    int started = 0;

    while (asked < times->count) {
        // The next moment: a knot, a time that is asked for, or one that an effect asked for.
        int at_knot = knot <= last && motion->t_s[knot] <= times->t_s[asked];
        double t = at_knot ? motion->t_s[knot] : times->t_s[asked];
        const double again_t = before_t + again_s;
        if (t > again_t && again_t > before_t) { // not where a double cannot hold so small a step
            t = again_t;
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
            .translation = at(motion, knot, at_knot, t, motion->translation),
            .rotation = at(motion, knot, at_knot, t, motion->rotation),
            .usual_speed = usual_speed,
            .wide = per_mean > 0.0 ? play_width(table, started ? centre : rest, &width_at) * per_mean : 1.0,
            .slope = c_slope,
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
            plays_start(tables->elements, &plays, drive.q, isnan(p0) ? drive.q : p0);
        }
        lates.dt = now.dt;
        lates.moved = now.moved;
        lates.wide = now.wide;
        centre = plays_move(&lates, falls, tables->elements, &plays, &now, &drive, &carried);
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
        const signed char side =
            tables->elements->friction.kind ? plays.friction.side : plays.of[plays.middle].play.side;
        double tip = chain.out, lies_next = side;
        for (size_t i = 0; i < all.count; i++) {
            const struct active *a = &all.of[i];
            if (a->effect->hold) {
                tip = a->effect->hold(a->v, a->state, tip);
            }
            if (a->effect->lie) {
                const double bent = configuration(tables, &bent_at, tip) / c_slope;
                lies_next = started ? a->effect->lie(a->v, lies, bent - bent_before, &now) : side;
                bent_before = bent;
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
        path->lean[asked] = plays_lean(tables->elements, &plays);
        path->side[asked] = side;
        if (path->translation) {
            path->translation[asked] = now.translation;
        }
        if (path->rotation) {
            path->rotation[asked] = now.rotation;
        }
        asked++;
    }
}
