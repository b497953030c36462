// The robust loss of a difference of images: its value, and its approximation near an outline.
//
// The residual image, blurred coverage less blurred mask, is sampled along the normals of an outline. If a point of the
// outline moves outwards by e px, the residual s px outside its present place grows by e times the density at s of the
// normal distribution whose standard deviation is that of the blur (`density` below).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "camera.hpp"

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

// Cauchy loss of a residual image, cauchy^2 sum w log(1 + (r / cauchy)^2), r = image - target; a sum of squares for
// small residuals. Most pixels have none. Factors of equal weights are multiplied before their logarithm is taken.
inline double cauchy_loss(const float* image, const float* target, const float* weight, std::size_t pixels,
                          double cauchy) {
  const double scale = 1.0 / (cauchy * cauchy);
  double sum = 0.0, product = 1.0;
  for (std::size_t i = 0; i < pixels; ++i) {
    const float difference = image[i] - target[i];
    if (difference == 0.0f || weight[i] == 0.0f) continue;
    const double factor = 1.0 + scale * (double(difference) * difference);
    if (weight[i] != 1.0f) {
      sum += weight[i] * logarithm(factor);
      continue;
    }
    product *= factor;
    if (product > 1e200) sum += logarithm(product), product = 1.0;
  }
  return cauchy * cauchy * (sum + logarithm(product));
}

// Bilinear interpolation of an image (height, width); pixels beyond its border are those at the border.
inline float sample(const float* image, int width, int height, double u, double v) {
  u = within(u, 0.0, width - 1.0), v = within(v, 0.0, height - 1.0);
  const int column = std::min(static_cast<int>(u), std::max(width - 2, 0));
  const int row = std::min(static_cast<int>(v), std::max(height - 2, 0));
  const int right = std::min(column + 1, width - 1) - column, below = std::min(row + 1, height - 1) - row;
  const float* at = image + std::size_t(width) * row + column;
  const double x = u - column, y = v - row;
  const double top = at[0] + x * (double(at[right]) - at[0]);
  at += std::size_t(width) * below;
  const double bottom = at[0] + x * (double(at[right]) - at[0]);
  return static_cast<float>(top + y * (bottom - top));
}

// Samples along the normals of one outline of N points: residuals and weights (N, K), Jacobians (N, D) of the
// displacements along the unit normals, px.
struct Profiles {
  const float *residual, *weight;
  const double* jacobian;
  std::size_t points;
  int samples, unknowns;
};

// Information (D, D) and slope (D,) of half the robust loss after a small change (D,).
inline void normal_equations(const Profiles& profiles, const double* density, double cauchy, const double* change,
                             double* information, double* slope) {
  const int D = profiles.unknowns, K = profiles.samples;
  const double scale = 1.0 / (cauchy * cauchy);
  std::fill(information, information + D * D, 0.0);
  std::fill(slope, slope + D, 0.0);
  for (std::size_t i = 0; i < profiles.points; ++i) {
    const float *residual = profiles.residual + K * i, *weight = profiles.weight + K * i;
    const double* row = profiles.jacobian + D * i;
    double moved = 0.0, across = 0.0, along = 0.0;
    for (int d = 0; d < D; ++d) moved += row[d] * change[d];
    for (int k = 0; k < K; ++k) {
      const double r = residual[k] + moved * density[k];
      const double w = weight[k] / (1.0 + scale * r * r) * density[k];
      across += w * density[k];
      along += w * r;
    }
    if (across == 0.0) continue;
    for (int a = 0; a < D; ++a) {
      const double left = across * row[a];
      slope[a] += along * row[a];
      for (int b = 0; b <= a; ++b) information[D * a + b] += left * row[b];
    }
  }
  for (int a = 0; a < D; ++a) {
    for (int b = 0; b < a; ++b) information[D * b + a] = information[D * a + b];
  }
}

}  // namespace kernel
