#include "arrays.h"
#include "sweep.h"

#include <memory>
#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayInOut<double>;

nb::tuple once(ArrayIn<double, 2> change, ArrayIn<double> reading, ArrayIn<unsigned char> read, double half,
               double noise, double jump, Values state, Values precision, Values force, Values jumped,
               Values variance) {
    const size_t nodes = reading.shape(0), order = change.shape(1) - 1;
    if (order < 2 || order > SWEEP_ORDER || change.shape(0) + order != nodes || jumped.shape(0) + order != nodes ||
        nodes < order + 1 || read.shape(0) != nodes || state.shape(0) != nodes || precision.shape(0) != nodes ||
        force.shape(0) != nodes || variance.shape(0) != nodes) {
        throw std::invalid_argument("a path of order 2 or 3 has at least a node more, and a value of each");
    }
    sweep_t path = {nodes,           order, change.data(), reading.data(),   read.data(),  half,
                    noise,           jump,  state.data(),  precision.data(), force.data(), jumped.data(),
                    variance.data(), 0.0};
    int holds = 0;
    {
        nb::gil_scoped_release unlocked;
        const std::unique_ptr<double[]> work(new double[(nodes + SWEEP_ORDER) * SWEEP_WORK]);
        holds = sweep(&path, work.get());
    }
    return nb::make_tuple(holds != 0, path.noise, path.told);
}

} // namespace

void bind_sweep(nb::module_ &m) {
    m.def("sweep", once, "change"_a, "reading"_a, "read"_a, "half"_a, "noise"_a, "jump"_a, "state"_a.noconvert(),
          "precision"_a.noconvert(), "force"_a.noconvert(), "jumped"_a.noconvert(), "variance"_a.noconvert(),
          "(holds, noise, told) of one sweep; the arrays behind `jump` are changed in place. See sweep.h.");
}
