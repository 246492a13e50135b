// Typed NumPy arrays in and out of the bindings, without silent copies.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace alula {

// A read-only C-contiguous array on the CPU; nanobind rejects any other argument.
template <class T, class Shape>
using In = nanobind::ndarray<const T, Shape, nanobind::c_contig, nanobind::device::cpu>;
template <class T>
using InRows3 = In<T, nanobind::shape<-1, 3>>;
template <class T>
using InRows4 = In<T, nanobind::shape<-1, 4>>;
template <class T>
using InVector = In<T, nanobind::shape<-1>>;

template <class T, class Shape>
std::span<const T> as_span(const In<T, Shape>& array) {
  return {array.data(), array.size()};
}

// An output array, allocated by the caller.
template <class T, class Shape>
using Into = nanobind::ndarray<T, Shape, nanobind::c_contig, nanobind::device::cpu>;
template <class T>
using IntoRows3 = Into<T, nanobind::shape<-1, 3>>;
template <class T>
using IntoRows4 = Into<T, nanobind::shape<-1, 4>>;
template <class T>
using IntoVector = Into<T, nanobind::shape<-1>>;

template <class T, class Shape>
std::span<T> as_span(const Into<T, Shape>& array) {
  return {array.data(), array.size()};
}

template <class T, class Shape>
std::span<T> as_span(const std::optional<Into<T, Shape>>& array) {
  if (!array) return {};
  return {array->data(), array->size()};
}

// An empty span for None.
template <class T, class Shape>
std::span<const T> as_span(const std::optional<In<T, Shape>>& array) {
  if (!array) return {};
  return as_span(*array);
}

// Moves a vector into a NumPy array, which owns it.
template <class T>
nanobind::ndarray<nanobind::numpy, T> to_numpy(std::vector<T>&& values, std::initializer_list<std::size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nanobind::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nanobind::ndarray<nanobind::numpy, T>(owned->data(), shape, owner);
}

}  // namespace alula
