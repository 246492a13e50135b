// Constructors and attributes of option structs in Python, from their field lists.
//
// All options are keyword-only. Unknown names and values of another type raise TypeError. Values beyond their limits
// and structs that their own `check` rejects raise ValueError.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "alula/base/fields.hpp"
#include "alula/geometry/vec3.hpp"

namespace alula::fields {

namespace nb = nanobind;

template <class M>
concept Chosen = std::is_enum_v<M> && requires { Choices<M>::names; };

// Conversion of a member: `type` in a signature, `from` a Python value, `out` to a value that nanobind converts.
template <class M>
struct Python {  // a bound class
  static std::string type() { return nb::cast<std::string>(nb::type<M>().attr("__name__")); }
  static M from(nb::handle value) { return nb::cast<M>(value); }
  static const M& out(const M& value) { return value; }
};

template <class M>
  requires std::is_arithmetic_v<M>
struct Python<M> {
  static std::string type() {
    return std::is_same_v<M, bool> ? "bool" : std::is_floating_point_v<M> ? "float" : "int";
  }
  static M from(nb::handle value) { return nb::cast<M>(value); }
  static M out(M value) { return value; }
};

template <>
struct Python<std::string> {
  static std::string type() { return "str"; }
  static std::string from(nb::handle value) { return nb::cast<std::string>(value); }
  static const std::string& out(const std::string& value) { return value; }
};

template <Chosen M>
struct Python<M> {
  static std::string type() { return "str"; }
  static M from(nb::handle value) {
    const auto name = nb::cast<std::string>(value);
    std::string known;
    for (std::size_t i = 0; i < Choices<M>::names.size(); ++i) {
      if (name == Choices<M>::names[i]) return static_cast<M>(i);
      known += std::string(i == 0 ? "" : i + 1 < Choices<M>::names.size() ? ", " : " or ") + Choices<M>::names[i];
    }
    throw std::invalid_argument("must be " + known + ", not '" + name + "'");
  }
  static std::string out(M value) { return Choices<M>::names[static_cast<std::size_t>(value)]; }
};

template <std::size_t N>
struct Python<std::array<double, N>> {
  using Numbers = std::array<double, N>;
  static std::string type() { return "collections.abc.Sequence[float]"; }
  static Numbers from(nb::handle value) { return nb::cast<Numbers>(value); }
  static const Numbers& out(const Numbers& value) { return value; }
};

template <>
struct Python<geometry::Vec3> {
  using Numbers = std::array<double, 3>;
  static std::string type() { return Python<Numbers>::type(); }
  static geometry::Vec3 from(nb::handle value) {
    const auto v = nb::cast<Numbers>(value);
    return {v[0], v[1], v[2]};
  }
  static Numbers out(geometry::Vec3 v) { return {v.x, v.y, v.z}; }
};

template <>
struct Python<geometry::PerAxis> {
  using Numbers = std::array<double, 3>;
  static std::string type() { return "float | " + Python<Numbers>::type(); }
  static geometry::PerAxis from(nb::handle value) {
    if (double all = 0; nb::try_cast(value, all)) return all;
    return Python<geometry::Vec3>::from(value);
  }
  static Numbers out(const geometry::PerAxis& v) { return Python<geometry::Vec3>::out(v); }
};

template <class M>
struct Python<std::optional<M>> {
  using Out = std::optional<std::remove_cvref_t<decltype(Python<M>::out(std::declval<const M&>()))>>;
  static std::string type() { return Python<M>::type() + " | None"; }
  static std::optional<M> from(nb::handle value) {
    if (value.is_none()) return {};
    return Python<M>::from(value);
  }
  static Out out(const std::optional<M>& value) {
    if (!value) return {};
    return Python<M>::out(*value);
  }
};

template <class M>
struct Python<std::vector<M>> {
  using Out = std::vector<std::remove_cvref_t<decltype(Python<M>::out(std::declval<const M&>()))>>;
  static std::string type() { return "collections.abc.Sequence[" + Python<M>::type() + "]"; }
  static std::vector<M> from(nb::handle values) {
    std::vector<M> result;
    for (const nb::handle value : values) result.push_back(Python<M>::from(value));
    return result;
  }
  static Out out(const std::vector<M>& values) {
    Out result;
    for (const M& value : values) result.push_back(Python<M>::out(value));
    return result;
  }
};

// Converts a choice that is a single argument; the message of an invalid one begins with `what`.
template <Chosen E>
E choice(nb::handle value, const std::string& what) {
  try {
    return Python<E>::from(value);
  } catch (const std::invalid_argument& error) {
    throw std::invalid_argument(what + " " + error.what());
  }
}

template <class M>
inline constexpr bool is_optional = false;
template <class M>
inline constexpr bool is_optional<std::optional<M>> = true;

// The value as Python code, for signatures; `...` for an object of a bound class.
template <class M>
std::string code_of(const M& value) {
  if constexpr (std::is_floating_point_v<M>) {
    if (std::isinf(value)) return value > 0 ? "float('inf')" : "float('-inf')";
  }
  using Out = std::remove_cvref_t<decltype(Python<M>::out(value))>;
  if constexpr (std::is_class_v<M> && std::is_same_v<Out, M> && !std::is_same_v<M, std::string> && !is_optional<M> &&
                !requires { std::tuple_size<M>::value; }) {
    return "...";
  } else {
    return nb::cast<std::string>(nb::repr(nb::cast(Python<M>::out(value))));
  }
}

// How members of one type are read and written from Python: functions of the member's address.
struct Conversion {
  std::string (*type)();
  void (*assign)(void* member, nb::handle value);
  nb::object (*out)(const void* member);
  std::string (*code)(const void* member);
  double (*number)(const void* member);  // null if it is none
};

template <class M>
inline constexpr Conversion conversion{
    &Python<M>::type, [](void* member, nb::handle value) { *static_cast<M*>(member) = Python<M>::from(value); },
    [](const void* member) { return nb::cast(Python<M>::out(*static_cast<const M*>(member))); },
    [](const void* member) { return code_of(*static_cast<const M*>(member)); },
    [] {
      double (*number)(const void*) = nullptr;
      if constexpr (std::is_arithmetic_v<M>)
        number = [](const void* member) { return static_cast<double>(*static_cast<const M*>(member)); };
      return number;
    }()};

// A field of a struct, at `offset` bytes from its begin. What follows is compiled once, not for each struct.
struct Entry {
  std::string name;
  const char* doc;
  Limits limits;
  bool is_required;
  std::size_t offset;
  const Conversion* as;
};
using Entries = std::vector<Entry>;

// Those of T, made at the first call from any object of it.
template <class T>
const Entries& entries_of(const T& object) {
  static const Entries all = [&object] {
    Entries list;
    each_field<T>(object, [&]<class M>(const std::string& name, const auto& field, const M& value) {
      const auto offset = reinterpret_cast<const char*>(&value) - reinterpret_cast<const char*>(&object);
      list.push_back(
          {name, field.doc, field.limits, field.is_required, static_cast<std::size_t>(offset), &conversion<M>});
    });
    return list;
  }();
  return all;
}

std::string signature(const Entries& entries, const void* object, const std::string& prefix, const std::string& name,
                      const std::string& result, const std::string& others);
std::string documentation(const Entries& entries, const std::string& head);
std::string attribute_signature(const Entry& entry);
void assign(const Entries& entries, void* object, const nb::kwargs& given, const std::string& what);

// `def NAME(PREFIX, *, field: type = default, ..., OTHERS) -> RESULT`, with the defaults of `object`.
template <class T>
std::string signature(const T& object, const std::string& prefix = "self", const std::string& name = "__init__",
                      const std::string& result = "None", const std::string& others = {}) {
  return signature(entries_of(object), &object, prefix, name, result, others);
}

// "Args:" and a line for each field that has documentation.
template <class T>
std::string documentation(const T& object, const std::string& head = {}) {
  return documentation(entries_of(object), head);
}

// Sets the fields given by name.
template <class T>
void assign(T& object, const nb::kwargs& given, const std::string& what) {
  assign(entries_of(object), &object, given, what);
}

// Applies the struct's own `check`, beyond the limits of its fields.
template <class T>
void require_valid(const T& object) {
  if constexpr (requires { check(object); }) check(object);
}

// Binds an option struct: its constructor and read-only attributes.
template <class T>
nb::class_<T> bind(nb::module_& m, const char* name, const char* doc) {
  nb::class_<T> bound(m, name, doc);
  const T plain{};
  bound.def(
      "__init__",
      [what = std::string(name)](T* self, const nb::kwargs& given) {
        T object{};
        assign(object, given, what);
        require_valid(object);
        new (self) T(std::move(object));
      },
      nb::sig(signature(plain).c_str()), documentation(plain).c_str());
  for (const Entry& entry : entries_of(plain)) {
    bound.def_prop_ro(
        entry.name.c_str(),
        [&entry](const T& self) { return entry.as->out(reinterpret_cast<const char*>(&self) + entry.offset); },
        nb::sig(attribute_signature(entry).c_str()), *entry.doc == '\0' ? nullptr : entry.doc);
  }
  return bound;
}

// The same with a constructor that takes the fields of `Arguments` and turns them into T; without attributes.
template <class T, class Arguments, class Make>
nb::class_<T> bind_from(nb::module_& m, const char* name, const char* doc, Make make) {
  nb::class_<T> bound(m, name, doc);
  const Arguments plain{};
  bound.def(
      "__init__",
      [what = std::string(name), make](T* self, const nb::kwargs& given) {
        Arguments arguments{};
        assign(arguments, given, what);
        T object = make(std::move(arguments));
        require_valid(object);
        new (self) T(std::move(object));
      },
      nb::sig(signature(plain).c_str()), documentation(plain).c_str());
  return bound;
}

}  // namespace alula::fields
