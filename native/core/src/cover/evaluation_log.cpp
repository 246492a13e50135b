#include "alula/cover/evaluation_log.hpp"

#include <bit>
#include <cstring>
#include <limits>
#include <stdexcept>

namespace alula {

namespace {

constexpr std::string_view kMagic = "alula/merge-log1";
constexpr std::size_t kHead = 16 + 2 * sizeof(std::uint64_t);  // magic, fingerprint, checksum
static_assert(sizeof(EvaluationLog::Entry) == 16 && std::endian::native == std::endian::little);

std::size_t slot_of(std::uint32_t left, std::uint32_t right) {
  return static_cast<std::size_t>(((std::uint64_t{left} << 32 | right) * 0x9E3779B97F4A7C15u) >> 24);
}

}  // namespace

std::uint64_t fingerprint(std::string_view bytes, std::uint64_t state) {
  for (const char c : bytes) state = (state ^ static_cast<unsigned char>(c)) * 1099511628211u;
  return state;
}

EvaluationLog::EvaluationLog(std::string_view snapshot) {
  if (snapshot.empty()) return;
  if (snapshot.size() < kHead || snapshot.substr(0, 16) != kMagic || (snapshot.size() - kHead) % sizeof(Entry) != 0)
    throw std::invalid_argument("not a journal of a merge");
  const std::string_view body = snapshot.substr(kHead);
  std::uint64_t sum;
  std::memcpy(&fingerprint_, snapshot.data() + 16, sizeof(sum));
  std::memcpy(&sum, snapshot.data() + 24, sizeof(sum));
  if (sum != fingerprint(body, fingerprint_)) throw std::invalid_argument("the journal of a merge is damaged");
  std::vector<Entry> entries(body.size() / sizeof(Entry));
  if (!entries.empty()) std::memcpy(entries.data(), body.data(), body.size());
  for (const Entry& entry : entries)
    if (!(entry.weight >= 0 && entry.weight < std::numeric_limits<double>::infinity()))
      throw std::invalid_argument("the journal of a merge holds a weight that is none");
  add(entries);
}

void EvaluationLog::open(std::uint64_t print) {
  const std::lock_guard lock(mutex_);
  if (print != fingerprint_) entry_.clear(), table_.clear();
  fingerprint_ = print;
}

std::optional<double> EvaluationLog::find(std::uint32_t left, std::uint32_t right) const {
  const std::lock_guard lock(mutex_);
  const Entry* entry = at(left, right);
  return entry == nullptr ? std::nullopt : std::optional(entry->weight);
}

const EvaluationLog::Entry* EvaluationLog::at(std::uint32_t left, std::uint32_t right) const {
  if (table_.empty()) return nullptr;
  for (std::size_t slot = slot_of(left, right);; ++slot) {
    const std::uint32_t number = table_[slot & (table_.size() - 1)];
    if (number == 0) return nullptr;
    const Entry& entry = entry_[number - 1];
    if (entry.left == left && entry.right == right) return &entry;
  }
}

void EvaluationLog::insert(const Entry& entry) {
  entry_.push_back(entry);
  std::size_t slot = slot_of(entry.left, entry.right);
  while (table_[slot & (table_.size() - 1)] != 0) ++slot;
  table_[slot & (table_.size() - 1)] = static_cast<std::uint32_t>(entry_.size());
}

void EvaluationLog::add(std::span<const Entry> entries) {
  const std::lock_guard lock(mutex_);
  if (2 * (entry_.size() + entries.size()) >= table_.size()) {
    std::vector<Entry> all;
    all.swap(entry_);
    all.reserve(2 * (all.size() + entries.size()));
    table_.assign(std::bit_ceil(4 * (all.size() + entries.size()) + 1), 0);
    entry_.reserve(all.capacity());
    for (const Entry& entry : all) insert(entry);
  }
  for (const Entry& entry : entries)
    if (at(entry.left, entry.right) == nullptr) insert(entry);
}

void EvaluationLog::count_reuse(std::size_t entries) {
  const std::lock_guard lock(mutex_);
  reused_ += entries;
}

std::string EvaluationLog::snapshot() const {
  const std::lock_guard lock(mutex_);
  std::string result(kHead + entry_.size() * sizeof(Entry), '\0');
  std::memcpy(result.data(), kMagic.data(), kMagic.size());
  if (!entry_.empty()) std::memcpy(result.data() + kHead, entry_.data(), entry_.size() * sizeof(Entry));
  const std::uint64_t sum = fingerprint(std::string_view(result).substr(kHead), fingerprint_);
  std::memcpy(result.data() + 16, &fingerprint_, sizeof(sum));
  std::memcpy(result.data() + 24, &sum, sizeof(sum));
  return result;
}

std::size_t EvaluationLog::size() const {
  const std::lock_guard lock(mutex_);
  return entry_.size();
}

std::size_t EvaluationLog::reused() const {
  const std::lock_guard lock(mutex_);
  return reused_;
}

}  // namespace alula
