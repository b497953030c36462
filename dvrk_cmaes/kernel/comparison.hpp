// A silhouette compared with a mask: the robust loss of the difference of the images, and its approximation near the pose.
//
// Both images are blurred. The difference, silhouette less mask, is sampled along the normals of the outline: if a point
// of the outline moves outwards by e px, the difference s px outside its present place grows by e times the density at s
// of the normal distribution whose standard deviation is that of the blur.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "blurred.hpp"
#include "dense.hpp"
#include "moving.hpp"
#include "silhouette.hpp"

namespace kernel {

// Natural logarithm of x >= 1, by sqrt(1/2) <= m < sqrt(2) with x = m 2^e and the series of log((1 + s) / (1 - s)).
inline double logarithm(double x) {
  int exponent;
  double m = std::frexp(x, &exponent);
  if (m < 0.70710678118654752) m *= 2.0, --exponent;
  const double s = (m - 1.0) / (m + 1.0), square = s * s;
  double sum = 0.0;
  for (int k = 21; k >= 1; k -= 2) sum = 1.0 / k + square * sum;
  return 2.0 * s * sum + exponent * 0.69314718055994531;
}

// The mask with which silhouettes are compared, blurred, and the weights (H, W) of its pixels.
struct Target {
  Blurred mask;
  std::vector<float> taps, weight;
  bool weighted = false;  // whether any weight is not 1
  int reach;              // px along the normals, up to which differences are sampled

  const float* weights(int row) const { return weight.data() + std::size_t(mask.width()) * row; }
};

// Cauchy loss of a difference of images, c^2 sum w log(1 + (r / c)^2); a sum of squares for small differences. Factors of
// weight 1 are multiplied before their logarithm is taken.
inline double cauchy_loss(const Blurred& image, const Target& target, double cauchy) {
  const double scale = 1.0 / (cauchy * cauchy);
  double sum = 0.0, product = 1.0;
  for (int row = 0; row < image.height(); ++row) {
    const float *drawn = image.row(row), *mask = target.mask.row(row), *weight = target.weights(row);
    const auto add = [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const float difference = drawn[i] - mask[i];
        if (difference == 0.0f || weight[i] == 0.0f) continue;
        const double factor = 1.0 + scale * (double(difference) * difference);
        if (weight[i] != 1.0f) {
          sum += weight[i] * logarithm(factor);
          continue;
        }
        product *= factor;
        if (product > 1e200) sum += logarithm(product), product = 1.0;
      }
    };
    // outside of both bands the images are constant up to the next band
    const auto add_constant = [&](int begin, int end) {
      if (begin >= end || drawn[begin] == mask[begin]) return;
      const double difference = double(drawn[begin]) - mask[begin];
      if (target.weighted)
        add(begin, end);
      else
        sum += (end - begin) * logarithm(1.0 + scale * (difference * difference));
    };
    int done = 0;
    image.band.each_of_both(row, target.mask.band, [&](int begin, int end) {
      add_constant(done, begin), add(begin, end);
      done = end;
    });
    add_constant(done, image.width());
  }
  return cauchy * cauchy * (sum + logarithm(product));
}

// A bilinear interpolation between pixels, those at the border being beyond it, too.
struct Between {
  std::size_t column, row, right, below;
  double x, y;

  Between(int width, int height, double u, double v) {
    u = within(u, 0.0, width - 1.0), v = within(v, 0.0, height - 1.0);
    column = std::min(static_cast<int>(u), std::max(width - 2, 0)),
    row = std::min(static_cast<int>(v), std::max(height - 2, 0));
    right = column + 1 < std::size_t(width), below = row + 1 < std::size_t(height);
    x = u - column, y = v - row;
  }

  float of(const float* image, std::size_t stride) const {
    const float* at = image + stride * row + column;
    const double top = at[0] + x * (double(at[right]) - at[0]);
    at += stride * below;
    const double bottom = at[0] + x * (double(at[right]) - at[0]);
    return static_cast<float>(top + y * (bottom - top));
  }
};

// What was found by a comparison: the losses, and, if asked for, N points of the outline, sorted by link, with the
// samples along their normals, (N, K): differences, and px of outline that each stands for; and the Jacobians (N, D) of
// the displacements of the points along the unit normals, px.
struct Comparison {
  std::vector<double> losses;
  bool outlined = false, differenced = false;  // whether there are points, and their derivatives are by differences
  int samples = 0, unknowns = 0;
  std::vector<OutlinePoint> points;
  std::vector<float> difference, share;
  std::vector<double> jacobian;
  std::vector<Run> runs;  // of the coverage, and their numbers by row
  std::vector<Index> first;
};

// The Jacobians (N, D) of the displacements of points along their unit normals, px.
inline std::vector<double> jacobian_of(const Camera& camera, const Placed& at, const std::vector<OutlinePoint>& points) {
  const std::size_t unknowns = 6 + at.joints;
  std::vector<double> rows(unknowns * points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector2& normal = points[i].normal;
    const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1]);
    move_point(camera, at, points[i].link, points[i].point, {normal[0] / length, normal[1] / length},
               rows.data() + unknowns * i);
  }
  return rows;
}

inline void add_samples(const Blurred& image, const Target& target, const Camera& camera, const Placed& at,
                        Comparison& found) {
  const int width = image.width(), height = image.height();
  const std::size_t count = found.points.size(), samples = 2 * std::size_t(target.reach) + 1;
  found.samples = static_cast<int>(samples), found.unknowns = 6 + at.joints;
  found.difference.resize(count * samples), found.share.resize(count * samples);
  found.jacobian = jacobian_of(camera, at, found.points);
  for (std::size_t i = 0; i < count; ++i) {
    const OutlinePoint& point = found.points[i];
    const Vector2& normal = point.normal;
    const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1]);
    for (std::size_t k = 0; k < samples; ++k) {
      const double off = (double(k) - target.reach) / length;
      const Between place(width, height, point.pixel[0] + off * normal[0], point.pixel[1] + off * normal[1]);
      found.difference[samples * i + k] =
          place.of(image.row(0), image.stride()) - place.of(target.mask.row(0), target.mask.stride());
      const float weight = target.weighted ? place.of(target.weight.data(), width) : 1.0f;
      found.share[samples * i + k] = float(length) * weight;
    }
  }
}

// What a point of an outline adds to the information about its displacement, px, and to the slope of half the robust loss,
// at a displacement.
struct Pull {
  double across, along;
};

inline Pull pull(const Comparison& at, std::size_t i, double moved, const std::vector<double>& density, double scale) {
  const int K = at.samples;
  const float *difference = at.difference.data() + K * i, *share = at.share.data() + K * i;
  Pull found{0.0, 0.0};
  for (int k = 0; k < K; ++k) {
    const double r = difference[k] + moved * density[k];
    const double w = share[k] / (1.0 + scale * r * r) * density[k];
    found.across += w * density[k];
    found.along += w * r;
  }
  return found;
}

// Adds to the information (D, D), of which the lower half is used, and the slope (D,) of half the robust loss after a
// small change (D,) of the pose, times a factor.
inline void add_normal_equations(const Comparison& at, const std::vector<double>& density, double cauchy, double factor,
                                 const double* change, double* information, double* slope) {
  const int D = at.unknowns;
  const double scale = 1.0 / (cauchy * cauchy);
  for (std::size_t i = 0; i < at.points.size(); ++i) {
    const double* row = at.jacobian.data() + D * i;
    double moved = 0.0;
    for (int d = 0; d < D; ++d) moved += row[d] * change[d];
    auto [across, along] = pull(at, i, moved, density, scale);
    if (across == 0.0) continue;
    across *= factor, along *= factor;
    for (int a = 0; a < D; ++a) {
      const double left = across * row[a];
      slope[a] += along * row[a];
      for (int b = 0; b <= a; ++b) information[D * a + b] += left * row[b];
    }
  }
}

// The largest displacement, px, of a point of the outline by a small change.
inline double largest_displacement(const Comparison& at, const double* change) {
  double largest = 0.0;
  for (std::size_t i = 0; i < at.points.size(); ++i) {
    double moved = 0.0;
    for (int d = 0; d < at.unknowns; ++d) moved += at.jacobian[at.unknowns * i + d] * change[d];
    largest = std::max(largest, std::abs(moved));
  }
  return largest;
}

// How a sum of terms is made small: at most so many steps, up to one whose squared length in standard deviations is below
// `solved`. Without damping, `least` of each diagonal element and of the largest one is added, so that the information is
// invertible. A change moves no point of an outline by more than `farthest` px.
struct Minimisation {
  int iterations;
  double solved, least_of_each, least_of_largest, farthest;
};

// Find the small change (D,) that minimises a quadratic term plus those of several outlines, each times its factor.
// `damping` times the diagonal of the information at no change, if it is not negative, keeps the change small.
template <class AddOutlines>
void minimise(const Minimisation& how, const double* information, const double* slope, double damping,
              const AddOutlines& add_outlines, std::vector<double>& change) {
  const std::size_t D = change.size();
  std::vector<double> full(D * D), step(D), held(D);
  for (int iteration = 0; iteration < how.iterations; ++iteration) {
    std::fill(full.begin(), full.end(), 0.0), std::fill(step.begin(), step.end(), 0.0);
    add_outlines(change.data(), full.data(), step.data());
    double largest = 1.0;
    for (std::size_t a = 0; a < D; ++a) {
      for (std::size_t b = 0; b < a; ++b) full[D * b + a] = full[D * a + b];
    }
    for (std::size_t a = 0; a < D; ++a) {
      step[a] += slope[a];
      for (std::size_t b = 0; b < D; ++b) {
        full[D * a + b] += information[D * a + b];
        step[a] += information[D * a + b] * change[b];
      }
      largest = std::max(largest, full[D * a + a]);
    }
    for (std::size_t a = 0; a < D; ++a) {
      double& diagonal = full[D * a + a];
      const double least = how.least_of_each * diagonal + how.least_of_largest * largest;
      if (iteration == 0) held[a] = damping >= 0.0 ? damping * (diagonal + 1e-9) : least;
      diagonal += held[a];
      step[a] = -step[a] - held[a] * change[a];
    }
    const std::vector<double> right = step;  // the square of the step is its product with this
    solve(full.data(), step.data(), D, 1);
    double square = 0.0;
    for (std::size_t a = 0; a < D; ++a) change[a] += step[a], square += step[a] * right[a];
    if (square < how.solved) break;
  }
}

}  // namespace kernel
