/// Answers the host's requests. The task alone.
#ifndef TAUTLINE_TL_COMMAND_H
#define TAUTLINE_TL_COMMAND_H

#include "tautline/tl_state.h"

#ifndef TL_APP_BUILD
#define TL_APP_BUILD "release" ///< shown in the identity, at most 31 characters
#endif
#define TL_APP_VERSION {0, 1, 0} ///< the host package's too: pyproject.toml reads it here

/// One request: done or refused, and answered.
void tl_command(tl_app_t *app, const tl_wire_frame_t *frame);

#endif
