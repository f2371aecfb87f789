#include "__fc_builtin.h"

#include "../contracts.h"

#include "../../../common/src/tl_sections.c"

#define MOST 65535 // as much as a blob whose size has 16 bits

/*@ requires \valid_read(at + (0 .. 63 + 4 * table->nodes));
    assigns *table \from at[0 .. 63]; assigns \result \from at[0 .. 63]; */
static tl_table_reason_t get_plays(const uint8_t *at, tl_table_t *table);

static uint8_t bytes[MOST];
static tl_table_t table;

int main(void) {
    Frama_C_make_unknown((char *)bytes, sizeof bytes);
    const unsigned size = Frama_C_unsigned_int_interval(0, MOST);
    //@ loop unroll 300;
    for (unsigned nodes = 0; nodes <= TL_TABLE_NODES_MAX; nodes++) {
        Frama_C_make_unknown((char *)&table, sizeof table);
        table.nodes = (uint16_t)nodes;
        tl_sections_get(bytes + MOST - size, bytes + MOST, &table);
    }
    return 0;
}
