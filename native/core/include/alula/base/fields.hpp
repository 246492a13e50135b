// Compile-time field lists of option structs: names, members, documentation and limits.
#pragma once

#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>

namespace alula {

// Limits of a number; `above` and `below` are exclusive.
struct Limits {
  double min = -std::numeric_limits<double>::infinity(), above = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity(), below = std::numeric_limits<double>::infinity();
};

// A member of T, or of a base of T.
template <class T, class M>
struct Field {
  constexpr Field(const char* name_, M T::* member_, const char* doc_ = "", Limits limits_ = {},
                  bool is_required_ = false)
      : name(name_), member(member_), doc(doc_), limits(limits_), is_required(is_required_) {}

  const char* name;
  M T::* member;
  const char* doc;
  Limits limits;
  bool is_required;
};

// A member whose own fields are fields of T, with a prefix before their names.
template <class T, class M>
struct Nested {
  constexpr explicit Nested(M T::* member_, const char* prefix_ = "") : member(member_), prefix(prefix_) {}

  M T::* member;
  const char* prefix;
};

// Specialised with a tuple `all` of fields.
template <class T>
struct Fields;

// Specialised for an enumeration from 0 on, with an array `names`.
template <class E>
struct Choices;

// Throws std::invalid_argument for a number beyond its limits, or NaN where it has limits.
inline void check_limits(const std::string& name, const Limits& limits, double value) {
  const double infinity = std::numeric_limits<double>::infinity();
  const bool is_limited =
      limits.min != -infinity || limits.above != -infinity || limits.max != infinity || limits.below != infinity;
  if (!is_limited) return;
  const auto text = [](double limit) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%g", limit);
    return std::string(digits);
  };
  std::string must;
  if (std::isnan(value)) must = "be a number";
  if (value < limits.min) must = "be at least " + text(limits.min);
  if (limits.above != -infinity && value <= limits.above) must = "be above " + text(limits.above);
  if (value > limits.max) must = "be at most " + text(limits.max);
  if (limits.below != infinity && value >= limits.below) must = "be below " + text(limits.below);
  if (!must.empty()) throw std::invalid_argument(name + " must " + must + ", not " + text(value));
}

// Calls visit(name, field, value) for every field of an object, and of what is nested in it.
template <class T, class Object, class Visit>
void each_field(Object& object, Visit&& visit, const std::string& prefix = {}) {
  const auto one = [&]<class Entry>(const Entry& entry) {
    if constexpr (requires { entry.prefix; }) {
      using Member = std::remove_cvref_t<decltype(object.*entry.member)>;
      each_field<Member>(object.*entry.member, visit, prefix + entry.prefix);
    } else {
      visit(prefix + entry.name, entry, object.*entry.member);
    }
  };
  std::apply([&](const auto&... entry) { (one(entry), ...); }, Fields<T>::all);
}

}  // namespace alula
