/// Set-points of one axis, ahead of their time, joined by straight lines.
///
/// The task adds them; the control step takes the value of each next millisecond. Times are those of what is planned,
/// which is ahead of now. No line is shorter than a millisecond. Under the port's lock, but for tl_stream_next().
#ifndef TAUTLINE_TL_STREAM_H
#define TAUTLINE_TL_STREAM_H

#include "tautline/tl_fixed.h"

#define TL_STREAM_SIZE 32U ///< set-points ahead of time

typedef struct {
    uint32_t ticks;
    int32_t end;   ///< value at its end
    int64_t slope; ///< value per tick, 24 more bits
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

/// A straight line from tl_stream_end() to `value` at `at_us`; in a millisecond where that is too short. False: no
/// room. 64-bit division.
bool tl_stream_add(tl_stream_t *stream, int32_t value, tl_us_t at_us);

/// A millisecond further.
static inline int32_t tl_stream_next(tl_stream_t *stream) {
    uint32_t ticks = stream->ticks;
    int64_t value = stream->value;
    if (stream->used > 0U && stream->left <= ticks) { // one at most ends here
        ticks -= stream->left;
        const tl_segment_t *done = &stream->segments[stream->first];
        value = (int64_t)((uint64_t)(int64_t)done->end << 24);
        stream->first = (stream->first + 1U) % TL_STREAM_SIZE;
        stream->left = stream->segments[stream->first].ticks;
        stream->used--;
    }
    if (stream->used > 0U) {
        stream->left -= ticks;
        value += tl_times(stream->segments[stream->first].slope, ticks);
    }
    stream->value = value;
    return (int32_t)(value >> 24);
}

#endif
