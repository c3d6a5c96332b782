// Blocks of vectors, in pieces that fit one request, and their answers.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "convert.hpp"

namespace moldline::internal {

/// Values of each of `count` vectors.
template <class T>
std::size_t length(View<T> block, std::size_t count, const char* name) {
  if (count == 0 || block.size() % count != 0) {
    throw std::invalid_argument(
        std::string(name) + " has " + std::to_string(block.size()) + " values, which are not " + std::to_string(count) +
        " vectors of the same length");
  }
  return block.size() / count;
}

/// Calls with the first vector and the number of vectors of pieces that fit one request, where each vector has `points`.
template <class Call>
void pieces(std::size_t points, std::size_t count, const Call& call) {
  /// Vectors and bytes of one request, within the server's usual limits.
  constexpr std::size_t most_vectors = 64;
  constexpr std::size_t most_bytes = 32 << 20;
  const std::size_t step =
      std::clamp<std::size_t>(most_bytes / (sizeof(Point) * std::max<std::size_t>(points, 1)), 1, most_vectors);
  for (std::size_t first = 0; first < count; first += step) call(first, std::min(step, count - first));
}

template <class T>
void append(std::vector<T>& all, std::vector<T> part) {
  if (all.empty()) {
    all = std::move(part);
  } else {
    all.insert(all.end(), part.begin(), part.end());
  }
}

inline void add(Timings& sum, const v1::Timings& part) {
  const Timings more = timings(part);
  sum.queue += more.queue;
  sum.engine += more.engine;
}

}  // namespace moldline::internal
