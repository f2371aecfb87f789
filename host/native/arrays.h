// Whole numpy arrays in and out: how every binding passes its batches.
#ifndef TAUTLINE_NATIVE_ARRAYS_H
#define TAUTLINE_NATIVE_ARRAYS_H

#include <cstddef>
#include <exception>
#include <limits>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <string>
#include <type_traits>
#include <vector>

// Read from: an array of another type is converted, but never at a value's cost. Where T is an integer or bool, numpy
// would cut off what is behind the point and wrap what is out of range; here that is no such array: TypeError.
template <typename T, std::size_t N = 1>
struct ArrayIn : nanobind::ndarray<const T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu> {
    using Base = nanobind::ndarray<const T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu>;
    using Base::Base;
    ArrayIn() = default;
    explicit ArrayIn(const Base &base) : Base(base) {}
};
// Written to: its argument is `.noconvert()`, else what is written goes to a converted copy and is lost.
template <typename T, std::size_t N = 1>
using ArrayInOut = nanobind::ndarray<T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu>;
template <typename T, std::size_t N = 1> using ArrayOut = nanobind::ndarray<nanobind::numpy, T, nanobind::ndim<N>>;

// A new numpy array of this shape, not initialised; write through .data().
template <typename T, typename... Sizes> ArrayOut<T, sizeof...(Sizes)> new_array(Sizes... shape) {
    T *data = new T[(std::size_t{1} * ... * static_cast<std::size_t>(shape))];
    nanobind::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return ArrayOut<T, sizeof...(Sizes)>(data, {static_cast<std::size_t>(shape)...}, owner);
}

// Whether an array holds integers or bools, all of them among T's.
template <typename T> bool holds_only(nanobind::handle array) noexcept {
    try {
        const auto kind = nanobind::cast<std::string>(array.attr("dtype").attr("kind"));
        if (kind != "i" && kind != "u" && kind != "b") {
            return false;
        }
        const nanobind::int_ least(std::numeric_limits<T>::min()), most(std::numeric_limits<T>::max());
        return nanobind::cast<size_t>(array.attr("size")) == 0 ||
               (nanobind::int_(array.attr("min")()) >= least && nanobind::int_(array.attr("max")()) <= most);
    } catch (const std::exception &) { // nothing that numpy knows
        return false;
    }
}

template <typename T, std::size_t N> struct nanobind::detail::type_caster<ArrayIn<T, N>> {
    using Array = ArrayIn<T, N>;
    using Plain = make_caster<typename Array::Base>;
    NB_TYPE_CASTER(Array, Plain::Name)

    template <typename Flags> bool from_python(handle src, Flags flags, cleanup_list *cleanup) noexcept {
        const auto as_it_is = static_cast<Flags>(flags & ~static_cast<Flags>(cast_flags::convert));
        Plain plain;
        const bool found =
            plain.from_python(src, as_it_is, cleanup) ||
            ((std::is_floating_point_v<T> || holds_only<T>(src)) && plain.from_python(src, flags, cleanup));
        if (found) {
            value = Array(plain.value);
        }
        return found;
    }
};

inline std::vector<double> copied(const ArrayIn<double> &values) {
    return {values.data(), values.data() + values.size()};
}

#endif
