#include "__fc_builtin.h"

#include "../contracts.h"

/*@ assigns \result \from \nothing; ensures \result == TL_TABLE_OK || \result == TL_TABLE_BAD_CRC; */
tl_table_reason_t tl_table_check_blob(const uint8_t *blob, size_t size, uint8_t axis);
/*@ requires begin <= end; requires \valid_read(begin) || begin == end;
    assigns \result \from \nothing; */
tl_table_reason_t tl_sections_get(const uint8_t *begin, const uint8_t *end, tl_table_t *table);
/*@ assigns \result \from \nothing; */
tl_table_reason_t tl_table_check(const tl_table_t *table, uint8_t axis);

#include "../../../common/src/tl_table.c"

static tl_table_t table;

static void of(unsigned nodes) {
    uint8_t bytes[TL_TABLE_HEADER_SIZE + 8U * TL_TABLE_NODES_MAX + 4U];
    const size_t plain = TL_TABLE_SIZE(nodes <= TL_TABLE_NODES_MAX ? nodes : 0U);
    uint8_t *blob = bytes + sizeof bytes - plain; // exactly as many as a blob without sections has
    Frama_C_make_unknown((char *)blob, plain);
    blob[12] = (uint8_t)nodes;
    blob[13] = (uint8_t)(nodes >> 8);
    tl_table_decode(blob, plain, (uint8_t)Frama_C_interval(0, 255), &table);
}

int main(void) {
    //@ loop unroll 300;
    for (unsigned nodes = 0; nodes <= TL_TABLE_NODES_MAX + 1U; nodes++) {
        of(nodes);
    }
    of(Frama_C_unsigned_int_interval(TL_TABLE_NODES_MAX + 1U, 65535));
    return 0;
}
