/// Set-points of one axis, ahead of their time, joined by straight lines.
///
/// The task adds them; the control step takes the value of each next millisecond. Times are those of what is planned,
/// which is ahead of now. No line is shorter than a millisecond. Under the port's lock, but for tl_stream_next().
#ifndef TAUTLINE_TL_STREAM_H
#define TAUTLINE_TL_STREAM_H

#include "tautline/tl_fixed.h"

#define TL_STREAM_SIZE 32U ///< set-points ahead of time

/// 12 bytes: 128 of them are a good part of a board's memory. Slope: value per tick, 16 more bits; 47 in all.
typedef struct {
    uint32_t ticks : 17;
    uint32_t slope_low : 15;
    int32_t slope_high;
    int32_t end; ///< value at its end
} tl_segment_t;

/// Fields are the module's own, but `used` may be read, and set to 0 to forget what is ahead.
typedef struct {
    uint32_t ticks; ///< of a millisecond
    uint32_t left;  ///< of the first segment
    uint32_t first, used;
    int64_t value;  ///< at `now_us`, 24 more bits
    tl_us_t now_us; ///< the time that is planned for; whoever calls tl_stream_next() keeps it
    tl_us_t end_us; ///< when the last segment ends, and
    int32_t end;    ///< at which value
    tl_segment_t segments[TL_STREAM_SIZE];
} tl_stream_t;

/// Rests at `value`. ticks: of a millisecond.
void tl_stream_start(tl_stream_t *stream, int32_t value, uint32_t ticks);

/// When the next line begins: where the last one ends, but not in the past.
static inline tl_us_t tl_stream_end(const tl_stream_t *stream) {
    return stream->end_us > stream->now_us ? stream->end_us : stream->now_us;
}

/// A straight line from tl_stream_end() to `value` at `at_us`, at most 13 s away; in a millisecond where that is too
/// short. Between its ends within 2 units of it. False: no room. 64-bit division.
bool tl_stream_add(tl_stream_t *stream, int32_t value, tl_us_t at_us);

/// Of a segment in so many ticks, at most a millisecond's: value with 24 more bits. Three 32-bit products.
static inline int64_t tl_segment_way(const tl_segment_t *segment, uint32_t ticks) {
    const int32_t slope = segment->slope_high;
    const int32_t high = (slope >> 16) * (int32_t)ticks;
    const uint32_t middle = ((uint32_t)slope & 0xFFFFU) * ticks, low = segment->slope_low * ticks;
    return (int64_t)((uint64_t)(uint32_t)(high * (1 << 7)) << 32) + (int64_t)(((uint64_t)middle << 23) + (low << 8));
}

/// A millisecond further.
static inline int32_t tl_stream_next(tl_stream_t *stream) {
    uint32_t ticks = stream->ticks, left = stream->left;
    if (stream->used > 0U) {
        const tl_segment_t *segment = &stream->segments[stream->first];
        if (left <= ticks) { // one at most ends here
            const int32_t end = segment->end;
            stream->value = (int64_t)((uint64_t)(int64_t)end << 24);
            stream->first = (stream->first + 1U) % TL_STREAM_SIZE;
            if (--stream->used == 0U) {
                return end;
            }
            ticks -= left;
            segment = &stream->segments[stream->first];
            left = segment->ticks;
        }
        stream->left = left - ticks;
        stream->value += tl_segment_way(segment, ticks);
    }
    return (int32_t)(stream->value >> 24);
}

#endif
