// Blocks of vectors, cut into pieces that fit one request, and their answers.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "convert.hpp"

namespace moldline::internal {

/// Some of `all` vectors, as many as fit one request.
struct Piece {
  std::size_t all;
  std::size_t first;
  std::size_t count;
};

/// Calls with each piece of `count` vectors, which have as many numbers as `points` points each.
template <class Call>
void pieces(std::size_t points, std::size_t count, const Call& call) {
  /// Vectors and bytes of one request, within the server's usual limits.
  constexpr std::size_t most_vectors = 64;
  constexpr std::size_t most_bytes = 32 << 20;
  if (count == 0) throw std::invalid_argument("there is nothing to multiply with: count is 0");
  const std::size_t step =
      std::clamp<std::size_t>(most_bytes / (sizeof(Point) * std::max<std::size_t>(points, 1)), 1, most_vectors);
  for (std::size_t first = 0; first < count; first += step) call(Piece{count, first, std::min(step, count - first)});
}

/// Makes the array that a block is written to.
template <class Message>
using MutableArray = v1::Array* (Message::*)();

/// Writes a piece of vectors of the same length, (piece, length, ...); nothing if there are no values.
template <class T, class Message>
void write_vectors(
    View<T> block, const Piece& piece, const char* name, Message& message, MutableArray<Message> array) {
  if (block.size() % piece.all != 0) {
    throw std::invalid_argument(
        std::string(name) + " has " + std::to_string(block.size()) + " entries, which are not " +
        std::to_string(piece.all) + " vectors of the same length");
  }
  const std::size_t length = block.size() / piece.all;
  if (length == 0) return;
  const auto part = block.sub(piece.first * length, piece.count * length);
  if constexpr (std::is_same_v<T, Point>) {
    write(part, {piece.count, length, 3}, *(message.*array)());
  } else {
    write(part, {piece.count, length}, *(message.*array)());
  }
}

/// Writes a piece of entries, one for each vector, (piece, ...); nothing if there are no values.
template <class T, class Message>
void write_entries(
    View<T> block, const Piece& piece, const char* name, Message& message, MutableArray<Message> array) {
  if (block.empty()) return;
  if (block.size() != piece.all) {
    throw std::invalid_argument(
        std::string(name) + " has " + std::to_string(block.size()) + " entries; there is one for each of " +
        std::to_string(piece.all) + " vectors");
  }
  const auto part = block.sub(piece.first, piece.count);
  if constexpr (std::is_same_v<T, Point>) {
    write(part, {piece.count, 3}, *(message.*array)());
  } else {
    write(part, {piece.count}, *(message.*array)());
  }
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
