/// What the blob is made of: little-endian integers, columns, sections. For common/src alone.
#ifndef TAUTLINE_TL_SECTIONS_H
#define TAUTLINE_TL_SECTIONS_H

#include "tautline/tl_table.h"

static inline void tl_put(uint8_t *at, uint32_t value, unsigned size) {
    for (unsigned i = 0; i < size; i++) {
        at[i] = (uint8_t)(value >> (8U * i));
    }
}

static inline uint32_t tl_get(const uint8_t *at, unsigned size) {
    uint32_t value = 0;
    for (unsigned i = 0; i < size; i++) {
        value |= (uint32_t)at[i] << (8U * i);
    }
    return value;
}

static inline uint8_t *tl_put_column(uint8_t *at, const int32_t *values, unsigned nodes) {
    for (unsigned i = 0; i < nodes; i++, at += 4) {
        tl_put(at, (uint32_t)values[i], 4);
    }
    return at;
}

static inline const uint8_t *tl_get_column(const uint8_t *at, int32_t *values, unsigned nodes) {
    for (unsigned i = 0; i < nodes; i++, at += 4) {
        values[i] = (int32_t)tl_get(at, 4);
    }
    return at;
}

static inline bool tl_beyond(int32_t value) {
    return value > TL_TABLE_VALUE_MAX || value < -TL_TABLE_VALUE_MAX;
}

static inline bool tl_outside(int32_t value, int32_t low, int32_t high) {
    return value < low || value > high;
}

/// Of all sections that the table has, their heads included.
size_t tl_sections_size(const tl_table_t *table);

/// Writes them; returns where they end.
uint8_t *tl_sections_put(uint8_t *at, const tl_table_t *table);

/// Reads those from `begin` up to `end`.
tl_table_reason_t tl_sections_get(const uint8_t *begin, const uint8_t *end, tl_table_t *table);

/// Their content, of a table whose header and nodes are sound.
tl_table_reason_t tl_sections_check(const tl_table_t *table);

#endif
