// What the tests against models draw, of random_u32.h's numbers.
#ifndef DRAWS_H
#define DRAWS_H

#include "random_u32.h"

#include <stdbool.h>
#include <stdint.h>

static inline int32_t between(int32_t low, int32_t high) {
    return low + (int32_t)(random_u32() % ((uint32_t)high - (uint32_t)low + 1U));
}

static inline bool once_in(int32_t n) {
    return between(1, n) == 1;
}

static inline int32_t any(uint32_t bits) { // of each size up to these bits, and either sign
    const int32_t size = (int32_t)(random_u32() >> (32U - (uint32_t)between(1, (int32_t)bits)));
    return once_in(2) ? size : -size;
}

static inline int64_t within(int64_t x, int64_t low, int64_t high) {
    return x < low ? low : (x > high ? high : x);
}

#endif
