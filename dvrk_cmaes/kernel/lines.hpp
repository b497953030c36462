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
#include <limits>
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
  double across(const Vector2& pixel) const { return pixel[vertical ? 0 : 1]; }
  double along(const Vector2& pixel) const { return pixel[vertical ? 1 : 0]; }
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
constexpr Index kAllPieces = std::numeric_limits<Index>::max();

class Lines {
 public:
  Grid grid{};
  std::vector<Index> begin;  // of each line's crossings, and one more
  std::vector<Crossing> crossings;

  // Find the crossings, line by line. The pieces that cross a line are nearly in the order in which they cross the line
  // before, so keeping them in order costs little more than passing over them.
  void find(const std::vector<Piece>& pieces, const Grid& lines) {
    grid = lines;
    const int count = grid.count();
    find_crossed(pieces);
    begin.resize(count + 1);
    crossings.resize(total_);
    along_.resize(crossed_.size()), active_.resize(crossed_.size());
    Crossing* next = crossings.data();
    std::size_t added = 0, kept = 0;
    for (int line = 0; line < count; ++line) {
      begin[line] = static_cast<Index>(next - crossings.data());
      const std::size_t before = kept;
      kept = 0;
      for (std::size_t i = 0; i < before; ++i) {
        if (crossed_[active_[i]].last > line) insert(active_[i], line, kept++);
      }
      for (; added < order_.size() && crossed_[order_[added]].first == line; ++added) insert(order_[added], line, kept++);
      for (std::size_t i = 0; i < kept; ++i) {
        const Crossed& one = crossed_[active_[i]];
        *next++ = {along_[i], one.piece, static_cast<std::uint16_t>(line), one.change, false};
      }
    }
    begin[count] = static_cast<Index>(next - crossings.data());
  }

  // Decide by the layer count what is covered, by the pieces from `first` to before `last` alone.
  void count_layers(Index first = 0, Index last = kAllPieces) {
    for (int line = 0; line < grid.count(); ++line) {
      int layers = 0;
      for (Index i = begin[line]; i < begin[line + 1]; ++i) {
        if (crossings[i].piece >= first && crossings[i].piece < last) layers += crossings[i].change;
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
  int first_line(double across) const { return static_cast<int>(within(std::ceil(across), 0.0, double(grid.count()))); }

  // A piece and the lines that it crosses, from first to before last; it crosses the line `at` at `along`, px.
  struct Crossed {
    double at, along, slope;
    int first, last;
    Index piece;
    std::int8_t change;

    Crossed(double at, double along, double slope, int first, int last, Index piece, std::int8_t change)
        : at(at), along(along), slope(slope), first(first), last(last), piece(piece), change(change) {}
  };

  // Find the pieces that cross lines, and their order by the first of these.
  void find_crossed(const std::vector<Piece>& pieces) {
    crossed_.clear();
    total_ = 0;
    starts_.assign(grid.count() + 1, 0);
    for (std::size_t i = 0; i < pieces.size(); ++i) {
      const Piece& piece = pieces[i];
      const double from = grid.line_of(grid.across(piece.from)), to = grid.line_of(grid.across(piece.to));
      const int start = first_line(from), end = first_line(to);
      if (start == end) continue;
      const int first = std::min(start, end), last = std::max(start, end);
      const double slope = (grid.along(piece.to) - grid.along(piece.from)) / (to - from);
      // from the end that is nearer to the first line: the other one may lie very far outside the image
      const bool near_end = std::abs(first - to) < std::abs(first - from);
      // columns are rows of the mirrored image, in which the left and the right side of an edge change places
      const auto change = static_cast<std::int8_t>((from < to) != grid.vertical ? piece.change : -piece.change);
      crossed_.emplace_back(near_end ? to : from, near_end ? grid.along(piece.to) : grid.along(piece.from), slope, first,
                            last, static_cast<Index>(i), change);
      ++starts_[first + 1];
      total_ += last - first;
    }
    for (std::size_t i = 1; i < starts_.size(); ++i) starts_[i] += starts_[i - 1];
    order_.resize(crossed_.size());
    for (std::size_t i = 0; i < crossed_.size(); ++i) order_[starts_[crossed_[i].first]++] = static_cast<Index>(i);
  }

  // Put a piece that crosses a line into its place among the first `count`.
  void insert(Index crossed, int line, std::size_t count) {
    const Crossed& one = crossed_[crossed];
    const double place = within(one.along + one.slope * (line - one.at), -0.5, grid.extent - 0.5);
    double* const along = along_.data();
    Index* const active = active_.data();
    for (; count > 0 && place < along[count - 1]; --count) {
      along[count] = along[count - 1];
      active[count] = active[count - 1];
    }
    along[count] = place;
    active[count] = crossed;
  }

  std::size_t total_ = 0;
  std::vector<Crossed> crossed_;
  std::vector<double> along_;
  std::vector<Index> active_, order_, starts_;
};

}  // namespace kernel
