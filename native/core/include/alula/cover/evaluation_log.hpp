// The weights that a merge has evaluated, for running the same merge again at lower cost.
#pragma once

#include <cstdint>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace alula {

// W of pairs of elements, by their numbers. The numbers are valid only for a merge of the same start sets
// by the same rule; a fingerprint of both is kept with the entries. A merge that finds a pair here
// uses its weight instead of computing it, and does the same merges in the same order.
class EvaluationLog {
 public:
  struct Entry {
    std::uint32_t left, right;
    double weight;
  };

  EvaluationLog() = default;
  // Restores an earlier snapshot; throws std::invalid_argument when it is damaged.
  explicit EvaluationLog(std::string_view snapshot);

  // Keeps the entries if they have this fingerprint, and drops them otherwise.
  void open(std::uint64_t fingerprint);
  // These may be called by several threads. `find` gives the weight of a pair, `add` adds pairs that are not in the
  // log yet.
  std::optional<double> find(std::uint32_t left, std::uint32_t right) const;
  void add(std::span<const Entry> entries);
  void count_reuse(std::size_t entries);

  // These may be called while another thread merges.
  std::string snapshot() const;
  std::size_t size() const;
  std::size_t reused() const;  // weights found since the log was made

 private:
  const Entry* at(std::uint32_t left, std::uint32_t right) const;
  void insert(const Entry& entry);

  mutable std::mutex mutex_;
  std::uint64_t fingerprint_ = 0;
  std::size_t reused_ = 0;
  std::vector<Entry> entry_;
  std::vector<std::uint32_t> table_;  // open addressing; entry + 1
};

// FNV-1a over bytes, continued from `state`.
std::uint64_t fingerprint(std::string_view bytes, std::uint64_t state = 14695981039346656037u);

}  // namespace alula
