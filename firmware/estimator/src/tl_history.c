#include "tautline/tl_history.h"

#include "tautline/tl_fast.h"

#include <stdatomic.h>
#include <string.h>

#define RING_MASK (TL_HISTORY_SIZE - 1U)
#define KEPT_MAX  (TL_HISTORY_SPAN_MS + 2U)

_Static_assert((TL_HISTORY_SIZE & RING_MASK) == 0 && KEPT_MAX < TL_HISTORY_SIZE, "ring size");

/// a + (b - a) numerator / denominator, rounded half away from a; 0 <= numerator <= denominator < 2^15.
static TL_FAST int32_t interpolate(int32_t a, int32_t b, uint32_t numerator, uint32_t denominator) {
    const bool falling = b < a;
    const uint32_t difference = falling ? (uint32_t)a - (uint32_t)b : (uint32_t)b - (uint32_t)a;
    // The product is split so that one 32-bit division is enough: quotient and remainder of the difference.
    const uint32_t quotient = difference / denominator;
    const uint32_t remainder = difference % denominator;
    const uint32_t part = quotient * numerator + (remainder * numerator + denominator / 2) / denominator;
    return (int32_t)(falling ? (uint32_t)a - part : (uint32_t)a + part);
}

static TL_FAST void write_entry(tl_history_t *h, tl_us_t t_us, tl_count_q8_t q) {
    h->q[h->count & RING_MASK] = q;
    h->grid_us = t_us;
    if (h->kept < KEPT_MAX) {
        h->kept++;
    }
    h->count = h->count + 1U;
}

void tl_history_init(tl_history_t *history) {
    memset(history, 0, sizeof *history);
}

TL_FAST void tl_history_push(tl_history_t *history, tl_us_t t_us, tl_count_q8_t q) {
    if (history->kept == 0) {
        write_entry(history, t_us, q);
    } else if (t_us <= history->pushed_us) {
        return;
    } else if (t_us - history->pushed_us > TL_HISTORY_GAP_MS * 1000U) {
        history->kept = 0;
        write_entry(history, t_us, q);
    } else {
        const uint32_t span_us = (uint32_t)(t_us - history->pushed_us);
        while (t_us - history->grid_us >= TL_HISTORY_STEP_US) {
            const tl_us_t at = history->grid_us + TL_HISTORY_STEP_US;
            const uint32_t left_us = (uint32_t)(t_us - at);
            write_entry(history, at, left_us == 0 ? q : interpolate(q, history->pushed_q, left_us, span_us));
        }
    }
    history->pushed_us = t_us;
    history->pushed_q = q;
}

TL_FAST tl_history_status_t tl_history_at(const tl_history_t *history, tl_us_t t_us, tl_count_q8_t *q) {
    uint32_t count;
    uint32_t kept;
    tl_us_t grid_us;
    do { // again only if the writer interrupted these three reads
        count = history->count;
        atomic_signal_fence(memory_order_seq_cst);
        grid_us = history->grid_us;
        kept = history->kept;
        atomic_signal_fence(memory_order_seq_cst);
    } while (count != history->count);

    if (kept == 0 || t_us > grid_us) {
        return TL_HISTORY_NOT_YET;
    }
    if (grid_us - t_us > (tl_us_t)(kept - 1U) * TL_HISTORY_STEP_US) {
        return TL_HISTORY_TOO_OLD;
    }
    const uint32_t age_us = (uint32_t)(grid_us - t_us);
    const uint32_t steps = age_us / TL_HISTORY_STEP_US;
    const uint32_t rest_us = age_us % TL_HISTORY_STEP_US;
    const int32_t newer = history->q[(count - 1U - steps) & RING_MASK];
    *q = rest_us == 0 ? newer
                      : interpolate(newer, history->q[(count - 2U - steps) & RING_MASK], rest_us, TL_HISTORY_STEP_US);
    return TL_HISTORY_OK;
}
