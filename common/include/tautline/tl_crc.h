/// CRC-32 as in IEEE 802.3 (reflected, polynomial 0x04C11DB7), the one that dfu-suffix and zlib use.
#ifndef TAUTLINE_TL_CRC_H
#define TAUTLINE_TL_CRC_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/// The CRC of `size` bytes; chain blocks by passing the previous result as `crc`, start with 0.
/// 64 bytes of table, about 20 cycles a byte on a Cortex-M0+.
uint32_t tl_crc32(uint32_t crc, const void *data, size_t size);

#ifdef __cplusplus
}
#endif

#endif
