#include "arrays.h"
#include "still.h"

#include <stdexcept>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Rows = ArrayIn<double, 2>;

nb::object until(Rows z) {
    const size_t n = z.shape(0), seen = z.shape(1);
    if (n == 0) {
        return nb::none();
    }
    std::vector<double> total((n + 1) * seen);
    const size_t first = still_until(z.data(), n, seen, total.data());
    return first < n ? nb::cast(first) : nb::none();
}

nb::object squares(ArrayIn<double> arrival_s, Rows z, ArrayIn<double> motor_s, ArrayIn<double> motor_q, double turn_s,
                   double q1, int direction, int order, ArrayIn<double> delays) {
    if (z.shape(0) != arrival_s.shape(0) || motor_s.shape(0) != motor_q.shape(0) || motor_s.shape(0) == 0 ||
        order < 1 || order > STILL_ORDERS || z.shape(0) == 0 || z.shape(1) > STILL_SEEN) {
        throw std::invalid_argument(
            "a stop has a place of each frame in one or two channels, a motor, and a path of order 1 or 2");
    }
    const still_stop stop = {arrival_s.shape(0), z.shape(1),     motor_s.shape(0), order,  direction, arrival_s.data(),
                             z.data(),           motor_s.data(), motor_q.data(),   turn_s, q1};
    std::vector<double> ramp(stop.frames);
    auto left = new_array<double>(delays.shape(0));
    still_squares(&stop, delays.data(), delays.shape(0), ramp.data(), left.data());
    return nb::cast(left);
}

} // namespace

void bind_still(nb::module_ &m) {
    m.def("still_until", until, "z"_a,
          "The first frame at which z (n, channels) has left its level, or None. See still.h.");
    m.def("still_squares", squares, "arrival_s"_a, "z"_a, "motor_s"_a, "motor_q"_a, "turn_s"_a, "q1"_a, "direction"_a,
          "order"_a, "delays"_a, "(delays) sums of squares that a stop at the motor's turn leaves. See still.h.");
}
