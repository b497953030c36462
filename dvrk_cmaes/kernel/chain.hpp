// Forward kinematics of a tree of joints, with derivatives.
//
// The transform of a revolute joint is affine in (sin q, cos q) by Rodrigues' formula, that of a prismatic joint in q.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "camera.hpp"
#include "mesh.hpp"

namespace kernel {

// Sine and cosine: the argument less the nearest multiple of a quarter turn, which is given in two parts, then the power
// series (|r| < 0.79, error below 1e-16). Those of the C library differ between processors in the last digit.
inline std::array<double, 2> sine_and_cosine(double x) {
  const double turns = std::floor(x * 0.63661977236758134 + 0.5);
  const double r = (x - turns * 1.57079632673412561417) - turns * 6.07710050650619224932e-11, square = r * r;
  double sine = 1.0, cosine = 1.0;
  for (int k = 18; k >= 2; k -= 2) {
    sine = 1.0 - square / (k * (k + 1.0)) * sine;
    cosine = 1.0 - square / (k * (k - 1.0)) * cosine;
  }
  sine *= r;
  const int quarter = std::isfinite(r) ? static_cast<int>(turns - 4.0 * std::floor(turns / 4.0)) : 0;
  switch (quarter) {
    case 0: return {sine, cosine};
    case 1: return {cosine, -sine};
    case 2: return {-sine, -cosine};
    default: return {-cosine, sine};
  }
}

using Matrix = std::array<double, 16>;  // (4, 4), row by row

inline Matrix product(const Matrix& a, const Matrix& b) {
  Matrix out;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      double sum = a[4 * i] * b[j];
      for (int k = 1; k < 4; ++k) sum += a[4 * i + k] * b[4 * k + j];
      out[4 * i + j] = sum;
    }
  }
  return out;
}

// A joint's transform is constant + f first + g second, with f = sin q and g = cos q, or f = q and g = 1 of a sliding
// one, and q = multiplier * (value of the driver) + offset. Without a driver (-1) q is the offset.
struct ChainJoint {
  int parent;  // number of the joint whose child link is this joint's parent link; -1 for the root link
  int driver;  // number of the independent joint that determines the value
  bool sliding;
  double multiplier, offset;
  Matrix constant, first, second;
};

class Chain {
 public:
  std::vector<ChainJoint> joints;  // every parent before its children
  int independent = 0;             // number J of independent joints

  // Computes the poses of all child links in the root link at one set of values (J,), and their derivatives by these if
  // asked for.
  struct Poses {
    std::vector<Matrix> of_links, by_joints;  // K; K J, link by link
  };

  void find(const double* values, bool derivatives, Poses& poses) const {
    const std::size_t count = joints.size();
    poses.of_links.resize(count);
    poses.by_joints.assign(derivatives ? count * independent : 0, Matrix{});
    for (std::size_t i = 0; i < count; ++i) {
      const ChainJoint& joint = joints[i];
      const double q = joint.offset + (joint.driver < 0 ? 0.0 : joint.multiplier * values[joint.driver]);
      const auto [sine, cosine] = joint.sliding ? std::array{q, 1.0} : sine_and_cosine(q);
      Matrix local;
      for (int k = 0; k < 16; ++k) local[k] = joint.constant[k] + sine * joint.first[k] + cosine * joint.second[k];
      poses.of_links[i] = joint.parent < 0 ? local : product(poses.of_links[joint.parent], local);
      if (!derivatives) continue;
      Matrix* by = poses.by_joints.data() + i * independent;
      if (joint.parent >= 0) {
        const Matrix* above = poses.by_joints.data() + std::size_t(joint.parent) * independent;
        for (int j = 0; j < independent; ++j) by[j] = product(above[j], local);
      }
      if (joint.driver < 0) continue;
      const double by_first = joint.multiplier * (joint.sliding ? 1.0 : cosine);
      const double by_second = joint.sliding ? 0.0 : -joint.multiplier * sine;
      Matrix change;
      for (int k = 0; k < 16; ++k) change[k] = by_first * joint.first[k] + by_second * joint.second[k];
      if (joint.parent >= 0) change = product(poses.of_links[joint.parent], change);
      for (int k = 0; k < 16; ++k) by[joint.driver][k] += change[k];
    }
  }
};

}  // namespace kernel
