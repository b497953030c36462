// Rotations as vectors and as matrices, and small changes of rigid transforms in the body's own axes.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "chain.hpp"

namespace kernel {

// Write the rotation (3, 3) by a vector (3,), rad, by Rodrigues' formula; `stride` numbers are from row to row.
inline void rotation_by(const double* v, double* out, int stride) {
  const double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = std::sqrt(square);
  const bool small = angle < 1e-6;
  const auto [sine, cosine] = sine_and_cosine(angle);
  const double a = small ? 1.0 - square / 6.0 : sine / angle, b = small ? 0.5 - square / 24.0 : (1.0 - cosine) / square;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[stride * i + j] = b * v[i] * v[j];
    out[(stride + 1) * i] += 1.0 - b * square;
  }
  const double x = a * v[0], y = a * v[1], z = a * v[2];
  out[1] -= z, out[2] += y, out[stride] += z, out[stride + 2] -= x, out[2 * stride] -= y, out[2 * stride + 1] += x;
}

// Write the vector (3,), rad, at most half a turn long, of a rotation (3, 3): by the unit quaternion w, x, y, z, which is
// computed from its largest component.
inline void rotation_vector(const double* r, int stride, double* out) {
  const auto at = [&](int i, int j) { return r[stride * i + j]; };
  const double x = at(0, 0), y = at(1, 1), z = at(2, 2);
  const double a = at(2, 1) - at(1, 2), b = at(0, 2) - at(2, 0), c = at(1, 0) - at(0, 1);
  const double d = at(0, 1) + at(1, 0), e = at(0, 2) + at(2, 0), f = at(1, 2) + at(2, 1);
  const std::array<std::array<double, 4>, 4> rows = {
      {{1.0 + x + y + z, a, b, c}, {a, 1.0 + x - y - z, d, e}, {b, d, 1.0 - x + y - z, f}, {c, e, f, 1.0 - x - y + z}}};
  int largest = 0;
  for (int k = 1; k < 4; ++k) largest = rows[k][k] > rows[largest][largest] ? k : largest;
  const auto& q = rows[largest];
  const double length = std::sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), w = std::abs(q[0]);
  const double half = w >= length ? arc_tangent(length / w) : 1.57079632679489661923 - arc_tangent(w / length);
  // of a rotation that is all but none the vector is twice the quaternion's
  const double scale = (length < 1e-9 * w ? 2.0 / w : 2.0 * half / length) * (q[0] < 0.0 ? -1.0 : 1.0);
  for (int k = 0; k < 3; ++k) out[k] = scale * q[k + 1];
}

// Write a transform (4, 4) after the change [tx ty tz rx ry rz], m and rad, in its own axes.
inline void move_pose(const double* pose, const double* change, double* out) {
  double turn[9];
  rotation_by(change + 3, turn, 3);
  for (int i = 0; i < 4; ++i) {
    const double* row = pose + 4 * i;
    for (int j = 0; j < 3; ++j) out[4 * i + j] = row[0] * turn[j] + row[1] * turn[3 + j] + row[2] * turn[6 + j];
    out[4 * i + 3] = row[0] * change[0] + row[1] * change[1] + row[2] * change[2] + row[3];
  }
}

// Write the change (6,) by which a transform (4, 4) becomes another one.
inline void change_of_pose(const double* pose, const double* other, double* out) {
  double turn[9];
  for (int i = 0; i < 3; ++i) {
    out[i] = 0.0;
    for (int k = 0; k < 3; ++k) out[i] += pose[4 * k + i] * (other[4 * k + 3] - pose[4 * k + 3]);
    for (int j = 0; j < 3; ++j) {
      turn[3 * i + j] = pose[i] * other[j] + pose[4 + i] * other[4 + j] + pose[8 + i] * other[8 + j];
    }
  }
  rotation_vector(turn, 3, out + 3);
}

}  // namespace kernel
