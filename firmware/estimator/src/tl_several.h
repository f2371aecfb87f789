/// The compensator's part for a table of several plays (tl_elements.h): what tl_compensator.c asks for where
/// k->several.
#ifndef TAUTLINE_TL_SEVERAL_H
#define TAUTLINE_TL_SEVERAL_H

#include "tautline/tl_compensator.h"

/// In tl_compensator_turn(): the side, and the plays that undo the elements follow p, but for what it turns back within
/// the band. At most 480 cycles on a Cortex-M0+.
void tl_several_turn(tl_compensator_t *compensator);

/// In tl_compensator_take_up() where p has moved: where they want q; a jump is taken up. At most 400 cycles.
void tl_several_lead(tl_compensator_t *compensator);

/// k->half as the side and the strength make it of the offset.
void tl_several_hold(tl_compensator_t *compensator);

/// p has changed, the motor's place in the backlash has not.
void tl_several_stand(tl_compensator_t *compensator);

/// The elements begin anew, with the tip at p and the motor at q; or the motor at a place that another table gave.
void tl_several_begin(tl_compensator_t *compensator, tl_count_q8_t p, tl_count_q8_t q);
void tl_several_begin_at(tl_compensator_t *compensator, int32_t place_q15);

/// Where in the backlash the motor is, from -1 to 1, of one play too.
int32_t tl_several_place(const tl_compensator_t *compensator);

#endif
