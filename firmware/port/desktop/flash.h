// NOR flash in a file: an erase sets a sector to ones, a program only clears bits. Counts its operations and can lose
// power in the middle of one, leaving half of it done.
#ifndef FLASH_H
#define FLASH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

extern uint8_t flash_bytes[];

bool flash_open(const char *file); // NULL: memory only
// `whole` false: the power goes half-way.
bool flash_do_erase(uint32_t offset, bool whole);
bool flash_do_program(uint32_t offset, const uint8_t *page, bool whole);

#endif
