#include "arrays.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "tautline/tl_onset.h"

namespace nb = nanobind;
using namespace nb::literals;

template <typename T, typename Member> static ArrayOut<T> field(const std::vector<tl_onset_t> &onsets, Member member) {
    auto values = new_array<T>(onsets.size());
    for (size_t i = 0; i < onsets.size(); i++) {
        values.data()[i] = static_cast<T>(onsets[i].*member);
    }
    return values;
}

static nb::dict columns(const std::vector<tl_onset_t> &o) {
    nb::dict d;
    d["turn_us"] = field<uint64_t>(o, &tl_onset_t::turn_us);
    d["start_us"] = field<uint64_t>(o, &tl_onset_t::start_us);
    d["q1"] = field<int32_t>(o, &tl_onset_t::q1);
    d["q2"] = field<int32_t>(o, &tl_onset_t::q2);
    d["width"] = field<int32_t>(o, &tl_onset_t::width);
    d["sigma"] = field<int32_t>(o, &tl_onset_t::sigma);
    d["stop"] = field<int32_t>(o, &tl_onset_t::stop);
    d["sigma_stop"] = field<int32_t>(o, &tl_onset_t::sigma_stop);
    d["speed_stop"] = field<int32_t>(o, &tl_onset_t::speed_stop);
    d["speed_start"] = field<int32_t>(o, &tl_onset_t::speed_start);
    d["slope"] = field<int32_t>(o, &tl_onset_t::slope);
    d["noise"] = field<int32_t>(o, &tl_onset_t::noise);
    d["direction"] = field<int8_t>(o, &tl_onset_t::direction);
    d["reason"] = field<uint8_t>(o, &tl_onset_t::reason);
    d["started"] = field<bool>(o, &tl_onset_t::started);
    d["frames"] = field<uint16_t>(o, &tl_onset_t::frames);
    return d;
}

namespace {
/// One detector with its encoder history, as on one axis of a board.
struct OnsetDetector {
    tl_history_t history;
    tl_onset_detector_t detector;
    uint64_t polled_us = 0;

    explicit OnsetDetector(const tl_onset_config_t &config) {
        tl_history_init(&history);
        if (!tl_onset_init(&detector, &config)) {
            throw std::invalid_argument("OnsetDetector: a field of the configuration is out of its range (tl_onset.h)");
        }
    }

    /// Motor samples and frames in order of time; polls every 100 ms of motor time.
    nb::dict run(ArrayIn<uint64_t> t_us, ArrayIn<int32_t> q, ArrayIn<uint64_t> arrival_us, ArrayIn<int32_t> u,
                 ArrayIn<int32_t> v, ArrayIn<int32_t> sigma, ArrayIn<bool> valid, ArrayIn<bool> other) {
        const size_t frames = arrival_us.size();
        if (t_us.size() != q.size() || u.size() != frames || v.size() != frames || sigma.size() != frames ||
            valid.size() != frames || other.size() != frames) {
            throw std::invalid_argument("OnsetDetector.run: columns of one table differ in length");
        }
        std::vector<tl_onset_t> found;
        tl_onset_t onset;
        size_t frame = 0;
        for (size_t i = 0; i < t_us.size(); i++) {
            tl_history_push(&history, t_us(i), q(i));
            const bool last = i + 1 == t_us.size();
            for (; frame < frames && (last || arrival_us(frame) < t_us(i + 1)); frame++) {
                const tl_marker_t marker = {arrival_us(frame), u(frame),     v(frame),
                                            sigma(frame),      valid(frame), other(frame)};
                if (tl_onset_sample(&detector, &history, &marker, &onset)) {
                    found.push_back(onset);
                }
            }
            if (t_us(i) >= polled_us + 100000) {
                polled_us = t_us(i);
                if (tl_onset_poll(&detector, &history, t_us(i), &onset)) {
                    found.push_back(onset);
                }
            }
        }
        return columns(found);
    }
};

struct History {
    tl_history_t history;
    History() { tl_history_init(&history); }

    void push(ArrayIn<uint64_t> t_us, ArrayIn<int32_t> q) {
        if (t_us.size() != q.size()) {
            throw std::invalid_argument("History.push: t_us and q differ in length");
        }
        for (size_t i = 0; i < t_us.size(); i++) {
            tl_history_push(&history, t_us(i), q(i));
        }
    }

    nb::tuple at(ArrayIn<uint64_t> t_us) const {
        auto q = new_array<int32_t>(t_us.size());
        auto status = new_array<uint8_t>(t_us.size());
        for (size_t i = 0; i < t_us.size(); i++) {
            q.data()[i] = 0;
            status.data()[i] = static_cast<uint8_t>(tl_history_at(&history, t_us(i), &q.data()[i]));
        }
        return nb::make_tuple(q, status);
    }
};
} // namespace

void bind_onset(nb::module_ &m) {
    m.attr("HISTORY_OK") = static_cast<int>(TL_HISTORY_OK);
    m.attr("HISTORY_NOT_YET") = static_cast<int>(TL_HISTORY_NOT_YET);
    m.attr("HISTORY_TOO_OLD") = static_cast<int>(TL_HISTORY_TOO_OLD);
    m.attr("HISTORY_SPAN_MS") = TL_HISTORY_SPAN_MS;
    nb::class_<History>(m, "History", "tl_history.h: encoder history of one axis, positions in Q8 counts.")
        .def(nb::init<>())
        .def("push", &History::push, "t_us"_a, "q"_a, "Pushes q (n,) int32 at t_us (n,) uint64.")
        .def("at", &History::at, "t_us"_a, "(q (n,) int32, status (n,) uint8) at t_us (n,) uint64; q is 0 unless OK.");

    nb::dict reasons;
    reasons["used"] = static_cast<int>(TL_ONSET_USED);
    reasons["not_on_envelope"] = static_cast<int>(TL_ONSET_NOT_ON_ENVELOPE);
    reasons["no_start"] = static_cast<int>(TL_ONSET_NO_START);
    reasons["other_motion"] = static_cast<int>(TL_ONSET_OTHER_MOTION);
    reasons["marker_lost"] = static_cast<int>(TL_ONSET_MARKER_LOST);
    reasons["timed_out"] = static_cast<int>(TL_ONSET_TIMED_OUT);
    reasons["too_few_samples"] = static_cast<int>(TL_ONSET_TOO_FEW_SAMPLES);
    reasons["slope_too_small"] = static_cast<int>(TL_ONSET_SLOPE_TOO_SMALL);
    m.attr("ONSET_REASONS") = reasons;
    m.attr("ONSET_UNKNOWN") = TL_ONSET_UNKNOWN;

    nb::class_<tl_onset_config_t>(m, "OnsetConfig", "tl_onset_config_t, filled in by tl_onset_defaults().")
        .def("__init__", [](tl_onset_config_t *config) { new (config) tl_onset_config_t(tl_onset_defaults()); })
        .def_rw("delay_us", &tl_onset_config_t::delay_us)
        .def_rw("guard_us", &tl_onset_config_t::guard_us)
        .def_rw("lost_us", &tl_onset_config_t::lost_us)
        .def_rw("timeout_us", &tl_onset_config_t::timeout_us)
        .def_rw("turn", &tl_onset_config_t::turn)
        .def_rw("sigma_wanted", &tl_onset_config_t::sigma_wanted)
        .def_rw("sigma_usable", &tl_onset_config_t::sigma_usable)
        .def_rw("noise_px", &tl_onset_config_t::noise_px)
        .def_rw("curvature", &tl_onset_config_t::curvature)
        .def_rw("threshold", &tl_onset_config_t::threshold)
        .def_rw("frames_min", &tl_onset_config_t::frames_min)
        .def_rw("frames_max", &tl_onset_config_t::frames_max);

    nb::class_<OnsetDetector>(m, "OnsetDetector", "tl_onset.h with tl_history.h: one axis as on the board.")
        .def(nb::init<const tl_onset_config_t &>(), "config"_a)
        .def("run", &OnsetDetector::run, "t_us"_a, "q"_a, "arrival_us"_a, "u"_a, "v"_a, "sigma"_a, "valid"_a,
             "other_motion"_a,
             "Motor samples (n,) uint64, int32 Q8 counts; frames (m,) uint64, int32 Q12 px three times, bool "
             "twice. "
             "Returns finished reversals, tl_onset_t as one array for each field. May be called again to go "
             "on.")
        .def_prop_ro("ignored", [](const OnsetDetector &d) { return d.detector.ignored; })
        .def_prop_ro("lost", [](const OnsetDetector &d) { return d.detector.lost; })
        .def_prop_ro("missed", [](const OnsetDetector &d) { return d.detector.missed; })
        .def_prop_ro("noise_px", [](const OnsetDetector &d) {
            return std::sqrt(static_cast<double>(d.detector.noise_sum) / d.detector.noise_dof / 16.0) / 256.0;
        });
}
