// Parser of decimal numbers in text, with the grammar of Python's float() except underscores.
#pragma once

namespace alula {

// True if [begin, end) is [+-] digits [. digits] [e [+-] digits], with digits before or after the point, or
// [+-] inf, infinity or nan, in any case. If so and `value` is not null, stores the nearest double there:
// infinite or zero where the number is too large or too small.
bool parse_decimal(const char* begin, const char* end, double* value);

}  // namespace alula
