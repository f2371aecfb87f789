#include "__fc_builtin.h"

#include "../contracts.h"

#include "../../../common/src/tl_sections.h"

static uint8_t bytes[4U * TL_TABLE_NODES_MAX];
static int32_t values[TL_TABLE_NODES_MAX];

int main(void) {
    Frama_C_make_unknown((char *)bytes, sizeof bytes);
    //@ loop unroll 300;
    for (unsigned nodes = 0; nodes <= TL_TABLE_NODES_MAX; nodes++) { // exactly as many bytes and values
        tl_get_column(bytes + sizeof bytes - 4U * nodes, values + TL_TABLE_NODES_MAX - nodes, nodes);
    }
    return 0;
}
