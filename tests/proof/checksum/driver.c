#include "tautline/tl_crc.h"

#include "__fc_builtin.h"

static uint8_t bytes[4096];

int main(void) {
    Frama_C_make_unknown((char *)bytes, sizeof bytes);
    const size_t size = Frama_C_size_t_interval(0, sizeof bytes);
    return (int)tl_crc32(Frama_C_unsigned_int_interval(0, UINT32_MAX), bytes, size);
}
