#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_version(nb::module_ &m) {
    m.attr("abi") = 1; // raised when a Python caller must be newer than the module
}
