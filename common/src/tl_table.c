#include "tautline/tl_table.h"

#include "tl_sections.h"

#include "tautline/tl_crc.h"

#include <string.h>

static const uint8_t magic[4] = {'T', 'L', 'T', 'B'};

// The header's fields in their order (offset, bytes, type, name) serve writing and reading alike.
#define HEADER_FIELDS(X)                                                                                               \
    X(AXIS_AT, 1, uint8_t, axis)                                                                                       \
    X(9, 1, uint8_t, kind)                                                                                             \
    X(10, 1, uint8_t, unit)                                                                                            \
    X(11, 1, uint8_t, step_log2)                                                                                       \
    X(12, 2, uint16_t, nodes)                                                                                          \
    X(14, 2, uint16_t, strength_q15)                                                                                   \
    X(16, 4, uint32_t, nano_units_per_count)                                                                           \
    X(20, 4, int32_t, q0)                                                                                              \
    X(24, 4, int32_t, q_min)                                                                                           \
    X(28, 4, int32_t, q_max)                                                                                           \
    X(32, 4, int32_t, coarse_c_min)                                                                                    \
    X(36, 4, int32_t, coarse_c_max)                                                                                    \
    X(40, 4, int32_t, speed_max_q8)                                                                                    \
    X(44, 4, int32_t, takeup_speed_q8)                                                                                 \
    X(48, 4, int32_t, takeup_accel)                                                                                    \
    X(52, 4, int32_t, band)                                                                                            \
    X(56, 4, int32_t, slope_min_q28)                                                                                   \
    X(60, 4, int32_t, flat_speed_q8)                                                                                   \
    X(64, 4, uint32_t, delay_us)                                                                                       \
    X(68, 4, uint32_t, created_s)

enum { AXIS_AT = 8, MODEL_ID_AT = 72, INSTRUMENT_AT = 80 };

// Printable ASCII, then zeros.
static bool is_text(const char *text, size_t size) {
    bool ended = false;
    for (size_t i = 0; i < size; i++) {
        ended = ended || text[i] == 0;
        if (ended ? text[i] != 0 : text[i] < ' ' || text[i] > '~') {
            return false;
        }
    }
    return true;
}

size_t tl_table_encode(const tl_table_t *table, uint8_t *blob, size_t capacity) {
    if (table->nodes > TL_TABLE_NODES_MAX || table->plays > TL_TABLE_PLAYS_MAX) {
        return 0;
    }
    const size_t sections = tl_sections_size(table), size = TL_TABLE_SIZE(table->nodes) + sections;
    if (capacity < size) {
        return 0;
    }
    memcpy(blob, magic, sizeof magic);
    tl_put(blob + 4, sections != 0 ? TL_TABLE_FORMAT : TL_TABLE_FORMAT_PLAIN, 2);
    tl_put(blob + 6, (uint32_t)size, 2);
#define PUT(offset, bytes, type, name) tl_put(blob + (offset), (uint32_t)table->name, bytes);
    HEADER_FIELDS(PUT)
#undef PUT
    memcpy(blob + MODEL_ID_AT, table->model_id, sizeof table->model_id);
    memcpy(blob + INSTRUMENT_AT, table->instrument, sizeof table->instrument);
    uint8_t *at = tl_put_column(blob + TL_TABLE_HEADER_SIZE, table->width, table->nodes);
    at = tl_put_column(at, table->angle, table->nodes);
    at = tl_sections_put(at, table);
    tl_put(at, tl_crc32(0, blob, size - 4), 4);
    return size;
}

tl_table_reason_t tl_table_check_blob(const uint8_t *blob, size_t size, uint8_t axis) {
    if (size < TL_TABLE_SIZE(0U)) {
        return TL_TABLE_BAD_SHORT;
    }
    if (memcmp(blob, magic, sizeof magic) != 0) {
        return TL_TABLE_BAD_MAGIC;
    }
    const uint32_t format = tl_get(blob + 4, 2);
    if (format != TL_TABLE_FORMAT_PLAIN && format != TL_TABLE_FORMAT) {
        return TL_TABLE_BAD_FORMAT;
    }
    if (tl_get(blob + 6, 2) != size) {
        return TL_TABLE_BAD_SIZE;
    }
    if (tl_get(blob + size - 4, 4) != tl_crc32(0, blob, size - 4)) {
        return TL_TABLE_BAD_CRC;
    }
    const uint8_t own = blob[AXIS_AT];
    return own >= TL_TABLE_AXES || (axis != TL_TABLE_ANY_AXIS && axis != own) ? TL_TABLE_BAD_AXIS : TL_TABLE_OK;
}

tl_table_reason_t tl_table_decode(const uint8_t *blob, size_t size, uint8_t axis, tl_table_t *table) {
    tl_table_reason_t reason = tl_table_check_blob(blob, size, axis);
    if (reason != TL_TABLE_OK) {
        return reason;
    }
#define GET(offset, bytes, type, name) table->name = (type)tl_get(blob + (offset), bytes);
    HEADER_FIELDS(GET)
#undef GET
    memcpy(table->model_id, blob + MODEL_ID_AT, sizeof table->model_id);
    if (table->nodes > TL_TABLE_NODES_MAX) {
        return TL_TABLE_BAD_NODES;
    }
    memcpy(table->instrument, blob + INSTRUMENT_AT, sizeof table->instrument);
    if (!is_text(table->instrument, sizeof table->instrument)) {
        return TL_TABLE_BAD_RESERVED;
    }
    const size_t plain = TL_TABLE_SIZE(table->nodes);
    if (tl_get(blob + 4, 2) == TL_TABLE_FORMAT_PLAIN ? plain != size : plain > size) {
        return TL_TABLE_BAD_SIZE;
    }
    const uint8_t *at = tl_get_column(blob + TL_TABLE_HEADER_SIZE, table->width, table->nodes);
    at = tl_get_column(at, table->angle, table->nodes);
    reason = tl_sections_get(at, blob + size - 4, table);
    return reason == TL_TABLE_OK ? tl_table_check(table, axis) : reason;
}

static bool too_far(tl_count_q8_t position) {
    return tl_outside(position, -TL_TABLE_POSITION_MAX, TL_TABLE_POSITION_MAX);
}

static tl_table_reason_t check_header(const tl_table_t *t, uint8_t axis) {
    if (t->axis >= TL_TABLE_AXES || (axis != TL_TABLE_ANY_AXIS && axis != t->axis)) {
        return TL_TABLE_BAD_AXIS;
    }
    if (t->kind > TL_AXIS_ROTATION) {
        return TL_TABLE_BAD_KIND;
    }
    if (t->unit > TL_UNIT_DEG) {
        return TL_TABLE_BAD_UNIT;
    }
    if (t->nano_units_per_count == 0) {
        return TL_TABLE_BAD_SCALE;
    }
    if (t->nodes == 1 || t->nodes > TL_TABLE_NODES_MAX) {
        return TL_TABLE_BAD_NODES;
    }
    if (t->step_log2 > TL_TABLE_STEP_LOG2_MAX) {
        return TL_TABLE_BAD_STEP;
    }
    if (too_far(t->q0) || too_far(t->q_min) || too_far(t->q_max) || tl_beyond(t->coarse_c_min) ||
        tl_beyond(t->coarse_c_max)) {
        return TL_TABLE_BAD_SATURATES;
    }
    if (t->q_min >= t->q_max) {
        return TL_TABLE_BAD_RANGE;
    }
    if (t->strength_q15 > TL_RATIO_ONE) {
        return TL_TABLE_BAD_STRENGTH;
    }
    if (tl_outside(t->speed_max_q8, 1, TL_TABLE_VALUE_MAX) || tl_outside(t->takeup_speed_q8, 1, TL_TABLE_VALUE_MAX) ||
        tl_outside(t->takeup_accel, 1, INT32_MAX) || tl_outside(t->band, 0, TL_TABLE_VALUE_MAX) ||
        tl_outside(t->slope_min_q28, 0, INT32_MAX) || tl_outside(t->flat_speed_q8, 0, TL_TABLE_VALUE_MAX)) {
        return TL_TABLE_BAD_LIMITS;
    }
    if (t->delay_us > TL_TABLE_DELAY_MAX_US) {
        return TL_TABLE_BAD_DELAY;
    }
    if (t->coarse_c_min == t->coarse_c_max) {
        return TL_TABLE_BAD_COARSE;
    }
    return TL_TABLE_OK;
}

uint32_t tl_table_flat_below(const tl_table_t *table) {
    // deg Q16 per step of Q8 counts, times 2^20 / step, is deg per count in Q28.
    const uint64_t least = ((uint64_t)(uint32_t)table->slope_min_q28 << table->step_log2) + 0xFFFFFU;
    return least >> 52 != 0 ? UINT32_MAX : (uint32_t)(least >> 20);
}

static tl_table_reason_t check_nodes(const tl_table_t *t) {
    const int64_t grid_end = t->q0 + ((int64_t)(t->nodes - 1) << t->step_log2);
    if (grid_end > TL_TABLE_POSITION_MAX) {
        return TL_TABLE_BAD_SATURATES;
    }
    if (t->q_min < t->q0 || t->q_max > grid_end) {
        return TL_TABLE_BAD_RANGE;
    }
    const bool rises = t->angle[1] > t->angle[0];
    const int32_t steep = (int32_t)2 << t->step_log2;
    for (unsigned i = 0; i < t->nodes; i++) {
        if (t->width[i] < 0) {
            return TL_TABLE_BAD_WIDTH_NEGATIVE;
        }
        if (t->width[i] > TL_TABLE_WIDTH_MAX || tl_beyond(t->angle[i])) {
            return TL_TABLE_BAD_SATURATES;
        }
        if (i > 0) {
            const int32_t slope = t->width[i] - t->width[i - 1U]; // neither is negative: no overflow
            if (slope >= steep || slope <= -steep) {
                return TL_TABLE_BAD_WIDTH_STEEP;
            }
            if (t->angle[i] == t->angle[i - 1U] || (t->angle[i] > t->angle[i - 1U]) != rises) {
                return TL_TABLE_BAD_NOT_MONOTONE;
            }
        }
    }
    if (rises != (t->coarse_c_max > t->coarse_c_min)) {
        return TL_TABLE_BAD_COARSE;
    }
    const uint32_t flat_below = tl_table_flat_below(t);
    for (unsigned i = 0; i + 1U < t->nodes && t->flat_speed_q8 == 0; i++) {
        if ((uint32_t)tl_abs_sat(tl_sub_sat(t->angle[i + 1U], t->angle[i])) < flat_below) {
            return TL_TABLE_BAD_FLAT;
        }
    }
    return TL_TABLE_OK;
}

tl_table_reason_t tl_table_check(const tl_table_t *table, uint8_t axis) {
    const tl_table_reason_t reason = check_header(table, axis);
    if (reason != TL_TABLE_OK) {
        return reason;
    }
    if (table->nodes == 0) {
        const bool clean = table->q0 == 0 && table->step_log2 == 0 && table->plays == 0 && table->has == 0;
        return clean ? TL_TABLE_OK : TL_TABLE_BAD_RESERVED;
    }
    const tl_table_reason_t nodes = check_nodes(table);
    return nodes == TL_TABLE_OK ? tl_sections_check(table) : nodes;
}

_Static_assert(TL_TABLE_POSITION_MAX / TL_COUNT_ONE == 2097151 && TL_TABLE_WIDTH_MAX / TL_COUNT_ONE == 1048575 &&
                   TL_TABLE_VALUE_MAX < 16384 * TL_DEG_ONE,
               "as TL_TABLE_REASONS says");

const char *tl_table_reason_text(tl_table_reason_t reason) {
    static const char *const text[] = {"valid",
#define TEXT(name, words) words,
                                       TL_TABLE_REASONS(TEXT)
#undef TEXT
    };
    const unsigned index = (unsigned)reason;
    return index < TL_TABLE_REASON_COUNT ? text[index] : "unknown reason";
}
