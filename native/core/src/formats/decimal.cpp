#include "alula/formats/decimal.hpp"

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <version>

#ifndef __cpp_lib_to_chars
#include <cstdlib>
#endif

namespace alula {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

bool equal_lower(std::string_view word, std::string_view lower) {
  return std::equal(word.begin(), word.end(), lower.begin(), lower.end(),
                    [](char a, char b) { return (a | 0x20) == b; });
}

// Converts a valid number without sign; `leading` is the power of ten of its first digit that is not 0.
double convert(const char* begin, const char* end, std::int64_t leading) {
  double value = 0.0;
#ifdef __cpp_lib_to_chars
  if (std::from_chars(begin, end, value).ec == std::errc()) return value;
  return leading > 0 ? std::numeric_limits<double>::infinity() : 0.0;
#else
  (void)leading;
  value = std::strtod(std::string(begin, end).c_str(), nullptr);
  return value;
#endif
}

}  // namespace

bool parse_decimal(const char* begin, const char* end, double* value) {
  const char* at = begin;
  const bool negative = at < end && *at == '-';
  if (at < end && (*at == '-' || *at == '+')) ++at;
  const char* const first = at;
  std::int64_t digits = 0, leading = 0;  // leading: number of digits from the first non-zero one to the point
  bool found = false;
  for (; at < end && is_digit(*at); ++at, ++digits) {
    found = found || *at != '0';
    leading += found;
  }
  if (at < end && *at == '.') {
    for (++at; at < end && is_digit(*at); ++at, ++digits) {
      if (!found && *at == '0') --leading;
      found = found || *at != '0';
    }
  }
  if (digits == 0) {
    const std::string_view word(first, static_cast<std::size_t>(end - first));
    double special = std::numeric_limits<double>::infinity();
    if (equal_lower(word, "nan")) {
      special = std::numeric_limits<double>::quiet_NaN();
    } else if (!equal_lower(word, "inf") && !equal_lower(word, "infinity")) {
      return false;
    }
    if (value) *value = negative ? -special : special;
    return true;
  }
  if (at < end && (*at == 'e' || *at == 'E')) {
    ++at;
    const bool down = at < end && *at == '-';
    if (at < end && (*at == '-' || *at == '+')) ++at;
    if (at == end) return false;
    std::int64_t power = 0;
    for (; at < end && is_digit(*at); ++at)
      power = std::min<std::int64_t>(power * 10 + (*at - '0'), 1'000'000'000'000);
    leading += down ? -power : power;
  }
  if (at != end) return false;
  if (value) {
    const double size = convert(first, end, leading);
    *value = negative ? -size : size;
  }
  return true;
}

}  // namespace alula
