#include "tautline/tl_wire.h"

#include <string.h>

#include "tautline/tl_crc.h"

typedef struct {
    uint8_t width; // bytes of one value
    uint8_t count;
    uint16_t offset; // in the struct
} field_t;

#define FIELD_F(kind, name, doc) {(uint8_t)sizeof(tl_wire_##kind##_t), 1U, (uint16_t)offsetof(type_t, name)},
#define FIELD_A(kind, name, count, doc)                                                                                \
    {(uint8_t)sizeof(tl_wire_##kind##_t), (count), (uint16_t)offsetof(type_t, name)},

// One function per message, so that offsetof can name its struct by one alias.
#define FIELDS(code, NAME, name, doc)                                                                                  \
    static const field_t *fields_##name(uint8_t *count) {                                                              \
        typedef tl_wire_##name##_t type_t;                                                                             \
        static const field_t fields[] = {TL_WIRE_FIELDS_##NAME(FIELD_F, FIELD_A)};                                     \
        *count = (uint8_t)(sizeof(fields) / sizeof(fields[0]));                                                        \
        return fields;                                                                                                 \
    }                                                                                                                  \
    _Static_assert(TL_WIRE_SIZE_##NAME <= TL_WIRE_PAYLOAD_MAX, "a message must fit a frame");
TL_WIRE_MESSAGES(FIELDS)

static const field_t *fields_of(uint8_t type, uint8_t *count) {
    switch (type) {
#define CASE(code, NAME, name, doc)                                                                                    \
    case code:                                                                                                         \
        return fields_##name(count);
        TL_WIRE_MESSAGES(CASE)
    default:
        return NULL;
    }
}

size_t tl_wire_size(uint8_t type) {
    switch (type) {
#define SIZE(code, NAME, name, doc)                                                                                    \
    case code:                                                                                                         \
        return TL_WIRE_SIZE_##NAME;
        TL_WIRE_MESSAGES(SIZE)
    default:
        return 0U;
    }
}

// Native integers to and from little-endian bytes, whatever the machine's own order.
static void put_value(uint8_t *out, const uint8_t *value, uint8_t width) {
    uint64_t bits = 0U;
    switch (width) {
    case 1: {
        bits = *value;
        break;
    }
    case 2: {
        uint16_t v;
        memcpy(&v, value, sizeof(v));
        bits = v;
        break;
    }
    case 4: {
        uint32_t v;
        memcpy(&v, value, sizeof(v));
        bits = v;
        break;
    }
    default:
        memcpy(&bits, value, sizeof(bits));
        break;
    }
    for (uint8_t i = 0; i < width; i++) {
        out[i] = (uint8_t)(bits >> (8U * i));
    }
}

static void get_value(uint8_t *value, const uint8_t *in, uint8_t width) {
    uint64_t bits = 0U;
    for (uint8_t i = 0; i < width; i++) {
        bits |= (uint64_t)in[i] << (8U * i);
    }
    switch (width) {
    case 1:
        *value = (uint8_t)bits;
        break;
    case 2: {
        const uint16_t v = (uint16_t)bits;
        memcpy(value, &v, sizeof(v));
        break;
    }
    case 4: {
        const uint32_t v = (uint32_t)bits;
        memcpy(value, &v, sizeof(v));
        break;
    }
    default:
        memcpy(value, &bits, sizeof(bits));
        break;
    }
}

static uint16_t read_u16(const uint8_t *in) {
    return (uint16_t)(in[0] | ((uint16_t)in[1] << 8));
}

static void write_u16(uint8_t *out, uint16_t value) {
    out[0] = (uint8_t)value;
    out[1] = (uint8_t)(value >> 8);
}

// Byte 3 of the header: a rotating sum of the others, never 0 for a header of zeros.
static uint8_t header_check(const uint8_t *header) {
    uint8_t check = 0x5AU;
    for (size_t i = 0; i < TL_WIRE_HEADER_SIZE; i++) {
        if (i != 3U) {
            check = (uint8_t)((uint8_t)((check << 1) | (check >> 7)) + header[i]);
        }
    }
    return check;
}

size_t tl_wire_frame(uint8_t *out, uint8_t type, uint16_t sequence, const void *message) {
    uint8_t count = 0U;
    const field_t *field = fields_of(type, &count);
    if (field == NULL) {
        return 0U;
    }
    uint8_t *payload = out + TL_WIRE_HEADER_SIZE;
    size_t size = 0U;
    for (uint8_t i = 0; i < count; i++, field++) {
        const uint8_t *value = (const uint8_t *)message + field->offset;
        for (uint8_t k = 0; k < field->count; k++) {
            put_value(payload + size, value, field->width);
            size += field->width;
            value += field->width;
        }
    }
    write_u16(out, TL_WIRE_MAGIC);
    out[2] = type;
    write_u16(out + 4, (uint16_t)size);
    write_u16(out + 6, sequence);
    out[3] = header_check(out);
    const uint32_t crc = tl_crc32(0U, out, TL_WIRE_HEADER_SIZE + size);
    write_u16(payload + size, (uint16_t)crc);
    write_u16(payload + size + 2, (uint16_t)(crc >> 16));
    return TL_WIRE_HEADER_SIZE + size + TL_WIRE_CRC_SIZE;
}

bool tl_wire_decode(uint8_t type, const uint8_t *payload, size_t size, void *message) {
    uint8_t count = 0U;
    const field_t *field = fields_of(type, &count);
    if (field == NULL || size < tl_wire_size(type)) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++, field++) {
        uint8_t *value = (uint8_t *)message + field->offset;
        for (uint8_t k = 0; k < field->count; k++) {
            get_value(value, payload, field->width);
            payload += field->width;
            value += field->width;
        }
    }
    return true;
}

// Whether these bytes can begin a frame, as far as they go.
static bool plausible(const uint8_t *bytes, size_t size) {
    if (size >= 1U && bytes[0] != (uint8_t)(TL_WIRE_MAGIC & 0xFFU)) {
        return false;
    }
    if (size >= 2U && bytes[1] != (uint8_t)(TL_WIRE_MAGIC >> 8)) {
        return false;
    }
    if (size >= TL_WIRE_HEADER_SIZE) {
        return bytes[3] == header_check(bytes) && read_u16(bytes + 4) <= TL_WIRE_PAYLOAD_MAX;
    }
    return true;
}

static void drop(tl_wire_parser_t *parser, size_t count) {
    parser->fill = (uint16_t)(parser->fill - count);
    memmove(parser->buffer, parser->buffer + count, parser->fill);
}

// Drops bytes until the buffer is empty or can begin a frame; `skip` of them without looking.
static void resynchronise(tl_wire_parser_t *parser, size_t skip) {
    size_t start = skip;
    while (start < parser->fill && !plausible(parser->buffer + start, parser->fill - start)) {
        start++;
    }
    parser->bytes_bad += (uint32_t)start;
    drop(parser, start);
}

// Bytes that the buffer must hold for the next decision: the header, then the whole frame.
static size_t wanted(const tl_wire_parser_t *parser) {
    if (parser->fill < TL_WIRE_HEADER_SIZE) {
        return TL_WIRE_HEADER_SIZE;
    }
    return TL_WIRE_HEADER_SIZE + read_u16(parser->buffer + 4) + TL_WIRE_CRC_SIZE;
}

bool tl_wire_parse(tl_wire_parser_t *parser, const uint8_t **data, size_t *size, tl_wire_frame_t *frame) {
    if (parser->consumed != 0U) {
        drop(parser, parser->consumed);
        parser->consumed = 0U;
        resynchronise(parser, 0U);
    }
    for (;;) {
        const size_t want = wanted(parser);
        if (parser->fill < want) {
            const size_t missing = want - parser->fill;
            const size_t take = missing < *size ? missing : *size;
            if (take == 0U) {
                return false;
            }
            memcpy(parser->buffer + parser->fill, *data, take);
            parser->fill = (uint16_t)(parser->fill + take);
            *data += take;
            *size -= take;
            resynchronise(parser, 0U);
            continue;
        }
        const uint8_t *crc = parser->buffer + want - TL_WIRE_CRC_SIZE;
        const uint32_t sent = read_u16(crc) | ((uint32_t)read_u16(crc + 2) << 16);
        if (tl_crc32(0U, parser->buffer, want - TL_WIRE_CRC_SIZE) != sent) {
            resynchronise(parser, 1U);
            continue;
        }
        frame->type = parser->buffer[2];
        frame->sequence = read_u16(parser->buffer + 6);
        frame->size = read_u16(parser->buffer + 4);
        frame->payload = parser->buffer + TL_WIRE_HEADER_SIZE;
        parser->consumed = (uint16_t)want;
        return true;
    }
}

bool tl_wire_skip(tl_wire_parser_t *parser) {
    if (parser->consumed != 0U) {
        drop(parser, parser->consumed);
        parser->consumed = 0U;
        resynchronise(parser, 0U);
    }
    if (parser->fill == 0U) {
        return false;
    }
    resynchronise(parser, 1U);
    return true;
}
