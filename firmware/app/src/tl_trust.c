#include "tautline/tl_trust.h"

#include <monocypher.h>

#include "tautline/tl_boot.h"

#define HASH_SIZE 32U
#define PIECE     128U // a block of BLAKE2b

bool tl_trust_is_signed(const uint8_t *key, const uint8_t *signature, const uint8_t *message, size_t size) {
    return crypto_eddsa_check(signature, key, message, size) == 0;
}

void tl_trust_hash(const tl_port_t *port, uint8_t slot, uint32_t size, uint8_t *out) {
    crypto_blake2b_ctx context;
    uint8_t piece[PIECE];
    crypto_blake2b_init(&context, HASH_SIZE);
    for (uint32_t at = 0; at < size; at += PIECE) {
        const uint32_t count = size - at < PIECE ? size - at : PIECE;
        port->update->read(port->context, slot, TL_BOOT_IMAGE + at, piece, count);
        crypto_blake2b_update(&context, piece, count);
    }
    crypto_blake2b_final(&context, out);
}
