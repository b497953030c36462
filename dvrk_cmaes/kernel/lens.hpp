// Lens distortion: a map of normalised image coordinates (x/z, y/z), with its derivatives.
//
// The models and their continuation beyond a circle of radius R are those of dvrk_cmaes/camera/lens.py, where they are
// explained. No function of the C library whose last digit differs between processors is used.
#pragma once

#include <array>
#include <cmath>
#include <limits>

namespace kernel {

using Vector2 = std::array<double, 2>;

// The arc tangent of x >= 0: two halvings of the angle, then the power series (|x| < 0.42, error below 1e-16).
inline double arc_tangent(double x) {
  for (int halving = 0; halving < 2; ++halving) x /= 1.0 + std::sqrt(1.0 + x * x);
  const double square = x * x;
  double sum = 0.0;
  for (int k = 41; k >= 1; k -= 2) sum = 1.0 / k - square * sum;
  return 4.0 * x * sum;
}

struct Lens {
  enum class Model { none, brown, equidistant };

  Model model = Model::none;
  std::array<double, 6> k{};  // brown: k1 k2 k3 of the numerator, k4 k5 k6 of the denominator; equidistant: k1 to k4
  Vector2 p{};                // tangential terms of brown
  double radius = std::numeric_limits<double>::infinity();

  // Value (x, y) and Jacobian (xx, xy, yx, yy).
  struct Linear {
    Vector2 value;
    std::array<double, 4> jacobian;
  };

  Vector2 distort(Vector2 at) const {
    if (model == Model::none) return at;
    double x = at[0], y = at[1];
    const double scale = std::max(std::sqrt(x * x + y * y) / radius, 1.0);
    x /= scale, y /= scale;
    const double square = x * x + y * y;
    const Vector2 seen = within(x, y, square, factor(square));
    return {seen[0] * scale, seen[1] * scale};
  }

  Linear linear(Vector2 at) const {
    if (model == Model::none) return {at, {1.0, 0.0, 0.0, 1.0}};
    double x = at[0], y = at[1];
    const double scale = std::max(std::sqrt(x * x + y * y) / radius, 1.0);
    x /= scale, y /= scale;
    const double square = x * x + y * y, radial = factor(square), slope = 2.0 * factor_slope(square, radial);
    const Vector2 seen = within(x, y, square, radial);
    const double xx = radial + x * x * slope + 2.0 * p[0] * y + 6.0 * p[1] * x;
    const double xy = x * y * slope + 2.0 * p[0] * x + 2.0 * p[1] * y;
    const double yy = radial + y * y * slope + 6.0 * p[0] * y + 2.0 * p[1] * x;
    if (scale == 1.0) return {seen, {xx, xy, xy, yy}};
    // f(x) = |x|/R g(u) with u = R x/|x|, so f' = g' + (g - g' u) u'/R^2
    const double ux = x / (radius * radius), uy = y / (radius * radius);
    const double gx = seen[0] - xx * x - xy * y, gy = seen[1] - xy * x - yy * y;
    return {{seen[0] * scale, seen[1] * scale}, {xx + gx * ux, xy + gx * uy, xy + gy * ux, yy + gy * uy}};
  }

 private:
  // Distorted / undistorted radius, without tangential distortion, of the squared undistorted radius.
  double factor(double s) const {
    if (model == Model::equidistant) {
      const double r = std::sqrt(s);
      if (r == 0.0) return 1.0;
      const double angle = arc_tangent(r), t = angle * angle;
      return angle * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))) / r;
    }
    return (1.0 + s * (k[0] + s * (k[1] + s * k[2]))) / (1.0 + s * (k[3] + s * (k[4] + s * k[5])));
  }

  double factor_slope(double s, double radial) const {
    if (model == Model::equidistant) {
      if (s == 0.0) return k[0] - 1.0 / 3.0;
      const double angle = arc_tangent(std::sqrt(s)), t = angle * angle;
      const double change = 1.0 + t * (3.0 * k[0] + t * (5.0 * k[1] + t * (7.0 * k[2] + t * 9.0 * k[3])));
      return (change / (1.0 + s) - radial) / (2.0 * s);
    }
    const double above = k[0] + s * (2.0 * k[1] + s * 3.0 * k[2]), below = k[3] + s * (2.0 * k[4] + s * 3.0 * k[5]);
    return (above - radial * below) / (1.0 + s * (k[3] + s * (k[4] + s * k[5])));
  }

  Vector2 within(double x, double y, double s, double radial) const {
    const double both = radial + 2.0 * p[1] * x + 2.0 * p[0] * y;
    return {x * both + p[1] * s, y * both + p[0] * s};
  }
};

}  // namespace kernel
