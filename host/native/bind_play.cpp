#include "arrays.h"
#include "play.h"

#include <algorithm>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

void bind_play(nb::module_ &m) {
    m.def(
        "turns",
        [](ArrayIn<double> q, double hysteresis) {
            std::vector<int32_t> turns(q.size() + 1);
            turns.resize(play_turns(q.data(), q.size(), hysteresis, turns.data()));
            auto found = new_array<int32_t>(turns.size());
            std::copy(turns.begin(), turns.end(), found.data());
            return found;
        },
        "q"_a, "hysteresis"_a,
        "Indices (int32) of the samples at which q turns; going back by no more than the hysteresis is no turn.");
}
