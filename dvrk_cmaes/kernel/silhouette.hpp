// What is computed from the covered spans of one pose: sums of images, masks, coverage, points on the outline.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "lines.hpp"

namespace kernel {

// Add the sums of K images over the covered spans. `table` (H, W + 1, K) holds the sums from the left border to the left
// side of each pixel. With `to_pixel`, sums are over the pixels whose centres are covered, otherwise integrals.
inline void add_sums(const Lines& lines, const double* table, int images, bool to_pixel, double* sums) {
  const int width = lines.grid.extent;
  const auto pixel = [&](double along) { return static_cast<int>(std::clamp(std::ceil(along), 0.0, double(width))); };
  const auto up_to = [&](const double* row, double along, double sign) {
    const double place = std::clamp(along + 0.5, 0.0, double(width));
    const int whole = std::min(static_cast<int>(place), width - 1);
    const double share = place - whole;
    const double* values = row + images * whole;
    for (int k = 0; k < images; ++k) sums[k] += sign * (values[k] + share * (values[k + images] - values[k]));
  };
  lines.each_span([&](int line, const Crossing& start, const Crossing& end) {
    const double* row = table + std::size_t(images) * (width + 1) * (line / lines.grid.per_pixel);
    if (to_pixel) {
      const double *from = row + images * pixel(start.along), *to = row + images * pixel(end.along);
      for (int k = 0; k < images; ++k) sums[k] += to[k] - from[k];
      return;
    }
    up_to(row, end.along, 1.0);
    up_to(row, start.along, -1.0);
  });
}

// Mark the pixels (H, W), zero before, whose centres are covered.
inline void fill_mask(const Lines& lines, bool* mask) {
  const int width = lines.grid.extent;
  lines.each_span([&](int line, const Crossing& start, const Crossing& end) {
    const int from = static_cast<int>(std::clamp(std::ceil(start.along), 0.0, double(width)));
    const int to = static_cast<int>(std::clamp(std::ceil(end.along), 0.0, double(width)));
    if (from < to) std::fill(mask + std::size_t(width) * line + from, mask + std::size_t(width) * line + to, true);
  });
}

// Write the covered fraction of each pixel (H, W), zero before. Places are rounded to 2^-16 px, so that sums are exact
// and pixels away from the outline exactly 0 or 1.
inline void fill_coverage(const Lines& lines, float* coverage, std::vector<std::int32_t>& change) {
  constexpr int kOne = 1 << 16;
  const int width = lines.grid.extent, per_pixel = lines.grid.per_pixel;
  change.assign(width + 2, 0);
  int low = width + 1, high = -1, row = 0;
  const auto add = [&](double along, int sign) {
    const int place = static_cast<int>(std::clamp(along + 0.5, 0.0, double(width)) * kOne + 0.5);
    const int whole = place / kOne, rest = place % kOne;
    change[whole] += sign * (kOne - rest);
    change[whole + 1] += sign * rest;
    low = std::min(low, whole), high = std::max(high, whole + 1);
  };
  const auto finish_row = [&] {
    const float whole_pixel = kOne * float(per_pixel);
    float* out = coverage + std::size_t(width) * row;
    std::int32_t sum = 0;
    for (int i = low; i <= high; ++i) {
      sum += change[i];
      if (i < width) out[i] = sum / whole_pixel;
      change[i] = 0;
    }
    low = width + 1, high = -1;
  };
  lines.each_span([&](int line, const Crossing& start, const Crossing& end) {
    if (line / per_pixel != row) finish_row(), row = line / per_pixel;
    add(start.along, 1);
    add(end.along, -1);
  });
  finish_row();
}

// A point on the visible outline. The normal points out of the silhouette; its length is that of the piece of outline,
// px, that the point stands for. `point` is on the surface, m, in the link's frame.
struct OutlinePoint {
  Index link;
  Vector2 pixel, normal;
  Vector3 point;
};

// Add the points where the visible outline crosses lines at an angle of at least 45 degrees.
inline void add_points(const Lines& lines, const Outline& outline, const Camera& camera, std::vector<OutlinePoint>& points) {
  const Grid& grid = lines.grid;
  const double limit = grid.extent - 0.5;
  const auto add = [&](int line, const Crossing& crossing, double inwards) {
    const Piece& piece = outline.pieces[crossing.piece];
    if (!(crossing.along > -0.5 && crossing.along < limit) || outline.on_near_plane(piece)) return;
    const double from = grid.across(piece.from), to = grid.across(piece.to), place = grid.place_of(line);
    const double slope = (grid.along(piece.to) - grid.along(piece.from)) / (to - from);
    if (grid.vertical ? std::abs(slope) >= 1.0 : std::abs(slope) > 1.0) return;
    const double share = std::clamp((place - from) / (to - from), 0.0, 1.0);
    const double outwards = -inwards / grid.per_pixel;
    const double along = outwards, across = -outwards * slope;
    const Outline::SurfacePoint surface = outline.surface_point(piece, share);
    Vector2 pixel = grid.vertical ? Vector2{place, crossing.along} : Vector2{crossing.along, place};
    if (!camera.is_pinhole()) pixel = camera.pixel(surface.undistorted);  // the piece is straight, the image is not
    const Vector2 normal = grid.vertical ? Vector2{across, along} : Vector2{along, across};
    points.push_back({surface.link, pixel, normal, surface.point});
  };
  // Gaps and spans that are shorter than kClose may come from crossings in the wrong order.
  int line_of_span = -1;
  const Crossing *start = nullptr, *end = nullptr;
  const auto finish = [&] {
    if (start == nullptr || end->along - start->along < kClose) return;
    add(line_of_span, *start, 1.0);
    add(line_of_span, *end, -1.0);
  };
  lines.each_span([&](int line, const Crossing& first, const Crossing& last) {
    if (start != nullptr && line == line_of_span && first.along - end->along < kClose) {
      end = &last;
      return;
    }
    finish();
    line_of_span = line, start = &first, end = &last;
  });
  finish();
}

}  // namespace kernel
