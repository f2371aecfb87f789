#include "arrays.h"

#include <algorithm>
#include <nanobind/stl/vector.h>
#include <stdexcept>
#include <string>

#include "tautline/tl_motion.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {
struct Motion {
    tl_motion_t motion{};

    /// Ticks on, a frame every `frame_ticks` (0: none).
    nb::tuple tick(size_t n, size_t frame_ticks) {
        auto q = new_array<int32_t>(n), velocity = new_array<int32_t>(n);
        for (size_t i = 0; i < n; i++) {
            if (frame_ticks > 0 && i % frame_ticks == 0) {
                tl_motion_frame(&motion);
            }
            const tl_motion_reference_t reference = tl_motion_tick(&motion);
            q.data()[i] = reference.q;
            velocity.data()[i] = reference.velocity;
        }
        return nb::make_tuple(q, velocity);
    }
};
} // namespace

void bind_motion(nb::module_ &m) {
    nb::class_<tl_motion_config_t>(m, "MotionConfig", "tl_motion_config_t: Q8 counts, Q8 counts/s, Q8 counts/s^2.")
        .def("__init__", [](tl_motion_config_t *config) { new (config) tl_motion_config_t{}; })
        .def_rw("low", &tl_motion_config_t::low)
        .def_rw("high", &tl_motion_config_t::high)
        .def_prop_rw(
            "speed", [](const tl_motion_config_t &c) { return std::vector<int32_t>(c.speed, c.speed + c.speed_count); },
            [](tl_motion_config_t &c, const std::vector<int32_t> &speeds) {
                if (speeds.size() > TL_MOTION_SPEEDS) {
                    throw std::invalid_argument("MotionConfig.speed: at most " + std::to_string(TL_MOTION_SPEEDS));
                }
                c.speed_count = static_cast<uint8_t>(speeds.size());
                std::copy(speeds.begin(), speeds.end(), c.speed);
            })
        .def_rw("cycles", &tl_motion_config_t::cycles)
        .def_rw("transit", &tl_motion_config_t::transit)
        .def_rw("acceleration", &tl_motion_config_t::acceleration)
        .def_rw("approach", &tl_motion_config_t::approach)
        .def_rw("stroke_max", &tl_motion_config_t::stroke_max)
        .def_rw("host_timeout_us", &tl_motion_config_t::host_timeout_us)
        .def_rw("rate_hz", &tl_motion_config_t::rate_hz);

    nb::dict errors;
    errors["ok"] = static_cast<int>(TL_MOTION_OK);
    errors["bad_range"] = static_cast<int>(TL_MOTION_BAD_RANGE);
    errors["bad_speed"] = static_cast<int>(TL_MOTION_BAD_SPEED);
    errors["bad_acceleration"] = static_cast<int>(TL_MOTION_BAD_ACCELERATION);
    errors["bad_stroke"] = static_cast<int>(TL_MOTION_BAD_STROKE);
    errors["bad_cycles"] = static_cast<int>(TL_MOTION_BAD_CYCLES);
    errors["bad_rate"] = static_cast<int>(TL_MOTION_BAD_RATE);
    m.attr("MOTION_ERRORS") = errors;
    nb::dict states;
    states["idle"] = static_cast<int>(TL_MOTION_IDLE);
    states["running"] = static_cast<int>(TL_MOTION_RUNNING);
    states["stopping"] = static_cast<int>(TL_MOTION_STOPPING);
    states["complete"] = static_cast<int>(TL_MOTION_COMPLETE);
    states["stopped"] = static_cast<int>(TL_MOTION_STOPPED);
    states["host_lost"] = static_cast<int>(TL_MOTION_HOST_LOST);
    m.attr("MOTION_STATES") = states;

    nb::class_<Motion>(m, "Motion", "tl_motion.h: calibration motion of one axis.")
        .def(nb::init<>())
        .def(
            "start",
            [](Motion &s, const tl_motion_config_t &config, int32_t q) {
                return static_cast<int>(tl_motion_start(&s.motion, &config, q));
            },
            "config"_a, "q"_a, "Begins at rest at q; returns one of MOTION_ERRORS.")
        .def("tick", &Motion::tick, "n"_a, "frame_ticks"_a = 0,
             "n ticks, a frame from the host every frame_ticks: (q, velocity), each (n,) int32.")
        .def("onset", [](Motion &s, int8_t direction) { tl_motion_onset(&s.motion, direction); })
        .def("stop", [](Motion &s) { tl_motion_stop(&s.motion); })
        .def_prop_ro("state", [](const Motion &s) { return static_cast<int>(tl_motion_state(&s.motion)); })
        .def_prop_ro("progress", [](const Motion &s) { return tl_motion_progress(&s.motion); });
}
