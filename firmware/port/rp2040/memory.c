// memset and memcpy in RAM, for a chip whose boot ROM has none: the control path and the onset detector clear and copy
// small things, and the C library's would wait for the flash chip. Words only where both ends are whole words, as the
// USB controller's memory takes no others.
#include <stddef.h>
#include <stdint.h>

#include "pico.h"

typedef uint32_t __attribute__((may_alias)) word_t;

// Else the compiler would make each loop the call that it is.
#define IN_RAM __attribute__((optimize("no-tree-loop-distribute-patterns"))) __not_in_flash("memory")

void *memset(void *to, int value, size_t size);
void *memcpy(void *restrict to, const void *restrict from, size_t size);

IN_RAM void *memset(void *to, int value, size_t size) {
    uint8_t *at = to;
    if (((uintptr_t)to & 3U) == 0) {
        const uint32_t word = (uint8_t)value * 0x01010101U;
        for (; size >= 4U; size -= 4U, at += 4) {
            *(word_t *)at = word;
        }
    }
    for (; size > 0; size--) {
        *at++ = (uint8_t)value;
    }
    return to;
}

IN_RAM void *memcpy(void *restrict to, const void *restrict from, size_t size) {
    uint8_t *at = to;
    const uint8_t *next = from;
    if ((((uintptr_t)to | (uintptr_t)from) & 3U) == 0) {
        for (; size >= 4U; size -= 4U, at += 4, next += 4) {
            *(word_t *)at = *(const word_t *)next;
        }
    }
    for (; size > 0; size--) {
        *at++ = *next++;
    }
    return to;
}
