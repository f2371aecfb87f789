#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "track.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Values = ArrayIn<double>;
using Rows = ArrayIn<double, 2>;

struct TrackModel {
    std::vector<double> grid, width, share, weight, basis, shape;
    size_t bases, shapes;

    TrackModel(Values grid_, Values width_, Values share_, Values weight_, Rows basis_, Rows shape_)
        : grid(copied(grid_)), width(copied(width_)), share(copied(share_)), weight(copied(weight_)),
          basis(basis_.data(), basis_.data() + basis_.size()), shape(shape_.data(), shape_.data() + shape_.size()),
          bases(basis_.shape(0)), shapes(shape_.shape(0)) {
        const struct play_table table = {grid.data(), width.data(), grid.size()};
        if (grid.size() != width.size() || !play_table_valid(&table)) {
            throw std::invalid_argument("track: not a backlash table (grid rising, width >= 0, |width'| < 2)");
        }
        if (share.empty() || share.size() > TRACK_ELEMENTS || share.size() != weight.size()) {
            throw std::invalid_argument("track: 1 to 12 shares and as many weights");
        }
        if (1 + bases + shapes > TRACK_PARAMETERS || (bases && basis_.shape(1) != grid.size()) ||
            (shapes && shape_.shape(1) != share.size())) {
            throw std::invalid_argument("track: too many parameters, or tables of another length");
        }
    }
    struct track_model view() const {
        return {{grid.data(), width.data(), grid.size()},
                share.data(),
                weight.data(),
                share.size(),
                basis.data(),
                bases,
                shape.data(),
                shapes};
    }
};

} // namespace

void bind_track(nb::module_ &m) {
    nb::class_<track_state>(m, "TrackState", "Where the play elements are.")
        .def(
            "__init__",
            [](track_state *self, double p) {
                new (self) track_state;
                track_start(self, TRACK_ELEMENTS, p);
            },
            "p"_a, "All elements at p, pushed by nobody.")
        .def("copy", [](const track_state &self) { return track_state(self); })
        .def("restart", [](track_state &self, double p) { track_start(&self, TRACK_ELEMENTS, p); })
        .def_ro("p", &track_state::p)
        .def_ro("lean", &track_state::lean)
        .def_ro("driven", &track_state::driven);
    nb::class_<TrackModel>(m, "TrackModel", "Play elements on a backlash table, with what may change. See track.h.")
        .def(nb::init<Values, Values, Values, Values, Rows, Rows>(), "grid"_a, "width"_a, "share"_a, "weight"_a,
             "basis"_a, "shape"_a)
        .def(
            "run",
            [](const TrackModel &self, track_state &state, Values q, bool slopes) -> nb::object {
                const size_t n = q.size(), columns = 1 + self.bases + self.shapes;
                auto p = new_array<double>(n), moving = new_array<double>(n);
                auto by = new_array<double>(slopes ? n : 0, columns);
                const struct track_model view = self.view();
                {
                    nb::gil_scoped_release unlocked;
                    track_run(&view, &state, q.data(), n, p.data(), moving.data(), slopes ? by.data() : nullptr);
                }
                if (!slopes) {
                    return nb::make_tuple(p, moving);
                }
                return nb::make_tuple(p, moving, by);
            },
            "state"_a, "q"_a, "slopes"_a = false,
            "Moves the motor along q: (p (n,), moving (n,)), with slopes also dp/dtheta (n, parameters). The state "
            "goes along.");
}
