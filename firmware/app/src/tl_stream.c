#include "tautline/tl_stream.h"

#define SHORTEST_US 1000U

void tl_stream_start(tl_stream_t *stream, int32_t value, uint32_t ticks) {
    stream->ticks = ticks;
    stream->used = 0;
    stream->value = (int64_t)value * (1 << 24);
    stream->end = value;
    stream->end_us = 0;
}

bool tl_stream_add(tl_stream_t *stream, int32_t value, tl_us_t at_us) {
    if (stream->used == TL_STREAM_SIZE) {
        return false;
    }
    const tl_us_t start_us = tl_stream_end(stream);
    const uint32_t period_us = SHORTEST_US / stream->ticks;
    const uint32_t way_us = at_us > start_us + SHORTEST_US ? (uint32_t)(at_us - start_us) : SHORTEST_US;
    const uint32_t ticks = (way_us + period_us / 2U) / period_us;
    stream->segments[(stream->first + stream->used) % TL_STREAM_SIZE] = (tl_segment_t){
        .ticks = ticks,
        .end = value,
        .slope = ((int64_t)value - stream->end) * (1 << 24) / (int64_t)ticks,
    };
    if (stream->used++ == 0U) {
        stream->left = ticks;
    }
    stream->end = value;
    stream->end_us = start_us + (tl_us_t)ticks * period_us;
    return true;
}
