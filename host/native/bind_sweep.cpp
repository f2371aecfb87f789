#include "arrays.h"
#include "sweep.h"

#include <stdexcept>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayInOut<double>;

nb::tuple once(size_t order, ArrayIn<double> step, ArrayIn<double> reading, ArrayIn<unsigned char> read, double half,
               double noise, double jump, Values state, Values precision, Values force, Values jumped,
               Values variance) {
    const size_t nodes = reading.shape(0);
    if (order < 2 || order > 3 || nodes < order + 1 || step.shape(0) != nodes - 1 || read.shape(0) != nodes ||
        state.shape(0) != nodes || precision.shape(0) != nodes || force.shape(0) != nodes || jumped.shape(0) != nodes ||
        variance.shape(0) != nodes) {
        throw std::invalid_argument("a path of order 2 or 3 has at least a node more, and a value of each");
    }
    sweep_t path = {nodes,           order, step.data(),  reading.data(),   read.data(),  half,
                    noise,           jump,  state.data(), precision.data(), force.data(), jumped.data(),
                    variance.data(), 0.0};
    int holds = 0;
    {
        nb::gil_scoped_release unlocked;
        std::vector<double> work((nodes + SWEEP_ROW - 1) * SWEEP_WORK);
        holds = sweep(&path, work.data());
    }
    return nb::make_tuple(holds != 0, path.noise, path.told);
}

} // namespace

void bind_sweep(nb::module_ &m) {
    m.def("sweep", once, "order"_a, "step"_a, "reading"_a, "read"_a, "half"_a, "noise"_a, "jump"_a,
          "state"_a.noconvert(), "precision"_a.noconvert(), "force"_a.noconvert(), "jumped"_a.noconvert(),
          "variance"_a.noconvert(),
          "(holds, noise, told) of one sweep; the arrays behind `jump` are changed in place. See sweep.h.");
}
