/// Tables by message, for boards without a DFU interface: the same upload, the same checks. The task alone.
#ifndef TAUTLINE_TL_COMMAND_TABLE_H
#define TAUTLINE_TL_COMMAND_TABLE_H

#include "tautline/tl_tables.h"

/// Answers table_write, table_store or table_read: a tl_wire_reason_t, or 0 with the type of the answer in *answer.
uint8_t tl_command_table(tl_tables_t *tables, uint8_t type, const tl_wire_message_t *request, tl_wire_message_t *out,
                         uint8_t *answer);

#endif
