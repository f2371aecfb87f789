// Whole numpy arrays in and out: how every binding passes its batches.
#ifndef TAUTLINE_NATIVE_ARRAYS_H
#define TAUTLINE_NATIVE_ARRAYS_H

#include <cstddef>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <vector>

template <typename T, std::size_t N = 1>
using ArrayIn = nanobind::ndarray<const T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu>;
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

inline std::vector<double> copied(const ArrayIn<double> &values) {
    return {values.data(), values.data() + values.size()};
}

#endif
