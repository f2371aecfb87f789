#include "tautline/tl_compensator.h"

#define FRACTION_BITS 28 // below a Q8 count: 0.1 count/s at 10 kHz is 0.0026 Q8 counts a tick, kept to 2e-6

#define RATE_MIN_HZ 16U
#define RATE_MAX_HZ 100000U

static int64_t q36(int32_t q8) { return (int64_t)((uint64_t)(int64_t)q8 << FRACTION_BITS); }

static int64_t per_tick(int64_t per_second_q36, uint32_t rate_hz) {
    const int64_t value = per_second_q36 / (int64_t)rate_hz;
    return value > 0 ? value : 1;
}

static void set_limits(tl_compensator_t *k, const tl_table_t *table) {
    const int64_t speed = per_tick(q36(table->takeup_speed_q8), k->rate_hz);
    // counts/s^2 in Q8 with 28 bits over rate^2: the first division leaves room for all of a 31-bit limit.
    const int64_t accel = per_tick(per_tick(q36(table->takeup_accel) << 4, k->rate_hz) << 4, k->rate_hz);
    k->next_limits.speed = speed;
    k->next_limits.accel = accel < speed ? accel : speed;
    k->limits_pending = true;
    k->feed_max_q36 = per_tick(q36(table->speed_max_q8), k->rate_hz);
    k->feed_flat_q36 = table->flat_speed_q8 > 0 ? per_tick(q36(table->flat_speed_q8), k->rate_hz) : k->feed_max_q36;
}

// p* for c, within [q_min, q_max].
static tl_count_q8_t target(const tl_compensator_t *k, tl_deg_q16_t c, uint32_t *flags) {
    const tl_table_t *table = &k->lookup->table;
    uint32_t outside = 0;
    tl_count_q8_t p;
    if (k->mode == TL_MODE_FULL && table->nodes != 0) {
        p = tl_lookup_angle_inverse(k->lookup, c, &outside);
        if (p < table->q_min) {
            p = table->q_min;
            outside |= TL_LOOKUP_BELOW;
        } else if (p > table->q_max) {
            p = table->q_max;
            outside |= TL_LOOKUP_ABOVE;
        }
    } else {
        p = tl_lookup_coarse_inverse(k->lookup, c, &outside);
    }
    *flags |= outside & TL_LOOKUP_BELOW ? TL_COMPENSATOR_BELOW : 0;
    *flags |= outside & TL_LOOKUP_ABOVE ? TL_COMPENSATOR_ABOVE : 0;
    return p;
}

// q* without what is still to be taken up.
static tl_count_q8_t feed(const tl_compensator_t *k, uint32_t *flags) {
    const tl_table_t *table = &k->lookup->table;
    uint32_t outside = 0;
    tl_count_q8_t q = k->p;
    if (k->mode != TL_MODE_OFF && k->side != 0) {
        const uint32_t width = (uint32_t)tl_lookup_width(k->lookup, k->p, &outside);
        const uint32_t strength = (uint32_t)k->strength_q15;
        const int32_t half = (int32_t)((width >> 16) * strength + ((width & 0xFFFFU) * strength >> 16)); // k B / 2
        q = k->side > 0 ? tl_add_sat(q, half) : tl_sub_sat(q, half);
    }
    const tl_count_q8_t within = tl_clamp(q, table->q_min, table->q_max);
    *flags |= within != q ? TL_COMPENSATOR_CLIPPED : 0;
    return within;
}

// After a change of settings: the output stays, the difference is to be taken up.
static void absorb(tl_compensator_t *k, tl_count_q8_t feed_before) {
    uint32_t flags = 0;
    k->rest_q36 += q36(feed(k, &flags)) - q36(feed_before);
}

static void follow_direction(tl_compensator_t *k, uint32_t *flags) {
    const int32_t band = k->lookup->table.band;
    const int32_t ahead = k->p - k->anchor; // both within the range: no overflow
    if (k->side != 0 && (k->side > 0 ? ahead >= 0 : ahead <= 0)) {
        k->anchor = k->p;
    } else if (ahead > band || ahead < -band) {
        const tl_count_q8_t before = feed(k, flags);
        k->side = ahead > 0 ? 1 : -1;
        k->anchor = k->p;
        absorb(k, before);
    }
}

static tl_count_q8_t node_at_or_below(const tl_table_t *table, tl_count_q8_t p) {
    const uint32_t offset = (uint32_t)p - (uint32_t)table->q0;
    return table->q0 + (int32_t)(offset >> table->step_log2 << table->step_log2);
}

// Moves p towards `goal`, no faster than speed_max, nor than the flat speed within flat spans.
static void advance(tl_compensator_t *k, tl_count_q8_t goal) {
    const tl_table_t *table = &k->lookup->table;
    int64_t limit = k->feed_max_q36;
    if (goal == k->p) {
        return;
    }
    if (k->lookup->has_flat && k->mode == TL_MODE_FULL) {
        // Never further than one span in a tick, so that no flat span is jumped over; up to its edge at full speed.
        const int32_t step = (int32_t)1 << table->step_log2;
        const tl_count_q8_t next = k->p + tl_clamp(goal - k->p, -step, step);
        if (tl_lookup_is_flat(k->lookup, k->p)) {
            limit = k->feed_flat_q36;
            goal = next;
        } else if (tl_lookup_is_flat(k->lookup, next)) {
            const tl_count_q8_t edge = node_at_or_below(table, next) + (goal > k->p ? 0 : step);
            limit = edge == k->p ? k->feed_flat_q36 : limit;
            goal = edge == k->p ? next : edge;
        } else {
            goal = next;
        }
        k->flags |= limit != k->feed_max_q36 ? TL_COMPENSATOR_FLAT : 0;
    }
    const int64_t budget = k->feed_budget_q36 + limit;
    const int64_t most = budget >> FRACTION_BITS;
    const int32_t allowed = most > INT32_MAX ? INT32_MAX : (int32_t)most;
    k->feed_budget_q36 = budget & (((int64_t)1 << FRACTION_BITS) - 1);
    k->p += tl_clamp(goal - k->p, -allowed, allowed);
}

// One tick of the trapezoid. The speed is n accel, so the distance to stop in is accel n (n + 1) / 2 and is kept
// up to date by sums alone; the last part of a count, less than one tick's accel, is moved at once.
static void take_up(tl_compensator_t *k) {
    if (k->heading == 0) {
        if (k->limits_pending) {
            k->limits = k->next_limits;
            k->limits_pending = false;
        }
        k->heading = k->rest_q36 > 0 ? 1 : (k->rest_q36 < 0 ? -1 : 0);
        if (k->heading == 0) {
            return;
        }
    }
    const int64_t accel = k->limits.accel;
    const int64_t ahead = k->heading > 0 ? k->rest_q36 : -k->rest_q36;
    if (k->limits_pending || ahead < k->stop_q36) {
        k->stop_q36 -= k->speed_q36;
        k->speed_q36 -= accel;
    } else if (k->speed_q36 + accel <= k->limits.speed && ahead >= k->stop_q36 + k->speed_q36 + accel) {
        k->speed_q36 += accel;
        k->stop_q36 += k->speed_q36;
    }
    const int64_t moved = k->speed_q36 == 0 && ahead > 0 && ahead < accel ? ahead : k->speed_q36;
    k->rest_q36 -= k->heading > 0 ? moved : -moved;
    k->heading = k->speed_q36 == 0 ? 0 : k->heading;
}

tl_count_q8_t tl_compensator_step(tl_compensator_t *k, tl_deg_q16_t c) {
    const tl_table_t *table = &k->lookup->table;
    k->flags = 0;
    k->c = c;
    const tl_count_q8_t goal = target(k, c, &k->flags);
    advance(k, goal);
    k->flags |= k->p != goal ? TL_COMPENSATOR_LIMITED : 0;
    follow_direction(k, &k->flags);
    take_up(k);
    const tl_count_q8_t fed = feed(k, &k->flags);
    const tl_count_q8_t wanted = tl_sub_sat(fed, tl_compensator_rest(k));
    // A start from outside the range may only lead inwards.
    const tl_count_q8_t low = k->q < table->q_min ? k->q : table->q_min;
    const tl_count_q8_t high = k->q > table->q_max ? k->q : table->q_max;
    k->q = tl_clamp(wanted, low, high);
    if (k->q != wanted) { // stopped at the end of the range: the take-up begins again from here
        k->flags |= TL_COMPENSATOR_CLIPPED;
        k->rest_q36 = q36(fed) - q36(k->q);
        k->speed_q36 = k->stop_q36 = 0;
        k->heading = 0;
    }
    k->flags |= k->rest_q36 != 0 || k->heading != 0 ? TL_COMPENSATOR_TAKE_UP : 0;
    k->flags |= k->side == 0 ? TL_COMPENSATOR_NO_SIDE : 0;
    return k->q;
}

void tl_compensator_start(tl_compensator_t *k, const tl_lookup_t *lookup, uint32_t rate_hz, tl_mode_t mode,
                          tl_count_q8_t q, tl_deg_q16_t c) {
    uint32_t flags = 0;
    *k = (tl_compensator_t){.lookup = lookup, .mode = mode, .c = c, .strength_q15 = lookup->table.strength_q15};
    k->rate_hz = rate_hz < RATE_MIN_HZ ? RATE_MIN_HZ : (rate_hz > RATE_MAX_HZ ? RATE_MAX_HZ : rate_hz);
    k->q = tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    set_limits(k, &lookup->table);
    k->p = k->anchor = target(k, c, &flags);
    absorb(k, k->q);
}

// p* again for the last command under new settings, with the direction's memory moved along.
static void settle(tl_compensator_t *k, tl_count_q8_t feed_before) {
    uint32_t flags = 0;
    const tl_count_q8_t p = target(k, k->c, &flags);
    k->anchor = tl_add_sat(k->anchor, p - k->p);
    k->p = p;
    absorb(k, feed_before);
}

void tl_compensator_set_mode(tl_compensator_t *k, tl_mode_t mode) {
    uint32_t flags = 0;
    const tl_count_q8_t before = feed(k, &flags);
    k->mode = mode;
    settle(k, before);
}

void tl_compensator_set_strength(tl_compensator_t *k, int32_t strength_q15) {
    uint32_t flags = 0;
    const tl_count_q8_t before = feed(k, &flags);
    k->strength_q15 = tl_clamp(strength_q15, 0, TL_RATIO_ONE);
    absorb(k, before);
}

void tl_compensator_set_table(tl_compensator_t *k, const tl_lookup_t *lookup) {
    uint32_t flags = 0;
    const tl_count_q8_t before = feed(k, &flags);
    k->lookup = lookup;
    set_limits(k, &lookup->table);
    settle(k, before);
}

tl_count_q8_t tl_compensator_rest(const tl_compensator_t *k) {
    return (tl_count_q8_t)((k->rest_q36 + ((int64_t)1 << (FRACTION_BITS - 1))) >> FRACTION_BITS);
}
