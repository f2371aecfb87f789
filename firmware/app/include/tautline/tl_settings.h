/// What belongs to the board, its motors and its instruments, and outlives the power: the settings of all axes, in one
/// slot of the store as tl_wire.h's frames. The task alone, motors off.
#ifndef TAUTLINE_TL_SETTINGS_H
#define TAUTLINE_TL_SETTINGS_H

#include "tautline/tl_axis.h"

/// Puts into force what flash holds: a tl_wire_store_t. Where nothing of it is whole, the port's defaults stay.
uint8_t tl_settings_load(const tl_port_t *port, tl_axis_t *axes);

/// Checks new settings of one axis, stores them with the others' and puts them into force: a tl_wire_reason_t, or 0.
/// `scratch`: TL_TABLE_SIZE_MAX bytes.
uint8_t tl_settings_store(const tl_port_t *port, tl_axis_t *axes, const tl_wire_settings_t *settings, uint8_t *scratch);

#endif
