#include "__fc_builtin.h"

#include "../contracts.h"

#include "../../../common/src/tl_sections.c"

static uint8_t bytes[TL_TABLE_PLAYS_SIZE(TL_TABLE_NODES_MAX)];
static tl_table_t table;

int main(void) {
    Frama_C_make_unknown((char *)bytes, sizeof bytes);
    //@ loop unroll 300;
    for (unsigned nodes = 0; nodes <= TL_TABLE_NODES_MAX; nodes++) {
        Frama_C_make_unknown((char *)&table, sizeof table);
        table.nodes = (uint16_t)nodes;
        get_plays(bytes + sizeof bytes - TL_TABLE_PLAYS_SIZE(nodes), &table);
    }
    return 0;
}
