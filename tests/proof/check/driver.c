#include "tautline/tl_table.h"

#include "__fc_builtin.h"

static tl_table_t table;

int main(void) {
    Frama_C_make_unknown((char *)&table, sizeof table);
    return (int)tl_table_check(&table, (uint8_t)Frama_C_interval(0, 255));
}
