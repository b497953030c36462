// Crossings of image lines with an outline, and the spans of the lines that the instrument covers.
//
// Along an image line the layer count changes only where the line crosses an outline edge, and by a known amount. With
// the crossings in their order, the layer count is the sum of these changes, and the instrument covers the line where
// it is positive. The changes on a line sum to zero, because pieces that share an end assign it to the same line. The
// cost is proportional to the length of the outline, not to the area of the image.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "outline.hpp"

namespace kernel {

constexpr double kClose = 1.0 / 256;  // px; crossings that are closer may be in the wrong order

// Evenly spaced lines, `per_pixel` in each of `pixels` rows, or columns if `vertical`; `extent` is their length, px.
struct Grid {
  int pixels, extent, per_pixel;
  bool vertical;

  static Grid rows(const Camera& camera, int per_pixel) { return {camera.height, camera.width, per_pixel, false}; }
  static Grid columns(const Camera& camera) { return {camera.width, camera.height, 1, true}; }

  int count() const { return pixels * per_pixel; }
  double across(Vector2 pixel) const { return pixel[vertical ? 0 : 1]; }
  double along(Vector2 pixel) const { return pixel[vertical ? 1 : 0]; }
  double line_of(double across) const { return per_pixel * across + (per_pixel - 1) / 2.0; }
  double place_of(int line) const { return (line + 0.5) / per_pixel - 0.5; }
};

struct Crossing {
  double along;  // px, within the image
  Index piece;
  std::uint16_t line;
  std::int8_t change;  // of the layer count in the direction of the line
  bool covered;        // whether the line is covered from here to the next crossing
};

constexpr int kMostLines = 1 << 16;

class Lines {
 public:
  Grid grid{};
  std::vector<Index> begin;  // of each line's crossings, and one more
  std::vector<Crossing> crossings;

  // Find the crossings, and sort them by line and place: first by coarse places, then by lines, which leaves few of a
  // line in the wrong order. Both are linear in their number; those at the same place stay in the order of the pieces.
  void find(const std::vector<Piece>& pieces, const Grid& lines) {
    grid = lines;
    begin.assign(grid.count() + 1, 0);
    loose_.clear();
    for (std::size_t i = 0; i < pieces.size(); ++i) cross(pieces[i], static_cast<Index>(i));
    sum_up(begin);
    order_by_place();
    crossings.resize(loose_.size());
    next_.assign(begin.begin(), begin.end() - 1);
    Index* next = next_.data();
    for (Index i : order_) crossings[next[loose_[i].line]++] = loose_[i];
    for (int line = 0; line < grid.count(); ++line) finish_order(line);
  }

  // Decide by the layer count what is covered.
  void count_layers() {
    for (int line = 0; line < grid.count(); ++line) {
      int layers = 0;
      for (Index i = begin[line]; i < begin[line + 1]; ++i) {
        layers += crossings[i].change;
        crossings[i].covered = layers > 0;
      }
    }
  }

  // Call `use(line, first, last)` with the crossings at which each covered span starts and ends.
  template <class Use>
  void each_span(Use&& use) const {
    for (int line = 0; line < grid.count(); ++line) {
      const Crossing* start = nullptr;
      for (Index i = begin[line]; i < begin[line + 1]; ++i) {
        const Crossing& crossing = crossings[i];
        if (crossing.covered && start == nullptr) {
          start = &crossing;
        } else if (!crossing.covered && start != nullptr) {
          use(line, *start, crossing);
          start = nullptr;
        }
      }
    }
  }

 private:
  // The first line at or below a place, from 0 to the number of lines.
  int first_line(double across) const {
    return static_cast<int>(within(std::ceil(across), 0.0, double(grid.count())));
  }

  void cross(const Piece& piece, Index number) {
    const double from = grid.line_of(grid.across(piece.from)), to = grid.line_of(grid.across(piece.to));
    const int first = first_line(std::min(from, to)), last = first_line(std::max(from, to));
    if (first == last) return;
    const double slope = (grid.along(piece.to) - grid.along(piece.from)) / (to - from);
    // from the end that is nearer to the first line: the other one may lie very far outside the image
    const bool near_end = std::abs(first - to) < std::abs(first - from);
    const double at = near_end ? to : from, along = grid.along(near_end ? piece.to : piece.from);
    // columns are rows of the mirrored image, in which the left and the right side of an edge change places
    const auto change = static_cast<std::int8_t>((from < to) != grid.vertical ? piece.change : -piece.change);
    const double limit = grid.extent - 0.5;
    const std::size_t count = loose_.size();
    loose_.resize(count + (last - first));
    Crossing* next = loose_.data() + count;
    Index* counted = begin.data() + 1;
    for (int line = first; line < last; ++line) {
      const double place = within(along + slope * (line - at), -0.5, limit);
      *next++ = {place, number, static_cast<std::uint16_t>(line), change, false};
      ++counted[line];
    }
  }

  // Turn numbers of elements, each after its place, into offsets.
  static void sum_up(std::vector<Index>& counts) {
    for (std::size_t i = 1; i < counts.size(); ++i) counts[i] += counts[i - 1];
  }

  void order_by_place() {
    const int bins = static_cast<int>(std::min<std::size_t>(loose_.size() / 4 + 1, 1024));
    const double scale = (bins - 1) / double(grid.extent);
    const auto bin_of = [&](const Crossing& one) { return static_cast<int>((one.along + 0.5) * scale); };
    next_.assign(bins + 1, 0);
    order_.resize(loose_.size());
    Index *next = next_.data(), *order = order_.data();
    for (const Crossing& one : loose_) ++next[bin_of(one) + 1];
    sum_up(next_);
    for (const Crossing& one : loose_) order[next[bin_of(one)]++] = static_cast<Index>(&one - loose_.data());
  }

  void finish_order(int line) {
    Crossing *const first = crossings.data() + begin[line], *const last = crossings.data() + begin[line + 1];
    for (Crossing* next = first + 1; next < last; ++next) {
      if (!(next->along < next[-1].along)) continue;
      const Crossing moved = *next;
      Crossing* place = next;
      for (; place > first && moved.along < place[-1].along; --place) *place = place[-1];
      *place = moved;
    }
  }

  std::vector<Crossing> loose_;  // in the order of the pieces
  std::vector<Index> order_, next_;
};

}  // namespace kernel
