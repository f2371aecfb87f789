#include "tl_sections.h"

#include <string.h>

enum { SECTION_HEAD = 4, PLAYS_HEAD = 64, PLAYS_AT = 8 };
enum { STEP_LOG2_MAX = 22, PERIOD_LOG2_MIN = 8, PERIOD_LOG2_MAX = 26, PLAYS_MIN = 2 };

#define WEIGHT_FIRST_MIN 3277U              // 0.05, Q16
#define WEIGHT_ALL       65536U             // Q16
#define SHARE_ERROR_MAX  ((int64_t)1 << 28) // of the sum of shares, Q44: 2^-16
#define HALF_LOG2        26                 // of an element's half width, in Y's unit
#define PLACE_MAX        ((int32_t)1 << 24) // a distance, Q8 counts: 65536 counts

// Sections of words: where they are in a table.
static const struct words {
    uint16_t number, size, at;
} words[] = {
#define WORDS(number, name, FIELDS) {number, sizeof(tl_table_##name##_t), offsetof(tl_table_t, name)},
    TL_TABLE_SECTIONS(WORDS)
#undef WORDS
};
enum { WORDS = sizeof words / sizeof words[0] };

static bool has(const tl_table_t *table, const struct words *section) {
    return (table->has >> section->number & 1U) != 0;
}

size_t tl_sections_size(const tl_table_t *table) {
    size_t size = table->plays != 0 ? SECTION_HEAD + TL_TABLE_PLAYS_SIZE(table->nodes) : 0U;
    for (unsigned i = 0; i < WORDS; i++) {
        size += has(table, &words[i]) ? SECTION_HEAD + (size_t)words[i].size : 0U;
    }
    return size;
}

static uint8_t *put_plays(uint8_t *at, const tl_table_t *table) {
    tl_put(at, TL_TABLE_PLAYS_SECTION, 2);
    tl_put(at + 2, TL_TABLE_PLAYS_SIZE(table->nodes), 2);
    at += SECTION_HEAD;
    memset(at, 0, PLAYS_HEAD);
    at[0] = table->plays;
    at[1] = table->period_log2;
    tl_put(at + 4, (uint32_t)table->narrow, 4);
    for (unsigned i = 0; i < table->plays; i++) {
        tl_put(at + PLAYS_AT + 8U * i, table->play_width_q28[i], 4);
        tl_put(at + PLAYS_AT + 8U * i + 4U, table->play_weight_q16[i], 4);
    }
    return tl_put_column(at + PLAYS_HEAD, table->centre, table->nodes);
}

uint8_t *tl_sections_put(uint8_t *at, const tl_table_t *table) {
    if (table->plays != 0) {
        at = put_plays(at, table);
    }
    for (unsigned i = 0; i < WORDS; i++) {
        if (has(table, &words[i])) {
            tl_put(at, words[i].number, 2);
            tl_put(at + 2, words[i].size, 2);
            at = tl_put_column(at + SECTION_HEAD, (const int32_t *)((const char *)table + words[i].at),
                               words[i].size / 4U);
        }
    }
    return at;
}

// Which of `words` has this number; WORDS: none.
static unsigned row_of(unsigned number) {
    unsigned row = 0;
    while (row < WORDS && words[row].number != number) {
        row++;
    }
    return row;
}

static tl_table_reason_t get_plays(const uint8_t *at, tl_table_t *table) {
    if (at[0] < PLAYS_MIN || at[0] > TL_TABLE_PLAYS_MAX) {
        return TL_TABLE_BAD_PLAYS;
    }
    table->plays = at[0];
    table->period_log2 = at[1];
    table->narrow = (int32_t)tl_get(at + 4, 4);
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        table->play_width_q28[i] = tl_get(at + PLAYS_AT + 8U * i, 4);
        table->play_weight_q16[i] = tl_get(at + PLAYS_AT + 8U * i + 4U, 4);
        if (i >= table->plays && (table->play_width_q28[i] | table->play_weight_q16[i]) != 0) {
            return TL_TABLE_BAD_RESERVED;
        }
    }
    tl_get_column(at + PLAYS_HEAD, table->centre, table->nodes);
    return tl_get(at + 2, 2) == 0 ? TL_TABLE_OK : TL_TABLE_BAD_RESERVED;
}

tl_table_reason_t tl_sections_get(const uint8_t *begin, const uint8_t *end, tl_table_t *table) {
    unsigned last = 0;
    table->plays = 0;
    table->has = 0;
#define CLEAR(number, name, FIELDS) memset(&table->name, 0, sizeof table->name);
    TL_TABLE_SECTIONS(CLEAR)
#undef CLEAR
    size_t left = (size_t)(end - begin); // what is left, and so never beyond the end
    while (left != 0) {
        if (left < SECTION_HEAD) {
            return TL_TABLE_BAD_SECTION;
        }
        const unsigned number = tl_get(end - left, 2);
        const unsigned row = row_of(number);
        const size_t size = row < WORDS ? words[row].size : TL_TABLE_PLAYS_SIZE(table->nodes);
        const bool known = row < WORDS || number == TL_TABLE_PLAYS_SECTION;
        const bool sized = tl_get(end - left + 2, 2) == size;
        left -= SECTION_HEAD;
        if (number <= last || !known || !sized || size > left) {
            return TL_TABLE_BAD_SECTION;
        }
        const uint8_t *content = end - left;
        last = number;
        left -= size;
        if (row < WORDS) {
            tl_get_column(content, (int32_t *)((char *)table + words[row].at), words[row].size / 4U);
            table->has |= 1U << number;
            continue;
        }
        const tl_table_reason_t reason = get_plays(content, table);
        if (reason != TL_TABLE_OK) {
            return reason;
        }
    }
    return TL_TABLE_OK;
}

// -- what they may say -------------------------------------------------------------------------------------------

// The shares of the elements: what they sum up to is told to 2^-16.
static tl_table_reason_t check_plays(const tl_table_t *t) {
    if (t->plays < PLAYS_MIN || t->plays > TL_TABLE_PLAYS_MAX || tl_outside(t->narrow, 0, TL_TABLE_WIDTH_MAX) ||
        t->play_weight_q16[0] < WEIGHT_FIRST_MIN) {
        return TL_TABLE_BAD_PLAYS;
    }
    uint32_t weight = 0;
    int64_t width = -((int64_t)1 << 44);
    for (unsigned i = 0; i < t->plays; i++) {
        const uint32_t share = t->play_weight_q16[i];
        if (share == 0 || share > WEIGHT_ALL || (i > 0 && t->play_width_q28[i] <= t->play_width_q28[i - 1U])) {
            return TL_TABLE_BAD_PLAYS;
        }
        weight += share;
        if (weight > WEIGHT_ALL) {
            return TL_TABLE_BAD_PLAYS;
        }
        width += (int64_t)((uint64_t)share * t->play_width_q28[i]);
    }
    if (weight != WEIGHT_ALL || width > SHARE_ERROR_MAX || width < -SHARE_ERROR_MAX) {
        return TL_TABLE_BAD_PLAYS;
    }
    const uint64_t widest = t->play_width_q28[t->plays - 1U];
    if (t->period_log2 < PERIOD_LOG2_MIN || t->period_log2 > PERIOD_LOG2_MAX ||
        widest << t->period_log2 >> (28 + 1 + HALF_LOG2) != 0) {
        return TL_TABLE_BAD_WARP;
    }
    for (unsigned i = 0; i < t->nodes; i++) {
        if (tl_outside(t->centre[i], -TL_TABLE_CENTRE_MAX, TL_TABLE_CENTRE_MAX) ||
            (i > 0 && t->centre[i] <= t->centre[i - 1U])) {
            return TL_TABLE_BAD_WARP;
        }
    }
    return TL_TABLE_OK;
}

static int64_t size_of(int32_t value) {
    return value < 0 ? -(int64_t)value : value;
}

// e' = 2 pi (..) / period: its harmonics at their worst, at most 1/2.
static bool is_encoder(const tl_table_t *t) {
    const tl_table_encoder_t *e = &t->encoder;
    const int64_t slope = size_of(e->sine) + size_of(e->cosine) + 2 * (size_of(e->sine2) + size_of(e->cosine2));
    const int64_t four_pi_q4 = 202;
    return e->period_q12 >= 1 << 12 && slope < TL_TABLE_ENCODER_MAX && slope * four_pi_q4 <= e->period_q12;
}

static bool is_sides(const tl_table_t *t) {
    const tl_table_sides_t *s = &t->sides;
    if ((s->side != 1 && s->side != -1) || tl_outside(s->step_log2, 0, STEP_LOG2_MAX)) {
        return false;
    }
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        if (tl_outside(s->late[i], 0, PLACE_MAX)) {
            return false;
        }
        const int32_t falls = i > 0 ? s->late[i - 1U] - s->late[i] : 0;
        const int32_t travel_log2 = s->step_log2 + (i < 5U ? 0 : ((int32_t)i - 3) / 2); // of the last piece
        if (tl_outside(falls, 0, (int32_t)1 << travel_log2)) {
            return false;
        }
    }
    return true;
}

static bool is_speed(const tl_table_t *t) {
    const tl_table_speed_t *s = &t->speed;
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        if (tl_outside(s->extra[i], 0, PLACE_MAX)) {
            return false;
        }
    }
    return !tl_outside(s->step_log2, 0, STEP_LOG2_MAX) && !tl_outside(s->time_us, 0, 10000000) &&
           !tl_outside(s->held, 0, 1);
}

static bool is_late(const tl_table_t *t) {
    for (unsigned i = 0; i < TL_TABLE_LATE_MAX; i++) {
        const int32_t time_us = t->late.time_us[i], gain = t->late.gain_q16[i];
        if (time_us == 0 ? gain != 0 : tl_outside(time_us, 1000, 1000000000)) {
            return false;
        }
        if (tl_outside(gain, -((int32_t)1 << 26) + 1, ((int32_t)1 << 26) - 1)) {
            return false;
        }
    }
    return true;
}

static bool is_load(const tl_table_t *t) {
    const tl_table_load_t *l = &t->load;
    const int32_t most = (int32_t)1 << 24; // 1 or 256 counts per mNm; 65536 mNm
    return size_of(l->reference) <= most && size_of(l->width) <= most && size_of(l->gain) <= most &&
           size_of(l->offset) <= most && !tl_beyond(l->middle);
}

static bool is_joints(const tl_table_t *t) {
    const int32_t most = ((int32_t)1 << 26) - 1; // 0.25 deg a count
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        const int32_t axis = t->joints.axis[i];
        if (tl_outside(axis, 0, (int32_t)TL_TABLE_AXES) || axis == t->axis + 1 ||
            tl_outside(t->joints.play[i], 0, PLACE_MAX) || tl_outside(t->joints.slope[i], -most, most)) {
            return false;
        }
    }
    return true;
}

static bool is_adapt(const tl_table_t *t) {
    const tl_table_adapt_t *a = &t->adapt;
    return !tl_outside(a->offset, 0, TL_TABLE_ADAPT_OFFSET_MAX) && !tl_outside(a->width_least_q15, 0, TL_RATIO_ONE) &&
           !tl_outside(a->width_most_q15, TL_RATIO_ONE, 2 * TL_RATIO_ONE);
}

static bool is_anew(const tl_table_t *t) {
    return (t->has & TL_TABLE_HAS_sides) != 0 && !tl_outside(t->anew.rest_us, 1, 10000000);
}

// Whether `most`, Q8 counts, stays within PLACE_MAX where B is as wide as anywhere.
static bool stays(const tl_table_pressed_t *by, int32_t share_q16, int64_t most, int32_t widest) {
    const int64_t beyond = widest > by->mean ? widest - by->mean : 0;
    return most * (by->mean + ((share_q16 * beyond + 0xFFFF) >> 16)) <= (int64_t)PLACE_MAX * by->mean;
}

// q has to go on with p on either side: p + (B + extra) / 2 + late, where B' brings share B' / mean of both along.
static bool leaves_a_motion(const tl_table_t *t, int64_t speeds) {
    const tl_table_pressed_t *by = &t->pressed;
    const int64_t brings = (2 * (int64_t)t->sides.late[0] * by->sides_q16 + speeds * by->speed_q16) >> 16;
    const int64_t most = ((int64_t)2 << t->step_log2) * by->mean;
    for (unsigned i = 1; i < t->nodes; i++) {
        if (size_of(t->width[i] - t->width[i - 1U]) * (by->mean + brings) >= most) {
            return false;
        }
    }
    return true;
}

static bool is_pressed(const tl_table_t *t) {
    const tl_table_pressed_t *by = &t->pressed;
    const bool sides = (t->has & TL_TABLE_HAS_sides) != 0, speed = (t->has & TL_TABLE_HAS_speed) != 0;
    const int32_t two = (int32_t)2 << 16;
    if (tl_outside(by->mean, 1, TL_TABLE_WIDTH_MAX) || tl_outside(by->sides_q16, 0, sides ? two : 0) ||
        tl_outside(by->speed_q16, 0, speed ? two : 0)) {
        return false;
    }
    int32_t widest = 0, speeds = 0;
    for (unsigned i = 0; i < t->nodes; i++) {
        widest = t->width[i] > widest ? t->width[i] : widest;
    }
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        speeds = t->speed.extra[i] > speeds ? t->speed.extra[i] : speeds;
    }
    return widest <= TL_TABLE_WIDE_MAX * (int64_t)by->mean && stays(by, by->sides_q16, t->sides.late[0], widest) &&
           stays(by, by->speed_q16, speeds, widest) && leaves_a_motion(t, speeds);
}

static bool is_before(const tl_table_t *t) {
    const int32_t most = ((int32_t)1 << 26) - 1; // 64 counts a count
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        const bool may = t->joints.axis[i] != 0 && t->joints.slope[i] == 0;
        if (tl_outside(t->before.slope_q20[i], may ? -most : 0, may ? most : 0)) {
            return false;
        }
    }
    return (t->has & TL_TABLE_HAS_joints) != 0;
}

tl_table_reason_t tl_sections_check(const tl_table_t *t) {
    if (t->plays != 0) {
        const tl_table_reason_t reason = check_plays(t);
        if (reason != TL_TABLE_OK) {
            return reason;
        }
    }
#define CHECK(name, NAME)                                                                                              \
    if ((t->has & TL_TABLE_HAS_##name) != 0 && !is_##name(t)) {                                                        \
        return TL_TABLE_BAD_##NAME;                                                                                    \
    }
    CHECK(encoder, ENCODER)
    CHECK(sides, SIDES)
    CHECK(speed, SPEED)
    CHECK(late, LATE)
    CHECK(load, LOAD)
    CHECK(joints, JOINTS)
    CHECK(adapt, ADAPT)
    CHECK(anew, ANEW)
    CHECK(pressed, PRESSED)
    CHECK(before, BEFORE)
#undef CHECK
    return TL_TABLE_OK;
}
