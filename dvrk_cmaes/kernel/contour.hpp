// The contour of a rough mask beside an outline: errors of points near each other are correlated.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "comparison.hpp"
#include "straight.hpp"

namespace kernel {

// How the errors of a contour are weighed. The contour is searched up to `reach` px from the outline; `least` points are
// needed. Their standard deviation is `normal_median` times the median error, at least `least_sigma` px; those beyond `clip`
// of it do not count. A share `correlated` of the variance has a correlation exp(-pi (d / length)^2) at a distance of d px,
// up to `farthest`; per px of outline, the rest is as large as `length` px of it. `grid`, px^2, is the variance of the
// quantisation to pixels. Variances are multiplied by `inflation`.
struct ContourErrors {
  int reach, least;
  double normal_median, least_sigma, clip, correlated, length, farthest, grid, inflation;
};

// A mask (H, W) and weights of its pixels, 0 for those that are ignored.
struct ContourMask {
  const bool* inside;
  const float* weight;
  int width, height;

  // The distance, px, from a point of an outline outwards to the mask's contour, searched along the row, or along the column
  // where the outline is flat; NaN if there is none within reach.
  double distance(const OutlinePoint& at, double length, int reach) const {
    const bool vertical = std::abs(at.normal[0]) < std::abs(at.normal[1]);
    const double along = at.pixel[vertical], across = at.pixel[!vertical];
    const int extent = vertical ? height : width, lines = vertical ? width : height;
    const int line = int(within(std::nearbyint(across), 0.0, lines - 1.0)), middle = int(std::floor(along));
    const int outwards = at.normal[vertical] > 0.0 ? 1 : -1;
    const auto pixel = [&](int i) { return int(vertical ? inside[width * i + line] : inside[width * line + i]); };
    double nearest = std::nan("");
    for (int i = std::max(middle - reach, 0); i <= std::min(middle + reach, extent - 2); ++i) {
      const double off = i + 0.5 - along;
      if (pixel(i + 1) - pixel(i) == -outwards && !(std::abs(off) >= std::abs(nearest))) nearest = off;
    }
    return nearest * outwards / length;
  }
};

// A point of a contour: its place, px, the variance of its uncorrelated error, px^2, and its Jacobian and error, (D + 1,).
struct ContourPoint {
  Vector2 pixel;
  double variance, along;
  std::vector<double> values;
};

// Adds to the lower half of `sum` (K, K) the products of the points' K values, weighed by the inverse of their covariance,
// of which `variance` is that of the correlated errors. The points are sorted along the contour's longest extent, so that
// the covariance is banded, and it is eliminated row by row.
inline void add_weighed(std::vector<ContourPoint>& points, double variance, const ContourErrors& how,
                        std::vector<double>& sum) {
  double u = 0.0, v = 0.0, uu = 0.0, uv = 0.0, vv = 0.0;
  for (const ContourPoint& one : points) u += one.pixel[0] / points.size(), v += one.pixel[1] / points.size();
  for (const ContourPoint& one : points) {
    const double across = one.pixel[0] - u, down = one.pixel[1] - v;
    uu += across * across, uv += across * down, vv += down * down;
  }
  const Vector2 axis = principal_axis(uu, uv, vv);
  for (ContourPoint& one : points) one.along = one.pixel[0] * axis[0] + one.pixel[1] * axis[1];
  std::stable_sort(points.begin(), points.end(), [](const auto& a, const auto& b) { return a.along < b.along; });
  const double scale = -3.14159265358979323846 / (how.length * how.length), limit = how.farthest * how.farthest;
  std::vector<std::vector<double>> rows(points.size());  // from the diagonal on
  for (std::size_t i = 0; i < points.size(); ++i) {
    const ContourPoint& one = points[i];
    for (std::size_t j = i; j < points.size() && points[j].along - one.along < how.farthest; ++j) {
      const double across = points[j].pixel[0] - one.pixel[0], down = points[j].pixel[1] - one.pixel[1];
      const double square = across * across + down * down;
      rows[i].push_back(square < limit ? variance * exponential(scale * square) : 0.0);
    }
    rows[i][0] += one.variance;
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::vector<double>&row = rows[i], &values = points[i].values;
    const std::size_t K = values.size();
    for (std::size_t a = 0; a < K; ++a) {
      const double left = values[a] / row[0];
      for (std::size_t b = 0; b <= a; ++b) sum[K * a + b] += left * values[b];
    }
    for (std::size_t k = 1; k < row.size(); ++k) {
      if (row[k] == 0.0) continue;
      const double factor = row[k] / row[0];
      double *other = rows[i + k].data(), *theirs = points[i + k].values.data();
      for (std::size_t j = k; j < row.size(); ++j) other[j - k] -= factor * row[j];
      for (std::size_t d = 0; d < K; ++d) theirs[d] -= factor * values[d];
    }
  }
}

// Compare the N points of the outline of a pose, and their Jacobians (N, D) along the unit normals, with the contour of a
// mask. Writes information (D, D) and slope (D,) of half the sum of squares; returns that sum. All are zero where too few
// points have a contour within reach.
inline double contour_equations(const ContourMask& mask, const std::vector<OutlinePoint>& points,
                                const std::vector<double>& jacobian, std::size_t D, const ContourErrors& how,
                                double* information, double* slope) {
  struct Known {
    std::size_t point;
    double error, length;
  };
  std::vector<Known> known;
  std::vector<double> off;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const OutlinePoint& at = points[i];
    const double length = std::sqrt(at.normal[0] * at.normal[0] + at.normal[1] * at.normal[1]);
    const double error = mask.distance(at, length, how.reach);
    const Between place(mask.width, mask.height, at.pixel[0], at.pixel[1]);
    if (std::isnan(error) || !(place.of(mask.weight, mask.width) > 0.5f)) continue;
    known.push_back({i, error, length}), off.push_back(std::abs(error));
  }
  if (known.size() < std::size_t(how.least)) return 0.0;
  const double limit = how.clip * std::max(how.normal_median * median_of(off), how.least_sigma);
  const auto beyond = [&](const Known& one) { return std::abs(one.error) >= limit; };
  known.erase(std::remove_if(known.begin(), known.end(), beyond), known.end());
  double variance = 0.0;
  for (const Known& one : known) variance += one.error * one.error / known.size();
  variance = std::max(variance - how.grid / 2, 0.02);

  const double rest = variance * (1.0 - how.correlated) * how.length;
  std::vector<ContourPoint> used;
  for (const Known& one : known) {
    const double* row = jacobian.data() + D * one.point;
    used.push_back({points[one.point].pixel, rest + how.grid / (one.length * one.length), 0.0, {row, row + D}});
    used.back().values.push_back(one.error);
  }
  std::vector<double> sum((D + 1) * (D + 1));
  add_weighed(used, variance * how.correlated, how, sum);
  for (std::size_t a = 0; a < D; ++a) {
    for (std::size_t b = 0; b <= a; ++b) {
      information[D * a + b] = information[D * b + a] = sum[(D + 1) * a + b] / how.inflation;
    }
    slope[a] = -sum[(D + 1) * D + a] / how.inflation;
  }
  return sum.back() / how.inflation;
}

}  // namespace kernel
