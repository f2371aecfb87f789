/// The cryptography of updates, over Monocypher: for a port's tl_port_update_t.
#ifndef TAUTLINE_TL_TRUST_H
#define TAUTLINE_TL_TRUST_H

#include "tautline/tl_port.h"

/// Whether a signature (64 bytes) of a message is the key's (32 bytes): EdDSA over Curve25519 with BLAKE2b.
bool tl_trust_is_signed(const uint8_t *key, const uint8_t *signature, const uint8_t *message, size_t size);

/// BLAKE2b-256 of the first `size` bytes of a slot's image.
void tl_trust_hash(const tl_port_t *port, uint8_t slot, uint32_t size, uint8_t *out);

#endif
