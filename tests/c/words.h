// What flash holds, read and written as its layout is documented: little-endian words, and a CRC-32 bit by bit.
#ifndef WORDS_H
#define WORDS_H

#include <stddef.h>
#include <stdint.h>

static inline uint32_t crc_of(const uint8_t *bytes, size_t size) {
    uint32_t crc = 0xFFFFFFFFU;
    for (size_t bit = 0; bit < 8U * size; bit++) {
        crc = crc >> 1 ^ (((uint32_t)(bytes[bit / 8U] >> bit % 8U) ^ crc) & 1U ? 0xEDB88320U : 0U);
    }
    return ~crc;
}

static inline uint32_t word(const uint8_t *bytes, unsigned number) {
    uint32_t value = 0;
    for (unsigned i = 4U; i > 0U; i--) {
        value = value << 8 | bytes[4U * number + i - 1U];
    }
    return value;
}

static inline void set_word(uint8_t *bytes, unsigned number, uint32_t value) {
    for (unsigned i = 0; i < 4U; i++) {
        bytes[4U * number + i] = (uint8_t)(value >> 8U * i);
    }
}

#endif
