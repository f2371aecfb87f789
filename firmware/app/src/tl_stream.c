#include "tautline/tl_stream.h"

#include "tautline/tl_fast.h"

#define SHORTEST_US 1000U

TL_FAST void tl_stream_start(tl_stream_t *stream, int32_t value, uint32_t ticks) {
    stream->ticks = ticks;
    stream->used = 0;
    stream->value = (int64_t)value * (1 << 24);
    stream->end = value;
    stream->end_us = 0;
}

TL_FAST bool tl_stream_add(tl_stream_t *stream, int32_t value, tl_us_t at_us) {
    if (stream->used == TL_STREAM_SIZE) {
        return false;
    }
    const tl_us_t start_us = tl_stream_end(stream);
    const uint32_t period_us = SHORTEST_US / stream->ticks;
    const uint32_t way_us = at_us > start_us + SHORTEST_US ? (uint32_t)(at_us - start_us) : SHORTEST_US;
    const uint32_t ticks = (way_us + period_us / 2U) / period_us;
    const int64_t slope = ((int64_t)value - stream->end) * (1 << 16) / (int64_t)ticks;
    stream->segments[(stream->first + stream->used) % TL_STREAM_SIZE] = (tl_segment_t){
        .ticks = ticks & 0x1FFFFU,
        .slope_low = (uint32_t)slope & 0x7FFFU,
        .slope_high = (int32_t)(slope >> 15),
        .end = value,
    };
    if (stream->used++ == 0U) {
        stream->left = ticks;
    }
    stream->end = value;
    stream->end_us = start_us + (tl_us_t)ticks * period_us;
    return true;
}
