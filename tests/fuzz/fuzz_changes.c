// A compensator that leads while tables, modes, strength, loads and adaptations change as the input says: its goal
// never jumps, nor leaves the range.
#include "fuzz.h"

#include "../c/ride.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    fuzz_from(data, size);
    ride_start(1 + between(0, 3));
    for (int tick = 0; tick < 500; tick++) {
        const ride_tick_t now = ride_tick();
        PROMISE(now.step <= STEP_MOST);
        PROMISE(now.inside);
    }
    return 0;
}
