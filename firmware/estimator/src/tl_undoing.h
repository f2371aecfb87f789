/// The compensator's part for a table that has further sections or was moved (tl_undo.h): what tl_compensator.c asks
/// for where k->undoes.
#ifndef TAUTLINE_TL_UNDOING_H
#define TAUTLINE_TL_UNDOING_H

#include "tautline/tl_compensator.h"

/// In tl_compensator_feed(): where p has to go, for the tip to get to where f would have it by what
/// tl_compensator_hear() found.
void tl_undoing_feed(tl_compensator_t *compensator);

/// In tl_compensator_turn(), in place of what one play or several do there.
void tl_undoing_turn(tl_compensator_t *compensator);

#endif
