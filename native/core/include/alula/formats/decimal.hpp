// Decimal numbers in text, as Python's float() reads them but for its underscores.
#pragma once

namespace alula {

// Whether [begin, end) is [+-] digits [. digits] [e [+-] digits], with digits before or after the point, or
// [+-] inf, infinity or nan, in any case. If so and `value` is not null, the nearest double is stored there:
// infinite or zero where it is too large or too small.
bool parse_decimal(const char* begin, const char* end, double* value);

}  // namespace alula
