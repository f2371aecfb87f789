/// What proofs take for granted of an onset's numbers: proof real. Any number may come of any.
#ifndef TAUTLINE_PROOF_REALS_H
#define TAUTLINE_PROOF_REALS_H

#include "tl_real.h"

/*@ requires value > -0x7FFFFFFFFFFFFFFF - 1; assigns \result \from value, e; */
tl_real_t tl_real(int64_t value, int32_t e);
/*@ assigns \result \from a, b; */
tl_real_t tl_real_add(tl_real_t a, tl_real_t b);
/*@ assigns \result \from a, b; */
tl_real_t tl_real_sub(tl_real_t a, tl_real_t b);
/*@ assigns \result \from a, b; */
tl_real_t tl_real_mul(tl_real_t a, tl_real_t b);
/*@ assigns \result \from a; */
tl_real_t tl_real_square(tl_real_t a);
/*@ assigns \result \from a, e; */
tl_real_t tl_real_shift(tl_real_t a, int32_t e);
/*@ assigns \result \from a, b; */
tl_real_t tl_real_div(tl_real_t a, tl_real_t b);
/*@ assigns \result \from a; */
tl_real_t tl_real_sqrt(tl_real_t a);
/*@ assigns \result \from a, b; ensures \result == 0 || \result == 1; */
bool tl_real_less(tl_real_t a, tl_real_t b);
/*@ assigns \result \from a, bits; */
int32_t tl_real_to_q(tl_real_t a, int32_t bits);

#endif
