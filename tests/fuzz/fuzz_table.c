// Any bytes as a table: what is taken comes back as it was read, and can be looked up anywhere. The first byte says
// whether size and CRC are made right, so that what lies behind them is reached.
#include "fuzz.h"

#include "tautline/tl_crc.h"
#include "tautline/tl_lookup.h"
#include "tautline/tl_play.h"

#include <string.h>

static uint8_t blob[TL_TABLE_SIZE_MAX], again[TL_TABLE_SIZE_MAX];
static tl_table_t table, back;
static tl_lookup_t lookup;

static void put(uint8_t *at, uint32_t value, int bytes) {
    for (int i = 0; i < bytes; i++) {
        at[i] = (uint8_t)(value >> (8 * i));
    }
}

static void look_up(tl_count_q8_t p, tl_deg_q16_t c) {
    uint32_t flags = 0;
    PROMISE(tl_lookup_width(&lookup, p, &flags) >= 0);
    (void)tl_lookup_angle(&lookup, p, &flags);
    const tl_count_q8_t inverse = tl_lookup_angle_inverse(&lookup, c, &flags);
    PROMISE(lookup.table.nodes == 0 || (inverse >= lookup.table.q_min && inverse <= lookup.table.q_max) ||
            (inverse >= -TL_TABLE_VALUE_MAX && inverse <= TL_TABLE_VALUE_MAX));
    (void)tl_lookup_p_low(&lookup, p, p, &flags);
    (void)tl_lookup_p_high(&lookup, p, p, &flags);
    (void)tl_lookup_coarse(&lookup, p, &flags);
    (void)tl_lookup_coarse_inverse(&lookup, c, &flags);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 1U || size - 1U > sizeof(blob)) {
        return 0;
    }
    const bool mends = (data[0] & 1U) != 0;
    size--;
    memcpy(blob, data + 1, size);
    if (mends && size >= TL_TABLE_SIZE(0U)) {
        memcpy(blob, "TLTB", 4);
        put(blob + 6, (uint32_t)size, 2);
        put(blob + size - 4U, tl_crc32(0, blob, size - 4U), 4);
    }
    const tl_table_reason_t reason = tl_table_decode(blob, size, TL_TABLE_ANY_AXIS, &table);
    const tl_table_reason_t loaded = tl_lookup_load(&lookup, blob, size, TL_TABLE_ANY_AXIS);
    PROMISE(loaded == reason || reason == TL_TABLE_OK); // what is derived from a sound table may be refused, too
    PROMISE(strlen(tl_table_reason_text(reason)) > 0);
    if (reason != TL_TABLE_OK) {
        return 0;
    }
    PROMISE(tl_table_check_blob(blob, size, TL_TABLE_ANY_AXIS) == TL_TABLE_OK);
    const size_t written = tl_table_encode(&table, again, sizeof(again));
    PROMISE(written > 0 && tl_table_decode(again, written, table.axis, &back) == TL_TABLE_OK);
    PROMISE(tl_table_encode(&back, blob, sizeof(blob)) == written && memcmp(blob, again, written) == 0);
    if (loaded != TL_TABLE_OK) {
        return 0;
    }
    fuzz_from(data, size);
    tl_play_t play;
    tl_play_start(&play, &lookup, table.q_min);
    for (int i = 0; i < 40; i++) {
        const tl_count_q8_t q = between(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
        look_up(q, between(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX));
        look_up(table.q_min + q % (table.q_max - table.q_min), between(-90 * TL_DEG_ONE, 90 * TL_DEG_ONE));
        const tl_count_q8_t p = tl_play_step(&play, q);
        PROMISE(p >= -TL_TABLE_VALUE_MAX && p <= TL_TABLE_VALUE_MAX);
    }
    return 0;
}
