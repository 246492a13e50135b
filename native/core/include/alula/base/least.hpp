// The least of many items, in a heap of bounded size.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace alula {

// Keeps the `most` > 0 least items of those given so far; true once there are so many, and then the greatest of them
// is the first. Items are compared by before(a, b).
template <class T, class Before>
bool keep_least(std::vector<T>& kept, std::size_t most, const T& item, Before before) {
  if (kept.size() < most) {
    kept.push_back(item);
    if (kept.size() == most) std::make_heap(kept.begin(), kept.end(), before);
  } else if (before(item, kept.front())) {
    std::pop_heap(kept.begin(), kept.end(), before);
    kept.back() = item;
    std::push_heap(kept.begin(), kept.end(), before);
  }
  return kept.size() == most;
}

}  // namespace alula
