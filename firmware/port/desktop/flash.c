#include "flash.h"

#include <stdio.h>
#include <string.h>

#include "loader.h"
#include "tautline/tl_boot.h"

#define SIZE (TL_PORT_FLASH_REGION + TL_PORT_FLASH_LOG + TL_BOOT_SLOTS * LOADER_ROOM)

uint8_t flash_bytes[SIZE];
static FILE *file;

static bool write_through(uint32_t offset, uint32_t size) {
    if (file == NULL) {
        return true;
    }
    return fseek(file, (long)offset, SEEK_SET) == 0 && fwrite(flash_bytes + offset, 1, size, file) == size &&
           fflush(file) == 0;
}

bool flash_open(const char *name) {
    memset(flash_bytes, 0xFF, SIZE);
    if (name == NULL) {
        return true;
    }
    file = fopen(name, "r+b");
    if (file == NULL) {
        file = fopen(name, "w+b");
        return file != NULL && write_through(0, SIZE);
    }
    const size_t got = fread(flash_bytes, 1, SIZE, file); // a shorter file: the rest is blank
    return !ferror(file) && (got == SIZE || write_through(0, SIZE));
}

bool flash_do_erase(uint32_t offset, bool whole) {
    const uint32_t size = TL_PORT_FLASH_SECTOR;
    if (offset % size != 0 || offset >= SIZE) {
        return false;
    }
    memset(flash_bytes + offset, 0xFF, whole ? size : size / 2U);
    return write_through(offset, size);
}

bool flash_do_program(uint32_t offset, const uint8_t *page, bool whole) {
    const uint32_t size = TL_PORT_FLASH_PAGE;
    if (offset % size != 0 || offset >= SIZE) {
        return false;
    }
    for (uint32_t i = 0; i < (whole ? size : size / 2U); i++) {
        flash_bytes[offset + i] &= page[i];
    }
    return write_through(offset, size);
}
