#include "tautline/tl_path.h"

#include "tautline/tl_fast.h"

void tl_path_init(tl_path_t *path, tl_count_q8_t q, uint32_t ticks) {
    path->share = (65536U + ticks / 2U) / ticks;
    tl_path_set(path, q);
}

TL_FAST void tl_path_set(tl_path_t *path, tl_count_q8_t q) { // field by field: the control step has no memset
    path->q = path->base = q;
    path->speed = path->bend = path->offset = path->velocity = 0;
}

// x * share / 2^16, for |x| < 2^30: of a millisecond's change a tick's.
static inline int32_t part(int32_t x, uint32_t share) {
    return (x >> 16) * (int32_t)share + (int32_t)(((uint32_t)x & 0xFFFFU) * share >> 16);
}

TL_FAST void tl_path_begin(tl_path_t *path, const tl_reference_t *reference) {
    // From (r[k-1] + r[k]) / 2 at speed v[k] to (r[k] + r[k+1]) / 2 at v[k+1], where v[k] = r[k] - r[k-1]. Ticks are
    // in the middles of their intervals: this is half of one before the beginning.
    const int32_t before = path->velocity, after = reference->velocity;
    path->velocity = after;
    path->base = reference->q;
    const uint32_t share = path->share;
    const int32_t bend = path->bend = part(part(after - before, share), share);
    const int32_t speed = path->speed = part(before, share);
    path->offset = 0x8000 + (int32_t)reference->fraction - after - (before >> 1) - (speed >> 1) + (bend >> 3);
}
