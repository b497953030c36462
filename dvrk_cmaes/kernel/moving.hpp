// How points that are fixed on an instrument move in the image with its pose and joints.
#pragma once

#include <algorithm>
#include <array>

#include "camera.hpp"
#include "mesh.hpp"

namespace kernel {

// An instrument at one pose: camera_from_root (4, 4), root_from_link (L, 4, 4), and the derivatives of the latter by the
// joints, (J, L, 4, 4).
struct Placed {
  const double* camera_from_root;
  const double* root_from_link;
  const double* by_joint;
  int links, joints;
};

// Where a point of a link is, and its displacement along a direction in the image, times the direction's length, by
// the small changes [tx ty tz rx ry rz, joints] of the pose, the first six in the root's own axes: `jacobian` (6 + J,).
struct Moved {
  double depth;
  Vector2 pixel;
};

inline Moved move_point(const Camera& camera, const Placed& at, Index link, const Vector3& point, Vector2 direction,
                        double* jacobian) {
  const Vector3 in_root = Pose{at.root_from_link + 16 * link}.apply(point);
  const double* pose = at.camera_from_root;
  const Vector3 seen = Pose{pose}.apply(in_root);
  const double z = std::max(seen[2], kNear);  // points that are nearer, or behind, are taken to be this far away
  const Vector2 undistorted = {seen[0] / z, seen[1] / z};
  const Lens::Linear lens = camera.lens.linear(undistorted);
  const double a = direction[0] * camera.fx, b = direction[1] * camera.fy;
  const double gx = (a * lens.jacobian[0] + b * lens.jacobian[2]) / z;
  const double gy = (a * lens.jacobian[1] + b * lens.jacobian[3]) / z;
  const double gz = -(gx * undistorted[0] + gy * undistorted[1]);
  // the gradient by the point's place in the root's axes
  const Vector3 g = {gx * pose[0] + gy * pose[4] + gz * pose[8], gx * pose[1] + gy * pose[5] + gz * pose[9],
                     gx * pose[2] + gy * pose[6] + gz * pose[10]};
  for (int k = 0; k < 3; ++k) jacobian[k] = g[k];
  jacobian[3] = in_root[1] * g[2] - in_root[2] * g[1];
  jacobian[4] = in_root[2] * g[0] - in_root[0] * g[2];
  jacobian[5] = in_root[0] * g[1] - in_root[1] * g[0];
  for (int joint = 0; joint < at.joints; ++joint) {
    const Vector3 by = Pose{at.by_joint + 16 * (std::size_t(joint) * at.links + link)}.apply(point);
    jacobian[6 + joint] = g[0] * by[0] + g[1] * by[1] + g[2] * by[2];
  }
  return {seen[2], {camera.fx * lens.value[0] + camera.cx, camera.fy * lens.value[1] + camera.cy}};
}

}  // namespace kernel
