#include "tautline/tl_serial.h"

static tl_app_t *app;
static const tl_serial_t *line;
static uint8_t unsent[64]; // taken from the app's queue, not yet by the line
static size_t unsent_begin, unsent_end;

void tl_serial_init(tl_app_t *the_app, const tl_serial_t *the_line) {
    app = the_app;
    line = the_line;
    unsent_begin = unsent_end = 0;
    tl_app_line(app);
}

bool tl_serial_task(void) {
    bool moved = false;
    uint8_t bytes[64];
    size_t count;
    while ((count = line->read(line->context, bytes, sizeof(bytes))) > 0U) {
        tl_app_receive(app, bytes, count);
        moved = true;
    }
    for (;;) {
        if (unsent_begin == unsent_end) {
            unsent_begin = 0;
            unsent_end = tl_app_transmit(app, unsent, sizeof(unsent));
        }
        const size_t taken = line->write(line->context, unsent + unsent_begin, unsent_end - unsent_begin);
        unsent_begin += taken;
        if (taken == 0U) {
            return moved;
        }
        moved = true;
    }
}
