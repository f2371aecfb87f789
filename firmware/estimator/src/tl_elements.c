#include "tl_elements.h"

#include "tautline/tl_fast.h"

#define ONE_Q16   ((uint64_t)1 << 16)
#define MOVED_MAX ((int32_t)1 << 28) // further than from one end of the widest play to the other

// lag * factor / 2^16, rounded down.
static TL_FAST inline int32_t share(int32_t lag, uint32_t factor) {
    return (lag >> 16) * (int32_t)factor + (int32_t)(((uint32_t)lag & 0xFFFFU) * factor >> 16);
}

// |lag| rises to |apart| in pieces: a play that has reached its end leaves the rest to the others.
void tl_elements_start(const tl_lookup_t *lookup, int32_t apart, int32_t lag[]) {
    const uint32_t plays = lookup->plays;
    uint64_t left_q16 = (uint64_t)(uint32_t)tl_abs_sat(tl_clamp(apart, -lookup->half, lookup->half)) << 16;
    uint64_t rest_q16 = ONE_Q16;
    uint32_t common = 0;
    for (uint32_t i = 0; i < plays; i++) {
        const tl_element_t *element = &lookup->element[i];
        const uint64_t piece = rest_q16 * ((uint32_t)element->half - common);
        if (left_q16 <= piece) {
            common += (uint32_t)(left_q16 / rest_q16);
            break;
        }
        left_q16 -= piece;
        common = (uint32_t)element->half;
        rest_q16 -= element->weight_q16;
    }
    for (uint32_t i = 0; i < plays; i++) {
        const int32_t half = lookup->element[i].half;
        const int32_t size = (int32_t)common < half ? (int32_t)common : half;
        lag[i] = apart < 0 ? -size : size;
    }
}

TL_FAST int32_t tl_elements_behind(const tl_lookup_t *lookup, int32_t moved, int32_t lag[]) {
    const tl_element_t *element = lookup->element, *end = element + lookup->plays;
    int32_t sum = 0;
    moved = tl_clamp(moved, -MOVED_MAX, MOVED_MAX);
    for (; element < end; element++, lag++) {
        const int32_t now = tl_clamp(*lag + moved, -element->half, element->half);
        *lag = now;
        sum += share(now, element->weight_q16);
    }
    return sum;
}

// The j-th lags by sum_{i<j} w_i (lag_j - lag_i): what y would lose if the plays below it were where it is.
void tl_elements_undo(const tl_lookup_t *lookup, const int32_t lag[], int32_t undo[]) {
    int32_t before[TL_TABLE_PLAYS_MAX];
    for (uint32_t j = 0; j < lookup->plays; j++) {
        int32_t sum = 0;
        before[j] = lag[j];
        for (uint32_t i = 0; i < j; i++) {
            sum += share(before[j] - before[i], lookup->element[i].weight_q16);
        }
        undo[j] = sum;
    }
}

TL_FAST int32_t tl_elements_ahead(const tl_lookup_t *lookup, int32_t moved, int32_t undo[]) {
    const tl_element_t *element = lookup->element, *end = element + lookup->plays;
    int32_t sum = 0;
    moved = tl_clamp(moved, -MOVED_MAX, MOVED_MAX);
    while (++element < end) { // the first lags by nothing
        const int32_t now = tl_clamp(*++undo + moved, -element->lag_most, element->lag_most);
        *undo = now;
        sum += (int32_t)((uint32_t)share(now, element->undo) << element->undo_log2);
    }
    return sum;
}
