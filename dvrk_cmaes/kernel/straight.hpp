// Straight lines along a contour: robust fits to the points near a first guess.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "mesh.hpp"

namespace kernel {

// A line a u + b v + c = 0 in an image, (a, b) of unit length pointing out of the mask.
using Line = std::array<double, 3>;

// N points of a contour, (N, 2) px, with unit normals (N, 2).
struct ContourPoints {
  const double *points, *normals;
  std::size_t count;

  double away(std::size_t i, const Line& line) const {
    return points[2 * i] * line[0] + points[2 * i + 1] * line[1] + line[2];
  }
  double along(std::size_t i, const Line& line) const { return points[2 * i + 1] * line[0] - points[2 * i] * line[1]; }
  double facing(std::size_t i, const Line& line) const { return normals[2 * i] * line[0] + normals[2 * i + 1] * line[1]; }
};

// e^x for x <= 0: with x = r + k log 2 and |r| <= log(2) / 2, the series of e^r times 2^k.
inline double exponential(double x) {
  const double k = std::floor(x * 1.4426950408889634 + 0.5);
  const double r = (x - k * 0.693147180369123816490) - k * 1.90821492927058770002e-10;
  constexpr double kInverse[] = {1.0 / 13, 1.0 / 12, 1.0 / 11, 1.0 / 10, 1.0 / 9, 1.0 / 8, 1.0 / 7,
                                 1.0 / 6,  1.0 / 5,  1.0 / 4,  1.0 / 3,  1.0 / 2, 1.0};
  double sum = 1.0;
  for (const double inverse : kInverse) sum = 1.0 + r * inverse * sum;
  return std::ldexp(sum, static_cast<int>(k));
}

// The support of a line: the sum of the weights exp(-z^2 / 2) of points whose distance is z standard deviations of `sigma`
// px and whose normals have at least the cosine `facing` with the line's; and the weighted mean of these points, px.
struct Support {
  double sum;
  std::array<double, 2> middle;
};

inline Support support_of(const ContourPoints& contour, const Line& line, double sigma, double facing) {
  constexpr double kFarthest = 9.0;  // standard deviations, beyond which a weight is lost in rounding
  Support found{0.0, {0.0, 0.0}};
  const double farthest = kFarthest * sigma;
  for (std::size_t i = 0; i < contour.count; ++i) {
    const double away = contour.away(i, line);
    if (!(std::abs(away) < farthest) || contour.facing(i, line) < facing) continue;
    const double z = away / sigma, weight = exponential(-0.5 * z * z);
    found.sum += weight;
    for (int k = 0; k < 2; ++k) found.middle[k] += weight * contour.points[2 * i + k];
  }
  for (double& part : found.middle) part /= std::max(found.sum, 1e-9);
  return found;
}

// The unit vector along the largest extent of points with second moments uu, uv, vv. Its angle is half that of (uu - vv, 2
// uv).
inline std::array<double, 2> principal_axis(double uu, double uv, double vv) {
  const double length = std::sqrt((uu - vv) * (uu - vv) + 4.0 * uv * uv);
  const double twice = length > 0.0 ? (uu - vv) / length : 1.0;
  return {std::sqrt(std::max((1.0 + twice) / 2.0, 0.0)), std::copysign(std::sqrt(std::max((1.0 - twice) / 2.0, 0.0)), uv)};
}

// How lines are fitted: points count up to `near` standard deviations of `sigma` px, whose normals have at least the
// cosine `facing` with the line's, on the longest stretch without a larger gap than `gap` px. Each of the `iterations`
// needs `least` points; then sigma is that of the points, between `least_sigma` and `sigma`, and points count up to
// `reach` times that, at least `least_reach` px.
struct LineFit {
  double sigma, near, facing, gap, least_sigma, reach, least_reach, normal_median;
  int iterations, least;
};

// The points near a line, in their order along it.
inline std::vector<Index> on_line(const ContourPoints& contour, const Line& line, double reach, const LineFit& how) {
  std::vector<Index> found;
  for (std::size_t i = 0; i < contour.count; ++i) {
    if (std::abs(contour.away(i, line)) < reach && contour.facing(i, line) > how.facing) found.push_back(Index(i));
  }
  const auto along = [&](Index i) { return contour.along(i, line); };
  std::stable_sort(found.begin(), found.end(), [&](Index a, Index b) { return along(a) < along(b); });
  std::size_t begin = 0, longest_begin = 0, longest_end = 0;
  for (std::size_t i = 1; i <= found.size(); ++i) {
    if (i < found.size() && along(found[i]) - along(found[i - 1]) <= how.gap) continue;
    if (i - begin > longest_end - longest_begin) longest_begin = begin, longest_end = i;
    begin = i;
  }
  return {found.begin() + longest_begin, found.begin() + longest_end};
}

inline double median_of(std::vector<double>& values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return values.size() % 2 ? *middle : (*std::max_element(values.begin(), middle) + *middle) / 2;
}

struct FittedLine {
  Line line;
  std::vector<Index> points;
  double sigma;
};

// Fit a line by least squares with Tukey's weights, again and again.
inline FittedLine fit_line(const ContourPoints& contour, Line line, const LineFit& how) {
  std::vector<Index> points = on_line(contour, line, how.near * how.sigma, how);
  double sigma = how.sigma;
  std::vector<double> weights, off;
  for (int iteration = 0; iteration < how.iterations; ++iteration) {
    weights.clear();
    double sum = 0.0, u = 0.0, v = 0.0, uu = 0.0, uv = 0.0, vv = 0.0;
    for (Index i : points) {
      const double share = contour.away(i, line) / (3.0 * sigma), left = std::max(1.0 - share * share, 0.0);
      weights.push_back(left * left);
      sum += weights.back();
      u += weights.back() * contour.points[2 * i], v += weights.back() * contour.points[2 * i + 1];
    }
    if (points.size() < std::size_t(how.least) || sum < 0.5 * how.least) break;
    u /= sum, v /= sum;
    for (std::size_t k = 0; k < points.size(); ++k) {
      const double du = contour.points[2 * points[k]] - u, dv = contour.points[2 * points[k] + 1] - v;
      uu += weights[k] * du * du, uv += weights[k] * du * dv, vv += weights[k] * dv * dv;
    }
    const auto [cosine, sine] = principal_axis(uu, uv, vv);
    const double side = cosine * line[1] - sine * line[0] < 0.0 ? -1.0 : 1.0;
    line = {-side * sine, side * cosine, side * (sine * u - cosine * v)};
    off.clear();
    for (Index i : points) off.push_back(std::abs(contour.away(i, line)));
    sigma = std::min(std::max(how.normal_median * median_of(off), how.least_sigma), how.sigma);
    points = on_line(contour, line, std::max(how.reach * sigma, how.least_reach), how);
  }
  return {line, std::move(points), sigma};
}

// A stretch of an outline that is straight: the numbers of its points in their order along it, and their places, px.
struct Stretch {
  std::vector<std::int64_t> points;
  std::vector<double> along;
};

// Find the stretches within `band` px of the line through a side of the outline's convex hull, from `corner` in a
// `direction` of unit length; at least `shortest` px long and without a larger gap than `gap` px. `outline` is (N, 2).
inline void add_stretches(const double* outline, std::size_t count, const std::array<double, 2>& corner,
                          const std::array<double, 2>& direction, double band, double gap, double shortest,
                          std::vector<Stretch>& found) {
  std::vector<std::pair<double, std::int64_t>> near;
  for (std::size_t i = 0; i < count; ++i) {
    const double u = outline[2 * i], v = outline[2 * i + 1];
    const double away = (u - corner[0]) * direction[1] - (v - corner[1]) * direction[0];
    if (std::abs(away) < band) near.emplace_back(u * direction[0] + v * direction[1], std::int64_t(i));
  }
  std::stable_sort(near.begin(), near.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (std::size_t begin = 0, end = 0; begin < near.size(); begin = end) {
    for (end = begin + 1; end < near.size() && !(near[end].first - near[end - 1].first > gap);) ++end;
    if (near[end - 1].first - near[begin].first < shortest) continue;
    Stretch& one = found.emplace_back();
    for (std::size_t i = begin; i < end; ++i) {
      one.points.push_back(near[i].second), one.along.push_back(near[i].first - near[begin].first);
    }
  }
}

}  // namespace kernel
