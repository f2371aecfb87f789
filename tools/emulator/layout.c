// What a debug probe would look at, for the sim link's `state`: offsets in the image's `board`, read by src/probe.js.
#include <stddef.h>

#include "tautline/tl_app.h"

extern const unsigned layout[];
__attribute__((section(".layout"))) const unsigned layout[] = {
    offsetof(tl_app_t, axes),
    sizeof(tl_axis_t),
    offsetof(tl_axis_t, mode),
    offsetof(tl_axis_t, fault),
    offsetof(tl_axis_t, guard.current_ma),
    offsetof(tl_app_t, counters.bytes_bad),
    offsetof(tl_axis_t, port),
    offsetof(tl_axis_t, q),
    offsetof(tl_axis_t, path.q),
};
