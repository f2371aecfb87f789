#include "tautline/tl_wire.h"

#include "__fc_builtin.h"

static tl_wire_parser_t parser;
static uint8_t stream[4096];

int main(void) {
    Frama_C_make_unknown((char *)stream, sizeof stream);
    while (Frama_C_nondet(0, 1)) {
        const uint8_t *data = stream;
        size_t size = Frama_C_size_t_interval(0, sizeof stream);
        tl_wire_frame_t found;
        while (tl_wire_parse(&parser, &data, &size, &found)) {
        }
        if (Frama_C_nondet(0, 1)) {
            tl_wire_skip(&parser);
        }
    }
    return 0;
}
