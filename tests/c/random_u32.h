// Marsaglia's xorshift: the same numbers from the same seed, which is not 0, on every machine.
#ifndef RANDOM_U32_H
#define RANDOM_U32_H

#include <stdint.h>

static uint32_t seed;

static inline uint32_t random_u32(void) {
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed;
}

#endif
