/// Frames on their way to the host: a queue of bytes. The task alone. Whole frames that find no room are dropped and
/// counted; nothing waits.
#ifndef TAUTLINE_TL_OUTBOX_H
#define TAUTLINE_TL_OUTBOX_H

#include "tautline/tl_wire.h"

#ifndef TL_APP_QUEUE
#define TL_APP_QUEUE 4096U ///< bytes
#endif
#if TL_APP_QUEUE < 1024U || TL_APP_QUEUE > 65536U
#error "TL_APP_QUEUE must be 1024 to 65536"
#endif

typedef struct {
    uint32_t head, tail; ///< written, taken
    uint16_t unasked;    ///< sequence of frames that no request asked for
    bool open;           ///< a session: a host has configured the device, or said hello on a serial line
    uint8_t bytes[TL_APP_QUEUE];
} tl_outbox_t;

/// A session begins, or ends: what was not read is dropped.
void tl_outbox_open(tl_outbox_t *outbox, bool open);

/// Queues a frame; false where there is no room, or no session. Who has none is told so: errors pass.
bool tl_outbox_send(tl_outbox_t *outbox, uint8_t type, uint16_t sequence, const void *message);

/// The same for what no request asked for: it has a sequence of its own, in which one that finds no room leaves a gap.
/// Room for one reply is left: a host that was busy for long is answered at once.
bool tl_outbox_tell(tl_outbox_t *outbox, uint8_t type, const void *message);

/// Whether tl_outbox_tell() would find room.
bool tl_outbox_has_room(const tl_outbox_t *outbox, uint8_t type);

/// At most `room` bytes; returns how many.
size_t tl_outbox_take(tl_outbox_t *outbox, uint8_t *out, size_t room);

static inline bool tl_outbox_is_empty(const tl_outbox_t *outbox) {
    return outbox->tail == outbox->head;
}

#endif
