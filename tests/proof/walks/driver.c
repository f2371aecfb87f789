#include "__fc_builtin.h"

#include "../detectors.h"
#include "../reals.h"
#include "tl_hinge.h"

// Sums of at most 64 samples beyond a knot, each within 2^18 of it: what a walk's steps and refinements keep.
/*@ predicate beyond(tl_onset_sums_t *s) = 0 <= s->w <= 0x1000 && 0 <= s->n <= 64 && 0 <= s->xx <= 0x1000000000000
      && -0x40000000 <= s->x <= 0x40000000 && -0x40000000 <= s->u <= 0x40000000 && -0x40000000 <= s->v <= 0x40000000
      && -0x1000000000000 <= s->xu <= 0x1000000000000 && -0x1000000000000 <= s->xv <= 0x1000000000000
      && 0 <= s->yy <= 0x2000000000000; */

/*@ requires \valid(sums) && \valid_read(point); assigns *sums \from *sums, *point; ensures beyond(sums);
    ensures sums->n == \old(sums->n) + 1; */
void tl_hinge_add(tl_onset_sums_t *sums, const tl_hinge_point_t *point); // this and what follows: proof hinge

/*@ requires \valid(sums) && -0x40000 <= delta <= 0x40000; assigns sums->x, sums->xx, sums->xu, sums->xv \from *sums,
   delta; ensures beyond(sums); */
static void shift(tl_onset_sums_t *sums, int64_t delta);

/*@ requires \valid_read(d); requires 0 <= scale <= 15; assigns \result \from *d, i, origin, scale;
    ensures -0x1FFFF <= \result.x <= 0x1FFFF && 1 <= \result.w <= 64; */
tl_hinge_point_t tl_hinge_point(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin, int32_t scale);

/*@ requires \valid_read(d) && 0 <= i <= TL_ONSET_WINDOW; assigns \result \from *d, i, origin;
    ensures 0 <= \result <= 15; */
int32_t tl_hinge_scale(const tl_onset_detector_t *d, int32_t i, tl_count_q8_t origin);

#include "../../../firmware/estimator/src/tl_hinge.c"

// One step, from each place that a walk may have come to.
static void step(void) {
    walk_t walk;
    d.held = TL_ONSET_WINDOW;
    //@ loop unroll 70;
    for (int32_t k = 0; k < TL_ONSET_WINDOW; k++) {
        const int32_t first = Frama_C_int_interval(0, k);
        walk = (walk_t){.origin = ANY(), .scale = Frama_C_int_interval(0, 15), .first = first, .k = k};
        walk.here = tl_hinge_point(&d, k, walk.origin, walk.scale);
        walk.beyond.n = TL_ONSET_WINDOW - 1 - k;
        if (walk_on(&d, &walk)) {
            //@ assert walk.first <= walk.k < k;
        }
    }
}

// All that walks, in a window of so many.
static void walks(unsigned held) {
    tl_hinge_t fit;
    tl_hinge_break_t jump;
    d.held = (uint8_t)held;
    tl_hinge_glance(&d);
    if (tl_hinge_fit(&d, &fit)) {
        tl_hinge_spread(&d, &fit, NUMBER());
    }
    if (tl_hinge_break(&d, &jump)) {
        //@ assert 1 <= jump.beyond < held;
    }
    tl_hinge_blind(&d, NUMBER(), NUMBER());
}

int main(void) {
    any_detector();
    step();
    //@ loop unroll 20;
    for (unsigned held = 1; held <= 6U; held++) {
        walks(held);
    }
    return 0;
}
