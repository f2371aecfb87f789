// A loaded table as a Python object, shared by the bindings that run on one.
#ifndef TAUTLINE_NATIVE_FIXED_TABLE_H
#define TAUTLINE_NATIVE_FIXED_TABLE_H

#include "tautline/tl_lookup.h"

struct FixedTable {
    tl_lookup_t lookup;
};

#endif
