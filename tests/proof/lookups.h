/// What proofs take for granted of the look-ups: proof lookup, and for how far a result goes tl_table_check (proof
/// check) and derive_end.
#ifndef TAUTLINE_PROOF_LOOKUPS_H
#define TAUTLINE_PROOF_LOOKUPS_H

#include "tautline/tl_lookup.h"

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from p, *lookup; assigns *flags \from *flags, p, *lookup;
    ensures 0 <= \result <= TL_TABLE_WIDTH_MAX; ensures *flags <= 3; */
tl_count_q8_t tl_lookup_width(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags); // between two nodes

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from p, *lookup; assigns *flags \from *flags, p, *lookup;
    ensures -TL_TABLE_VALUE_MAX <= \result <= TL_TABLE_VALUE_MAX; ensures *flags <= 3; */
tl_deg_q16_t tl_lookup_angle(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags);

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from c, *lookup; assigns *flags \from *flags, c, *lookup;
    ensures -TL_TABLE_POSITION_MAX <= \result <= TL_TABLE_POSITION_MAX; ensures *flags <= 3; */
tl_count_q8_t tl_lookup_angle_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags); // on the grid

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from c, *lookup; assigns *flags \from *flags, c, *lookup;
    ensures lookup->table.q_min <= \result <= lookup->table.q_max; ensures *flags <= 3; */
tl_count_q8_t tl_lookup_coarse_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags);

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from q, near, *lookup; assigns *flags \from *flags, q, near, *lookup; ensures *flags <= 3; */
tl_count_q8_t tl_lookup_p_low(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, uint32_t *flags);

/*@ requires \valid_read(lookup) && \valid(flags);
    assigns \result \from q, near, *lookup; assigns *flags \from *flags, q, near, *lookup; ensures *flags <= 3; */
tl_count_q8_t tl_lookup_p_high(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, uint32_t *flags);

/*@ requires \valid_read(lookup); assigns \result \from p, *lookup;
    ensures -0x40000000 <= \result <= 0x40000000; */
int32_t tl_lookup_centre(const tl_lookup_t *lookup, tl_count_q8_t p); // 2^29, and as much beyond the grid

/*@ requires \valid_read(lookup); assigns \result \from y, *lookup;
    ensures -0x40000000 <= \result <= 0x40000000; */
tl_count_q8_t tl_lookup_centre_inverse(const tl_lookup_t *lookup, int32_t y); // 2^29, and as much beyond the grid

#endif
