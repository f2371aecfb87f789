// What the harnesses share: an input's bytes as numbers, and how a broken promise ends the run.
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size); // libFuzzer's name for it

#define PROMISE(holds)                                                                                                 \
    do {                                                                                                               \
        if (!(holds)) {                                                                                                \
            (void)fprintf(stderr, "%s:%d: broken: %s\n", __FILE__, __LINE__, #holds);                                  \
            abort();                                                                                                   \
        }                                                                                                              \
    } while (0)

static const uint8_t *fuzz_data;
static size_t fuzz_left;
static uint32_t fuzz_seed; // of what comes after the last byte

static inline void fuzz_from(const uint8_t *data, size_t size) {
    fuzz_data = data;
    fuzz_left = size;
    fuzz_seed = (uint32_t)size;
}

static inline uint32_t fuzz_byte(void) {
    if (fuzz_left > 0) {
        fuzz_left--;
        return *fuzz_data++;
    }
    fuzz_seed = fuzz_seed * 1664525U + 1013904223U;
    return fuzz_seed >> 24;
}

// As many bytes as the span needs: both ends included, high - low below 2^31.
static inline int32_t between(int32_t low, int32_t high) {
    const uint32_t span = (uint32_t)high - (uint32_t)low + 1U;
    uint32_t bits = 0;
    for (uint32_t most = span - 1U; most != 0; most >>= 8) {
        bits = bits << 8 | fuzz_byte();
    }
    return (int32_t)((uint32_t)low + bits % span);
}

#endif
