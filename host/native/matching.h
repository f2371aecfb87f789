#ifndef TAUTLINE_MATCHING_H
#define TAUTLINE_MATCHING_H

#include "sweep.h"

// What all readings say of the path, given the path: sets the precision and the force of each, and the path's noise and
// what it tells.
void match_all(sweep_t *path);

#endif
