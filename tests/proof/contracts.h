/// What a proof takes for granted of functions that another one is about.
#ifndef TAUTLINE_PROOF_CONTRACTS_H
#define TAUTLINE_PROOF_CONTRACTS_H

#include "tautline/tl_table.h"

/*@ requires size == 0 || \valid_read((uint8_t *)data + (0 .. size - 1));
    assigns \result \from crc; */
uint32_t tl_crc32(uint32_t crc, const void *data, size_t size); // proof checksum

/*@ requires nodes == 0 || \valid_read(at + (0 .. 4 * nodes - 1));
    requires nodes == 0 || \valid(values + (0 .. nodes - 1));
    assigns values[0 .. nodes - 1] \from at[0 .. 4 * nodes - 1];
    assigns \result \from at, nodes;
    ensures \result == at + 4 * nodes; */
static inline const uint8_t *tl_get_column(const uint8_t *at, int32_t *values, unsigned nodes); // proof column

#endif
