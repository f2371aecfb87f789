// Must not compile: two codes of one list are the same. CMakeLists.txt sees that it does not.
#include "tautline/tl_wire.h"

#define TL_WIRE_TWICE(C)                                                                                               \
    C(1, ONE, "one")                                                                                                   \
    C(DUPLICATE, OTHER, "another")
TL_WIRE_IS_(TWICE, twice)
