#include "tautline/tl_outbox.h"

void tl_outbox_open(tl_outbox_t *outbox, bool open) {
    outbox->open = open;
    outbox->tail = outbox->head;
}

#define FOR_REPLIES TL_WIRE_FRAME_MAX // is left by what nobody asked for

static size_t frame_size(uint8_t type) {
    return TL_WIRE_HEADER_SIZE + tl_wire_size(type) + TL_WIRE_CRC_SIZE;
}

static bool has_room(const tl_outbox_t *outbox, size_t left, uint8_t type) {
    const bool may = outbox->open || type == TL_WIRE_ERROR;
    return may && frame_size(type) + left <= TL_APP_QUEUE - (outbox->head - outbox->tail);
}

static bool put(tl_outbox_t *outbox, size_t left, uint8_t type, uint16_t sequence, const void *message) {
    const size_t size = frame_size(type);
    if (!has_room(outbox, left, type)) {
        return false;
    }
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_wire_frame(frame, type, sequence, message);
    for (size_t i = 0; i < size; i++) {
        outbox->bytes[(outbox->head + i) % TL_APP_QUEUE] = frame[i];
    }
    outbox->head += (uint32_t)size;
    return true;
}

bool tl_outbox_send(tl_outbox_t *outbox, uint8_t type, uint16_t sequence, const void *message) {
    return put(outbox, 0, type, sequence, message);
}

bool tl_outbox_tell(tl_outbox_t *outbox, uint8_t type, const void *message) {
    return put(outbox, FOR_REPLIES, type, outbox->unasked++, message);
}

bool tl_outbox_has_room(const tl_outbox_t *outbox, uint8_t type) {
    return has_room(outbox, FOR_REPLIES, type);
}

size_t tl_outbox_take(tl_outbox_t *outbox, uint8_t *out, size_t room) {
    size_t size = 0;
    while (size < room && outbox->tail != outbox->head) {
        out[size++] = outbox->bytes[outbox->tail++ % TL_APP_QUEUE];
    }
    return size;
}
