#include "tautline/tl_wire.h"

#include "__fc_builtin.h"

static tl_wire_message_t message;
static uint8_t payload[65535], frame[TL_WIRE_FRAME_MAX];

int main(void) {
    Frama_C_make_unknown((char *)payload, sizeof payload);
    //@ loop unroll 300;
    for (unsigned type = 0; type < 256; type++) {
        const size_t size = tl_wire_size((uint8_t)type), sent = Frama_C_size_t_interval(0, sizeof payload);
        if (sent >= size) { // exactly as many bytes as the message has
            tl_wire_decode((uint8_t)type, payload + sizeof payload - size, sent, &message);
        } else {
            tl_wire_decode((uint8_t)type, payload + sizeof payload, sent, &message);
        }
        Frama_C_make_unknown((char *)&message, sizeof message);
        tl_wire_frame(frame, (uint8_t)type, (uint16_t)Frama_C_interval(0, 65535), &message);
    }
    return 0;
}
