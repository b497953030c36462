// Derivatives of an outline by central differences: each unknown is changed by a step either way, the outline is drawn
// again, and its points are found on the same image lines.
#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "lines.hpp"
#include "silhouette.hpp"

namespace kernel {

constexpr double kFarthestMoved = 3.0;  // px along a line, within which a moved outline's point is the same one

// Where a line of a silhouette begins to be covered, or ends, nearest to a place, px; not a number if that is too far.
inline double nearest_boundary(const Lines& lines, int line, double place, bool is_end) {
  double found = std::numeric_limits<double>::quiet_NaN(), off = kFarthestMoved;
  bool covered = false;
  for (Index i = lines.begin[line]; i < lines.begin[line + 1]; ++i) {
    const Crossing& crossing = lines.crossings[i];
    if (crossing.covered == covered) continue;
    covered = crossing.covered;
    const double away = std::abs(crossing.along - place);
    if (covered != is_end && away < off) off = away, found = crossing.along;
  }
  return found;
}

// The places, px along their lines, of the points of an outline after it has moved; not a number of those not found.
inline std::vector<double> moved_places(const std::vector<OutlinePoint>& points, const Lines& rows, const Lines& columns) {
  std::vector<double> places(points.size(), std::numeric_limits<double>::quiet_NaN());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector2 &pixel = points[i].pixel, &normal = points[i].normal;
    const bool vertical = std::abs(normal[1]) > std::abs(normal[0]);
    const Lines& lines = vertical ? columns : rows;
    const int line = static_cast<int>(std::lround(lines.grid.line_of(lines.grid.across(pixel))));
    if (line < 0 || line >= lines.grid.count()) continue;
    places[i] = nearest_boundary(lines, line, lines.grid.along(pixel), normal[vertical] > 0.0);
  }
  return places;
}

// Write the derivatives (N, D), by one of D unknowns, of the displacements of points along their unit normals, px, from
// their places after a step forwards and backwards. A point that is found in one of them only has a one-sided
// difference; one that is in neither does not move.
inline void difference_points(const std::vector<OutlinePoint>& points, const std::vector<double>& forwards,
                              const std::vector<double>& backwards, double step, std::size_t unknown, std::size_t D,
                              std::vector<double>& jacobian) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector2 &pixel = points[i].pixel, &normal = points[i].normal;
    const bool vertical = std::abs(normal[1]) > std::abs(normal[0]);
    const double there = std::isnan(forwards[i]) ? pixel[vertical] : forwards[i];
    const double back = std::isnan(backwards[i]) ? pixel[vertical] : backwards[i];
    const int sides = !std::isnan(forwards[i]) + !std::isnan(backwards[i]);
    const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1]);
    jacobian[D * i + unknown] = sides ? (there - back) / (sides * step) * normal[vertical] / length : 0.0;
  }
}

}  // namespace kernel
