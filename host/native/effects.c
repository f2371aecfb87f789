#include "effects.h"

#include <math.h>

enum { LOTS = 21 }; // thresholds that stand for a spread one: the corner becomes a polygon of as many pieces
enum { PLAYS = LOTS * ELEMENTS_MAX };
static const double SLOWER = 5.0;      // the creep's second element
static const double SHORTEST_S = 2e-3; // least step while a width follows the speed

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

// What asymmetry still holds back after so much travel.
static double held_back(const struct effect_parameters *e, double since) {
    return fabs(e->asymmetry) * exp(-pow(since / e->asymmetry_travel, e->asymmetry_form));
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

// What holds for all plays at one moment.
struct drive {
    double q, scale, extra;
    double way; // of the motor, where a play is carried only in it; else 0
};

// How far beyond the play's end on side s the motor is, at which it begins to carry it.
static double beyond_end(const struct warp *warp, struct play *play, const struct drive *drive, double s,
                         double scale) {
    if (!warp) {
        return s * (drive->q - play->p) - 0.5 * (scale * play->width + drive->extra);
    }
    const double end = warp_from(warp, &play->out[s > 0], play->p + 0.5 * s * scale * play->width);
    return s * (drive->q - end) - 0.5 * drive->extra;
}

// Moves the play, in the warp if it is an element of several, to `drive`. Returns how much of q's last step carried it.
static double play_move(const struct effect_parameters *e, const struct effect_tables *tables, const struct warp *warp,
                        struct play *play, const struct drive *drive, double spread) {
    const double scale = drive->scale * spread;
    const double delayed = e->asymmetry > 0.0 ? 1.0 : -1.0;
    for (int s = -1; s <= 1; s += 2) {
        if (s * drive->way < 0.0) {
            continue;
        }
        const int waits = e->asymmetry != 0.0 && s * delayed > 0.0;
        double since = play->side == s ? play->since : 0.0;
        double late = waits ? held_back(e, since) : 0.0;
        const double carried = beyond_end(warp, play, drive, s, scale) - late;
        if (carried <= 0.0) {
            continue;
        }
        if (waits) {
            since += carried;
            late = held_back(e, since);
        }
        const double q = drive->q - s * late;
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

// A first-order element whose input goes from u0 to u1 in a straight line.
static double follow(double y, double u0, double u1, double dt, double time) {
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

struct late {
    double first, second; // the lag's stages
    double fast, slow;    // the creep's elements
    double held;          // where stick-slip holds the tip
};

// One step in which the centre goes straight from u0 to u1.
static void late_move(const struct effect_parameters *e, struct late *late, double u0, double u1, double dt) {
    double v0 = u0, v1 = u1;
    if (e->lag > 0.0) {
        const double one = e->lag * (1.0 - e->lag_second);
        const double two = e->lag * e->lag_second;
        // The second stage's input bends: it is cut into straight pieces shorter than the stages.
        const int pieces = two > 0.0 ? (int)fmin(16.0, 1.0 + dt / (0.3 * two)) : 1;
        for (int i = 0; i < pieces; i++) {
            const double from = u0 + (u1 - u0) * i / pieces;
            const double to = u0 + (u1 - u0) * (i + 1) / pieces;
            const double before = late->first;
            late->first = follow(before, from, to, dt / pieces, one);
            v0 = late->second;
            late->second = follow(v0, before, late->first, dt / pieces, two);
            v1 = late->second;
            if (e->creep_share != 0.0) {
                late->fast = follow(late->fast, v0, v1, dt / pieces, e->creep_time);
                late->slow = follow(late->slow, v0, v1, dt / pieces, SLOWER * e->creep_time);
            }
        }
    } else {
        late->second = v1;
        if (e->creep_share != 0.0) {
            late->fast = follow(late->fast, v0, v1, dt, e->creep_time);
            late->slow = follow(late->slow, v0, v1, dt, SLOWER * e->creep_time);
        }
    }
}

static double late_tip(const struct effect_parameters *e, struct late *late) {
    double tip = late->second;
    if (e->creep_share != 0.0) {
        tip -= e->creep_share * (tip - (1.0 - e->creep_slow) * late->fast - e->creep_slow * late->slow);
    }
    if (e->stick > 0.0) {
        late->held += e->stick * trunc((tip - late->held) / e->stick); // as many jumps as it takes
        tip = late->held;
    }
    return tip;
}

// c and dc/df for f_remain's value f.
static double configured(const struct effect_parameters *e, double f, double middle, double load, double added,
                         double *gain) {
    *gain = 1.0 + e->gain_per_load * load;
    double c = middle + (f - middle) * *gain + added;
    const double beyond = (c - e->contact_c) * e->contact_side;
    if (beyond > 0.0 && e->contact_hold != 0.0) {
        const double soft = e->contact_soft;
        const double yields = soft > 0.0 ? exp(-beyond / soft) : 0.0;
        c -= e->contact_hold * (beyond - soft * (1.0 - yields)) * e->contact_side;
        *gain *= 1.0 - e->contact_hold * (1.0 - yields);
    }
    return c;
}

// The share of all thresholds above the i-th of `plays` lots: they shrink towards the longest, whose tail is thin.
static double above(int i, int plays) {
    return pow(1.0 - (double)i / plays, 1.5);
}

// The mean threshold of a lot, in units of the spread: over all lots 0, evenly from -1 to 1, or exponentially from
// -1/2.
static double threshold(const struct effect_parameters *e, double most, double least) {
    const double even = 1.0 - most - least;
    const double logs = least > 0.0 ? least * log(least) : 0.0; // the integral of -log v is v - v log v
    const double tail = 0.5 * (logs - most * log(most)) / (most - least);
    return even + e->onset_tail * (tail - even);
}

static void plays_start(const struct effect_tables *tables, struct play *play, int plays, double q, double p) {
    const struct elements *elements = tables->elements;
    struct span_cursor at = {0};
    struct warp_cursor in = {0}, centre = {0};
    double z[ELEMENTS_MAX] = {0};
    if (elements) {
        elements_start(elements, warp_to(&elements->warp, &in, q), elements_centre(elements, &centre, p), z);
    }
    for (int i = 0; i < plays; i++) {
        const size_t element = elements ? (size_t)i % elements->n : 0;
        play[i].p = elements ? z[element] : p;
        play[i].width = elements ? 2.0 * elements->r[element] : interpolate(tables, tables->width, &at, p);
    }
}

// Where the motor is that reads so: the encoder errs by where its shaft is, x = q + error(x).
static double shaft(const struct effect_parameters *e, double turn, double q) {
    double x = q;
    for (int i = 0; i < 3; i++) {
        const double s = sin(turn * x), c = cos(turn * x), s2 = 2.0 * s * c, c2 = c * c - s * s;
        const double error = e->encoder_sin * s + e->encoder_cos * c + e->encoder_sin2 * s2 + e->encoder_cos2 * c2;
        const double slope =
            turn * (e->encoder_sin * c - e->encoder_cos * s + 2.0 * e->encoder_sin2 * c2 - 2.0 * e->encoder_cos2 * s2);
        x -= (x - q - error) / fmax(1.0 - slope, 0.2);
    }
    return x;
}

void effects_simulate(const struct effect_parameters *e, const struct effect_tables *tables,
                      const struct effect_motion *motion, const struct effect_times *times, double p0,
                      const struct effect_path *path) {
    const double turn = 6.283185307179586 / e->encoder_period;
    const struct elements *elements = tables->elements;
    const struct warp *warp = elements ? &elements->warp : NULL;
    const int lots = e->onset_spread != 0.0 ? LOTS : 1;
    const int each = elements ? (int)elements->n : 1;
    const int plays = lots * each;
    const int wobbles =
        e->encoder_sin != 0.0 || e->encoder_cos != 0.0 || e->encoder_sin2 != 0.0 || e->encoder_cos2 != 0.0;
    const int remembers = e->lag > 0.0 || e->creep_share != 0.0;
    const double usual_speed = 0.1 * (tables->grid[tables->nodes - 1] - tables->grid[0]);
    const double resting = 1e-5 * usual_speed;
    const double follows = fmax(0.25 * e->speed_time, SHORTEST_S);
    const double c_middle = tables->c_deg[tables->nodes / 2];
    double spread[LOTS] = {1.0}, share_of[LOTS] = {1.0};
    int middle = 0; // the play that half of all have moved before
    for (int i = 0; lots > 1 && i < lots; i++) {
        const double most = above(i, lots), least = above(i + 1, lots);
        spread[i] = fmax(0.0, 1.0 + e->onset_spread * threshold(e, most, least));
        share_of[i] = most - least;
        middle = most > 0.5 ? i * each : middle;
    }
    struct play play[PLAYS] = {0};
    struct play single = {0}; // beside several elements, for where B is narrow
    struct warp_cursor low_at = {0}, high_at = {0};
    double weight = 0.0;
    for (int i = 0; i < plays; i++) {
        play[i].share = share_of[i / each] * (elements ? elements->w[i % each] : 1.0);
        if (elements && i < each) {
            middle += weight < 0.5 && i > 0;
            weight += elements->w[i];
        }
    }
    struct span_cursor c_at = {0};
    struct late late = {0};
    double before_t = 0.0, before_q = 0.0, centre = 0.0, speed = 0.0, lies = 0.0;
    const size_t last = motion->knots - 1;
    size_t knot = 0, asked = 0;
    int started = 0, unsettled = 0;

    while (asked < times->count) {
        // The next moment: a knot, a time that is asked for, or one shortly after while the width follows the speed.
        int at_knot = knot <= last && motion->t_s[knot] <= times->t_s[asked];
        double t = at_knot ? motion->t_s[knot] : times->t_s[asked];
        const int between = unsettled && t > before_t + follows;
        if (between) {
            t = before_t + follows;
            at_knot = 0;
        }
        double q, load = 0.0;
        if (at_knot || knot == 0 || knot > last) {
            const size_t k = knot > last ? last : knot;
            q = motion->q[k];
            load = motion->load ? motion->load[k] : 0.0;
        } else {
            const double span = motion->t_s[knot] - motion->t_s[knot - 1];
            const double share = span > 0.0 ? (t - motion->t_s[knot - 1]) / span : 1.0;
            q = motion->q[knot - 1] + share * (motion->q[knot] - motion->q[knot - 1]);
            if (motion->load) {
                load = motion->load[knot - 1] + share * (motion->load[knot] - motion->load[knot - 1]);
            }
        }
        const double rest = q;
        if (wobbles) {
            q = shaft(e, turn, q);
        }
        const double session = t + times->session_s;
        const double gone = e->drift_decay > 0.0 ? (1.0 - exp(-e->drift_decay * session)) / e->drift_decay : session;
        const double dt = started ? t - before_t : 0.0;
        const double moved = started ? rest - before_q : 0.0;
        if (dt > 0.0 && e->width_per_speed != 0.0 && (fabs(moved) > resting * dt || e->width_held == 0.0)) {
            speed += (moved / dt - speed) * (1.0 - exp(-dt / e->speed_time));
            unsettled = fabs(moved / dt - speed) > 0.01 * usual_speed;
        }
        const double relative = fabs(speed) / usual_speed;
        const struct drive drive = {
            .q = q + e->offset_drift * gone + e->offset_per_load * load,
            .way = e->width_held != 0.0 && e->width_per_speed != 0.0 ? (moved > 0.0 ? 1.0 : -1.0) : 0.0,
            .scale = fmax(0.0, (1.0 + e->width_per_load * load) * (1.0 + e->width_drift * gone)),
            .extra =
                e->held_back + (e->width_per_speed == 0.0 || relative == 0.0
                                    ? 0.0
                                    : fmax(0.0, e->width_per_speed * usual_speed * pow(relative, e->speed_exponent))),
        };
        const double from = centre;
        double sum = 0.0, carried = 0.0;
        if (!started) {
            plays_start(tables, play, plays, drive.q, isnan(p0) ? drive.q : p0);
            plays_start(&(struct effect_tables){tables->grid, tables->width, tables->c_deg, tables->nodes, NULL},
                        &single, 1, drive.q, isnan(p0) ? drive.q : p0);
        }
        for (int i = 0; i < plays; i++) {
            carried = fmax(carried, play_move(e, tables, warp, &play[i], &drive, spread[i / each]));
            sum += play[i].share * play[i].p;
        }
        centre = elements ? elements_position(elements, &low_at, &high_at, sum) : sum;
        if (elements && elements->narrow > 0.0) {
            play_move(e, tables, NULL, &single, &drive, 1.0);
            if (interpolate(tables, tables->width, &c_at, centre) < elements->narrow) {
                centre = single.p;
            }
        }
        if (!started) {
            late = (struct late){centre, centre, centre, centre, centre};
        }
        if (remembers && started) {
            // Caught within the step: at rest before, on the move after.
            const double share = plays == 1 && moved != 0.0 ? fmin(carried / fabs(moved), 1.0) : 1.0;
            if (share < 1.0 - 1e-9) {
                late_move(e, &late, from, from, (1.0 - share) * dt);
            }
            late_move(e, &late, from, centre, share * dt);
        } else {
            late.second = centre;
        }
        const signed char side = play[middle].side;
        if (started && e->tilt_travel > 0.0) {
            lies += (side - lies) * (1.0 - exp(-fabs(centre - from) / e->tilt_travel));
        } else {
            lies = side;
        }
        started = 1;
        before_t = t;
        before_q = rest;
        const double tip = late_tip(e, &late);
        unsettled = unsettled || (at_knot && e->width_per_speed != 0.0);
        knot += (size_t)at_knot;
        if (t < times->t_s[asked]) {
            continue;
        }
        double added = 0.0;
        if (times->translation) {
            added += e->c_per_translation * times->translation[asked];
        }
        if (times->rotation) {
            added += e->c_per_rotation * times->rotation[asked];
        }
        path->c_deg[asked] =
            configured(e, configuration(tables, &c_at, tip), c_middle, load, added, &path->gain[asked]);
        path->p[asked] = centre;
        path->tip[asked] = tip;
        path->way[asked] = lies;
        path->side[asked] = side;
        asked++;
    }
}

void effects_thin(const double *t_s, size_t samples, const double *values, const double *tolerance, size_t channels,
                  double rest_s, unsigned char *keep) {
    for (size_t k = 0; k < samples; k++) {
        keep[k] = k == 0 || k + 1 == samples;
    }
    // The ends of rests.
    for (size_t k = 1, begin = 0; k <= samples; k++) {
        int same = k < samples;
        for (size_t c = 0; same && c < channels; c++) {
            same = values[c * samples + k] == values[c * samples + k - 1];
        }
        if (!same) {
            if (t_s[k - 1] - t_s[begin] > rest_s) {
                keep[begin] = keep[k - 1] = 1;
            }
            begin = k;
        }
    }
    // Slopes from `start` on that pass all samples since within tolerance: a sample whose own slope is outside ends the
    // piece at the one before.
    double low[EFFECT_CHANNELS], high[EFFECT_CHANNELS];
    size_t start = 0;
    for (size_t k = 1; k < samples; k++) {
        int fits = k > start + 1;
        for (size_t c = 0; fits && c < channels; c++) {
            const double *v = values + c * samples;
            const double slope = (v[k] - v[start]) / (t_s[k] - t_s[start]);
            fits = slope >= low[c] && slope <= high[c];
        }
        if (!fits && k > start + 1) {
            start = k - 1;
            keep[start] = 1;
        }
        const double dt = t_s[k] - t_s[start];
        for (size_t c = 0; c < channels; c++) {
            const double *v = values + c * samples;
            const double least = (v[k] - tolerance[c] - v[start]) / dt;
            const double most = (v[k] + tolerance[c] - v[start]) / dt;
            low[c] = k > start + 1 ? fmax(low[c], least) : least;
            high[c] = k > start + 1 ? fmin(high[c], most) : most;
        }
        if (keep[k]) {
            start = k;
        }
    }
}
