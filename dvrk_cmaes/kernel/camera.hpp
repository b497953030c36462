// A camera: projection of points in its frame, z forward, to pixels, whose centres have whole coordinates.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "lens.hpp"

namespace kernel {

using Vector3 = std::array<double, 3>;

constexpr double kNear = 1e-3;  // m along the optical axis: surfaces before this plane are not rendered

// The value between two limits that is nearest to a value; the lower one for what is not a number.
inline double within(double value, double low, double high) { return std::min(std::max(low, value), high); }

struct Camera {
  int width, height;
  double fx, fy, cx, cy;
  Lens lens;
  double bend = 0.0;  // px, by which the image of a straight line of four pixels is off its chord at most: `largest_bend`

  static constexpr int kIterations = 8;

  bool is_pinhole() const { return lens.model == Lens::Model::none; }

  Vector2 pixel(Vector2 undistorted) const {
    const Vector2 seen = lens.distort(undistorted);
    return {fx * seen[0] + cx, fy * seen[1] + cy};
  }

  // The place of a pixel before distortion, by Newton's iterations.
  Vector2 undistorted(Vector2 pixel) const {
    const Vector2 seen = {(pixel[0] - cx) / fx, (pixel[1] - cy) / fy};
    Vector2 found = seen;
    for (int k = 0; k < (is_pinhole() ? 0 : kIterations); ++k) {
      const Lens::Linear at = lens.linear(found);
      const auto& [xx, xy, yx, yy] = at.jacobian;
      const double ex = seen[0] - at.value[0], ey = seen[1] - at.value[1], determinant = xx * yy - xy * yx;
      found = {found[0] + (yy * ex - xy * ey) / determinant, found[1] + (xx * ey - yx * ex) / determinant};
    }
    return found;
  }

  // Length, px, up to which the image of a straight line is off its chord by at most `allowed`, px, anywhere in the
  // image. The off of a short chord grows with the square of its length, so one of four pixels tells.
  double straight_length(double allowed) const { return 4.0 * std::sqrt(allowed / bend); }

  // It takes as long as some silhouettes of small images, and is the same for all that a camera sees.
  double largest_bend() const {
    double most = 1e-9;
    const double step = 0.39269908169872415;  // rad, an eighth of half a turn
    for (int row = 0; row <= 16; ++row) {
      for (int column = 0; column <= 16; ++column) {
        const Vector2 middle = undistorted({-0.5 + width * column / 16.0, -0.5 + height * row / 16.0});
        const Vector2 there = pixel(middle);
        for (int turn = 0; turn < 8; ++turn) {
          const Vector2 half = {2.0 * std::cos(turn * step) / fx, 2.0 * std::sin(turn * step) / fy};
          const Vector2 a = pixel({middle[0] - half[0], middle[1] - half[1]});
          const Vector2 b = pixel({middle[0] + half[0], middle[1] + half[1]});
          const double du = b[0] - a[0], dv = b[1] - a[1];
          const double ou = there[0] - (a[0] + b[0]) / 2, ov = there[1] - (a[1] + b[1]) / 2;
          most = std::max(most, std::abs(du * ov - dv * ou) / std::sqrt(du * du + dv * dv));
        }
      }
    }
    return most;
  }
};

// The first three rows of a rigid transform (4, 4) in row-major order.
struct Pose {
  const double* m;

  Vector3 apply(const Vector3& p) const {
    return {m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3], m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7],
            m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]};
  }
  double depth(const Vector3& p) const { return m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]; }
  // The origin of the target's frame in the source's: -R^T t.
  Vector3 centre() const {
    return {-(m[0] * m[3] + m[4] * m[7] + m[8] * m[11]), -(m[1] * m[3] + m[5] * m[7] + m[9] * m[11]),
            -(m[2] * m[3] + m[6] * m[7] + m[10] * m[11])};
  }
};

}  // namespace kernel
