#include "tl_several.h"

#include "tl_elements.h"
#include "tl_feed.h"

#include "tautline/tl_fast.h"

// Where the elements want q, from p on, pushed from above or below: on the envelope of that side.
static TL_FAST int32_t offset_on(const tl_compensator_t *k, bool up) {
    const tl_lookup_t *lookup = k->lookup;
    uint32_t ends = 0;
    if (tl_elements_narrow(lookup, k->p)) {
        const int32_t half = tl_lookup_width(lookup, k->p, &ends) / 2;
        return up ? half : -half;
    }
    const tl_count_q8_t edge =
        tl_lookup_centre_inverse(lookup, k->centre + k->apart - (up ? lookup->half : -lookup->half));
    const int32_t width = tl_lookup_width(lookup, edge, &ends);
    const int32_t half = (width > lookup->narrow ? width : lookup->narrow) / 2;
    return edge - k->p + (up ? half : -half);
}

// The offset as far as it is compensated.
static TL_FAST int32_t held(const tl_compensator_t *k) {
    const int32_t offset = k->offset;
    if (k->mode == TL_MODE_OFF) {
        return 0;
    }
    const int32_t half = offset < 0 ? -half_of(k, 2U * (uint32_t)-offset) : half_of(k, 2U * (uint32_t)offset);
    return k->undoes ? tl_undo_scaled(&k->undo, half) : half;
}

TL_FAST void tl_several_hold(tl_compensator_t *k) {
    const int32_t offset = held(k);
    if (k->side == 0) {
        k->start_offset = offset;
        k->half = tl_abs_sat(offset);
    } else {
        k->half = (k->side > 0 ? offset : -offset) + k->wider;
    }
}

TL_FAST void tl_several_turn(tl_compensator_t *k) {
    const bool turns = turned(k);
    k->turns = turns;
    if (turns) {
        const int32_t side = k->p > k->anchor ? 1 : -1;
        k->half = k->side == 0 ? (side > 0 ? k->start_offset : -k->start_offset) : -k->half; // the same offset
        k->side = side;
        k->anchor = k->p;
    } else if (k->side == 0 || k->p != k->anchor) {
        return;
    }
    const int32_t y = tl_lookup_centre(k->lookup, k->p), first = k->lookup->element[0].half;
    k->apart = tl_elements_ahead(k->lookup, y - k->centre, k->lags) + (k->side > 0 ? first : -first);
    k->centre = y;
    k->moved = true;
}

TL_FAST void tl_several_lead(tl_compensator_t *k) {
    const bool up = k->side > 0; // it has a side: p has moved
    const tl_count_q8_t before = tl_clamp(k->p + (up ? k->half : -k->half), k->low, k->high);
    k->moved = false;
    k->offset = offset_on(k, up);
    const int32_t offset = held(k);
    k->half = (up ? offset : -offset) + k->wider;
    const tl_count_q8_t after = tl_clamp(k->p + (up ? k->half : -k->half), k->low, k->high);
    const int32_t jump = after - before;
    if (k->turns || jump > k->step_max || jump < -k->step_max) {
        absorb(k, after, before);
    }
}

void tl_several_stand(tl_compensator_t *k) {
    k->centre = tl_lookup_centre(k->lookup, k->p);
    if (k->side != 0) {
        k->offset = offset_on(k, k->side > 0);
    } else if (tl_elements_narrow(k->lookup, k->p)) { // as near to where the motor was as the width allows
        const int32_t half = offset_on(k, true);
        k->offset = tl_clamp(k->offset, -half, half);
    } else {
        k->offset = offset_on(k, k->apart >= 0);
    }
}

static void begin(tl_compensator_t *k, int32_t apart) {
    k->apart = tl_clamp(apart, -k->lookup->half, k->lookup->half);
    tl_elements_start(k->lookup, k->apart, k->lags);
    tl_elements_undo(k->lookup, k->lags, k->lags);
}

void tl_several_begin(tl_compensator_t *k, tl_count_q8_t p, tl_count_q8_t q) {
    const tl_lookup_t *lookup = k->lookup;
    uint32_t ends = 0;
    const bool up = q >= p;
    const tl_count_q8_t edge = up ? tl_lookup_p_low(lookup, q, p, &ends) : tl_lookup_p_high(lookup, q, p, &ends);
    begin(k, tl_sub_sat(tl_elements_motor(lookup, up ? 1 : -1, edge), tl_lookup_centre(lookup, p)));
}

void tl_several_begin_at(tl_compensator_t *k, int32_t place_q15) {
    begin(k, (int32_t)((int64_t)place_q15 * k->lookup->half / TL_RATIO_ONE));
}

int32_t tl_several_place(const tl_compensator_t *k) {
    if (k->several) {
        return (int32_t)((int64_t)k->apart * TL_RATIO_ONE / k->lookup->half);
    }
    uint32_t ends = 0;
    const int32_t half = tl_lookup_width(k->lookup, k->p, &ends) / 2;
    if (k->side != 0 || half == 0) {
        return k->side * TL_RATIO_ONE;
    }
    return (int32_t)((int64_t)tl_clamp(k->start_offset, -half, half) * TL_RATIO_ONE / half);
}
