// Distances of single points to the outline of a mask.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "comparison.hpp"

namespace kernel {

// Finds, from single pixels of a mask (H, W), the nearest pixels of the other kind: outside it, or inside for those outside.
class NearestOther {
 public:
  NearestOther(const bool* mask, std::int64_t width, std::int64_t height) : mask_(mask), width_(width), height_(height) {}

  std::int64_t width() const { return width_; }
  std::int64_t height() const { return height_; }
  bool inside(std::int64_t column, std::int64_t row) const { return mask_[width_ * row + column]; }

  // The squared distance of a pixel, px^2; `most` if there is no nearer one.
  std::int64_t square(std::int64_t column, std::int64_t row, std::int64_t most) {
    const std::int64_t near = nearest(row, std::min(most, kNear), [&](std::int64_t other, std::int64_t rest) {
      return along_row(other, column, inside(column, row), rest);
    });
    if (near < kNear || most <= kNear) return near;
    if (along_.empty()) along_.resize(height_);
    return nearest(row, most, [&](std::int64_t other, std::int64_t) -> std::int64_t {
      if (along_[other].empty()) find_along(other);
      return inside(column, other) == inside(column, row) ? along_[other][column] : 0;
    });
  }

 private:
  static constexpr std::int32_t kNone = 1 << 20;  // px; there is none in the row
  static constexpr std::int64_t kNear = 100;      // px^2, up to which rows are searched pixel by pixel

  // Go through the rows from near to far; `distance(other, rest)` is that along one, whose square counts if below the rest.
  template <class Distance>
  std::int64_t nearest(std::int64_t row, std::int64_t best, const Distance& distance) {
    for (std::int64_t off = 0; off * off < best && (off <= row || off < height_ - row); ++off) {
      for (const std::int64_t other : {row - off, row + off}) {
        if (other < 0 || other >= height_) continue;
        const std::int64_t along = distance(other, best - off * off);
        best = std::min(best, off * off + along * along);
      }
    }
    return best;
  }

  std::int64_t along_row(std::int64_t row, std::int64_t column, bool kind, std::int64_t rest) const {
    const bool* kinds = mask_ + width_ * row;
    std::int64_t away = 0;
    for (; away * away < rest; ++away) {
      if (column >= away && kinds[column - away] != kind) break;
      if (column + away < width_ && kinds[column + away] != kind) break;
    }
    return away;
  }

  // Find the distance of each pixel of a row to the nearest one of the other kind in it.
  void find_along(std::int64_t row) {
    const bool* kinds = mask_ + width_ * row;
    std::vector<std::int32_t>& out = along_[row];
    out.resize(width_);
    std::int32_t since = kNone;
    for (std::int64_t i = 0; i < width_; ++i) {
      since = i > 0 && kinds[i] != kinds[i - 1] ? 1 : std::min(since + 1, kNone);
      out[i] = since;
    }
    since = kNone;
    for (std::int64_t i = width_ - 1; i >= 0; --i) {
      since = i + 1 < width_ && kinds[i] != kinds[i + 1] ? 1 : std::min(since + 1, kNone);
      out[i] = std::min(out[i], since);
    }
  }

  const bool* mask_;
  std::int64_t width_, height_;
  std::vector<std::vector<std::int32_t>> along_;  // of the rows that were needed
};

// The signed distance, px, of a point to a mask's outline, negative inside: bilinear between the pixels around it, those at
// the border being beyond it, too, whose distances are those to the nearest pixel of the other kind less half a pixel.
// Those beyond `farthest` px count as that.
inline double signed_distance(NearestOther& nearest, double u, double v, double farthest) {
  const Between at(int(nearest.width()), int(nearest.height()), u, v);
  const auto of_pixel = [&](std::size_t column, std::size_t row) {
    const double away = std::sqrt(double(nearest.square(column, row, std::int64_t(farthest * farthest)))) - 0.5;
    return nearest.inside(column, row) ? -away : away;
  };
  const auto along = [&](std::size_t row) {
    const double left = of_pixel(at.column, row);
    return at.x == 0.0 ? left : left + at.x * (of_pixel(at.column + at.right, row) - left);
  };
  const double top = along(at.row);
  return at.y == 0.0 ? top : top + at.y * (along(at.row + at.below) - top);
}

}  // namespace kernel
