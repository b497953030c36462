// The Python module dvrk_cmaes._kernel. Shapes and indices are checked here, once; the headers rely on them.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "camera.hpp"
#include "chain.hpp"
#include "lines.hpp"
#include "mesh.hpp"
#include "moving.hpp"
#include "outline.hpp"
#include "profiles.hpp"
#include "silhouette.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace kernel {
namespace {

template <class T>
using Given = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using Made = nb::ndarray<nb::numpy, T>;

constexpr long kAny = -1;

// Refuse an array whose shape is not the expected one; `kAny` stands for any length.
template <class Array>
void check_shape(const char* name, const Array& array, std::initializer_list<long> expected) {
  bool right = array.ndim() == expected.size();
  std::size_t axis = 0;
  for (long length : expected) {
    if (right && length != kAny && static_cast<long>(array.shape(axis)) != length) right = false;
    ++axis;
  }
  if (right) return;
  const auto listed = [](std::size_t count, const auto& length_of) {
    std::string text = "(";
    for (std::size_t i = 0; i < count; ++i) text += (i ? ", " : "") + length_of(i);
    return text + ")";
  };
  const std::vector<long> lengths(expected);
  const std::string wanted =
      listed(lengths.size(), [&](std::size_t i) { return lengths[i] == kAny ? "N" : std::to_string(lengths[i]); });
  const std::string got = listed(array.ndim(), [&](std::size_t i) { return std::to_string(array.shape(i)); });
  throw std::invalid_argument(std::string(name) + ": expected an array " + wanted + ", got " + got);
}

void check_finite(const char* name, const double* values, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    if (!std::isfinite(values[i])) throw std::invalid_argument(std::string(name) + ": expected finite numbers");
  }
}

void check_positive(const char* name, long value) {
  if (value < 1) throw std::invalid_argument(std::string(name) + ": expected a positive number");
}

// A new array of zeros, which owns its memory.
template <class T>
Made<T> zeros(std::initializer_list<std::size_t> shape) {
  std::size_t count = 1;
  for (std::size_t length : shape) count *= length;
  T* data = new T[std::max<std::size_t>(count, 1)]();
  nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
  return Made<T>(data, shape.size(), shape.begin(), owner);
}

struct Workspace {
  Outline outline;
  Lines rows, columns;
  std::vector<std::int32_t> change;
};

// Call `work(workspace, i)` for i from 0 to count - 1 in threads. Each index writes to places of its own, so results do
// not depend on the number of threads.
template <class Work>
void each_pose(std::size_t count, std::size_t threads, const Work& work) {
  threads = std::max<std::size_t>(std::min(threads, count), 1);
  std::vector<std::exception_ptr> errors(threads);
  const auto part = [&](std::size_t number) {
    try {
      thread_local Workspace workspace;
      for (std::size_t i = count * number / threads; i < count * (number + 1) / threads; ++i) work(workspace, i);
    } catch (...) {
      errors[number] = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  for (std::size_t number = 1; number < threads; ++number) others.emplace_back(part, number);
  part(0);
  for (std::thread& other : others) other.join();
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

Camera make_camera(int width, int height, double fx, double fy, double cx, double cy, const std::string& model,
                   const std::vector<double>& coefficients, double radius) {
  check_positive("width", width), check_positive("height", height);
  if (width > (1 << 14) || height > (1 << 14)) throw std::invalid_argument("image size: expected at most 16384 pixels");
  for (double value : {fx, fy, cx, cy}) check_finite("camera", &value, 1);
  check_finite("coefficients", coefficients.data(), coefficients.size());
  Lens lens;
  if (model == "equidistant") {
    if (coefficients.size() != 4) throw std::invalid_argument("coefficients: expected 4 of the equidistant model");
    lens.model = Lens::Model::equidistant;
    std::copy(coefficients.begin(), coefficients.end(), lens.k.begin());
  } else if (!coefficients.empty()) {
    if (coefficients.size() != 4 && coefficients.size() != 5 && coefficients.size() != 8) {
      throw std::invalid_argument("coefficients: expected 4, 5 or 8 in OpenCV's order");
    }
    lens.model = Lens::Model::brown;
    std::vector<double> c = coefficients;
    c.resize(8, 0.0);
    lens.k = {c[0], c[1], c[4], c[5], c[6], c[7]};
    lens.p = {c[2], c[3]};
  }
  if (!(radius > 0.0)) throw std::invalid_argument("radius: expected a positive number");
  lens.radius = radius;
  return {width, height, fx, fy, cx, cy, lens};
}

Mesh make_mesh(const std::vector<std::tuple<Given<double>, Given<Index>>>& links) {
  Mesh mesh;
  for (const auto& [vertices, faces] : links) {
    check_shape("vertices", vertices, {kAny, 3}), check_shape("faces", faces, {kAny, 3});
    if (vertices.shape(0) == 0) throw std::invalid_argument("vertices: expected at least one of each link");
    check_finite("vertices", vertices.data(), vertices.size());
    for (std::size_t i = 0; i < faces.size(); ++i) {
      const Index corner = faces.data()[i];
      if (corner < 0 || static_cast<std::size_t>(corner) >= vertices.shape(0)) {
        throw std::invalid_argument("faces: expected indices of the link's vertices, got " + std::to_string(corner));
      }
    }
    if (mesh.vertices.size() + vertices.shape(0) > 1u << 30 || mesh.faces.size() + faces.shape(0) > 1u << 29) {
      throw std::invalid_argument("links: expected fewer vertices and faces");
    }
    mesh.add(vertices.data(), vertices.shape(0), faces.data(), faces.shape(0));
  }
  return mesh;
}

Chain make_chain(const std::vector<int>& parents, const std::vector<int>& drivers, const std::vector<bool>& sliding,
                 const std::vector<double>& multipliers, const std::vector<double>& offsets,
                 const Given<double>& terms) {
  const std::size_t count = parents.size();
  check_shape("terms", terms, {static_cast<long>(count), 3, 4, 4});
  check_finite("terms", terms.data(), terms.size());
  if (drivers.size() != count || sliding.size() != count || multipliers.size() != count || offsets.size() != count) {
    throw std::invalid_argument("joints: expected as many drivers, kinds, multipliers and offsets as parents");
  }
  Chain chain;
  for (std::size_t i = 0; i < count; ++i) {
    if (parents[i] < -1 || parents[i] >= static_cast<int>(i)) {
      throw std::invalid_argument("parents: expected every parent before its children");
    }
    if (drivers[i] < -1 || drivers[i] > 1000) throw std::invalid_argument("drivers: expected numbers of joints, or -1");
    ChainJoint joint{parents[i], drivers[i], bool(sliding[i]), multipliers[i], offsets[i], {}, {}, {}};
    const double* from = terms.data() + 48 * i;
    std::copy(from, from + 16, joint.constant.begin());
    std::copy(from + 16, from + 32, joint.first.begin());
    std::copy(from + 32, from + 48, joint.second.begin());
    chain.joints.push_back(joint);
    chain.independent = std::max(chain.independent, drivers[i] + 1);
  }
  return chain;
}

using Forward = std::tuple<Made<double>, std::optional<Made<double>>>;

Forward forward(const Chain& chain, const Given<double>& values, const std::vector<int>& selected, bool derivatives) {
  check_shape("values", values, {kAny, kAny});
  const std::size_t rows = values.shape(0), joints = values.shape(1), links = selected.size();
  if (static_cast<int>(joints) < chain.independent) throw std::invalid_argument("values: expected one of each joint");
  for (int link : selected) {
    if (link < -1 || link >= static_cast<int>(chain.joints.size())) {
      throw std::invalid_argument("selected: expected numbers of joints, or -1, got " + std::to_string(link));
    }
  }
  Made<double> poses = zeros<double>({rows, links, 4, 4});
  std::optional<Made<double>> by_joint;
  if (derivatives) by_joint = zeros<double>({rows, joints, links, 4, 4});
  const nb::gil_scoped_release released;
  Chain::Poses found;
  const Matrix identity{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  for (std::size_t row = 0; row < rows; ++row) {
    chain.find(values.data() + joints * row, derivatives, found);
    for (std::size_t k = 0; k < links; ++k) {
      const int link = selected[k];
      const Matrix& pose = link < 0 ? identity : found.of_links[link];
      std::copy(pose.begin(), pose.end(), poses.data() + 16 * (links * row + k));
      for (int j = 0; derivatives && link >= 0 && j < chain.independent; ++j) {
        const Matrix& by = found.by_joints[link * chain.independent + j];
        std::copy(by.begin(), by.end(), by_joint->data() + 16 * ((joints * row + j) * links + k));
      }
    }
  }
  return {std::move(poses), std::move(by_joint)};
}

// Decides what is covered between crossings: called with the number of the pose, whether the lines are columns, and the
// line and the place along it, px, of each crossing in order; returns whether the line is covered from each to the next.
using Decision = std::optional<nb::callable>;

// What is drawn of each pose, and how.
struct Drawing {
  const Mesh& mesh;
  const Camera& camera;
  const Given<double>& links;
  int lines_per_pixel;
  std::size_t threads;
  const Decision& decide;
  double bend;  // px, by which a piece of the outline may be off the image of a straight line

  std::size_t poses() const { return links.shape(0); }

  void check() const {
    check_shape("camera_from_link", links, {kAny, mesh.link_count(), 4, 4});
    check_finite("camera_from_link", links.data(), links.size());
    check_positive("lines_per_pixel", lines_per_pixel);
    if (lines_per_pixel >= kMostLines || lines_per_pixel * camera.height > kMostLines) {
      throw std::invalid_argument("lines_per_pixel: expected fewer lines in all");
    }
  }

  // Call `use(workspace, pose)` with the outline and the rows of each pose, without the interpreter's lock; after `check`.
  template <class Use>
  void each(const Use& use) const {
    const double straight = camera.is_pinhole() ? 0.0 : camera.straight_length(bend);
    const auto draw = [&](Workspace& at, std::size_t pose) {
      at.outline.find(mesh, camera, links.data() + 16 * mesh.link_count() * pose, straight);
      find_lines(at.rows, at.outline, Grid::rows(camera, lines_per_pixel), pose);
      use(at, pose);
    };
    if (decide) {
      each_pose(poses(), 1, draw);
      return;
    }
    nb::gil_scoped_release released;
    each_pose(poses(), poses() * mesh.edges.size() < kFewEdges ? 1 : threads, draw);
  }

  void find_lines(Lines& lines, const Outline& outline, const Grid& grid, std::size_t pose) const {
    lines.find(outline.pieces, grid);
    if (!decide) {
      lines.count_layers();
      return;
    }
    Made<Index> line = zeros<Index>({lines.crossings.size()});
    Made<double> along = zeros<double>({lines.crossings.size()});
    for (int i = 0; i < grid.count(); ++i) {
      std::fill(line.data() + lines.begin[i], line.data() + lines.begin[i + 1], i);
    }
    for (std::size_t i = 0; i < lines.crossings.size(); ++i) along.data()[i] = lines.crossings[i].along;
    const auto covered = nb::cast<nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(
        (*decide)(pose, grid.vertical, std::move(line), std::move(along)));
    check_shape("covered", covered, {static_cast<long>(lines.crossings.size())});
    for (std::size_t i = 0; i < lines.crossings.size(); ++i) lines.crossings[i].covered = covered.data()[i];
  }

 private:
  static constexpr std::size_t kFewEdges = 30000;  // of all poses; starting a thread takes as long as these
};

constexpr double kBend = 0.004, kExactBend = 0.0005;  // px; the latter where whole pixels are asked for

Made<double> sums(const Mesh& mesh, const Camera& camera, const Given<double>& links, const Given<double>& table,
                  int lines_per_pixel, bool to_pixel, std::size_t threads, const Decision& decide) {
  check_shape("table", table, {camera.height, camera.width + 1, kAny});
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, decide, to_pixel ? kExactBend : kBend};
  drawing.check();
  const std::size_t images = table.shape(2);
  Made<double> out = zeros<double>({drawing.poses(), images});
  drawing.each([&](Workspace& at, std::size_t pose) {
    double* sum = out.data() + images * pose;
    add_sums(at.rows, table.data(), static_cast<int>(images), to_pixel, sum);
    for (std::size_t k = 0; k < images; ++k) sum[k] /= lines_per_pixel;
  });
  return out;
}

Made<bool> masks(const Mesh& mesh, const Camera& camera, const Given<double>& links, std::size_t threads,
                 const Decision& decide) {
  const Drawing drawing{mesh, camera, links, 1, threads, decide, kExactBend};
  drawing.check();
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  Made<bool> out = zeros<bool>({drawing.poses(), std::size_t(camera.height), std::size_t(camera.width)});
  drawing.each([&](Workspace& at, std::size_t pose) { fill_mask(at.rows, out.data() + pixels * pose); });
  return out;
}

Made<float> coverage(const Mesh& mesh, const Camera& camera, const Given<double>& links, int lines_per_pixel,
                     std::size_t threads, const Decision& decide) {
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, decide, kBend};
  drawing.check();
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  Made<float> out = zeros<float>({drawing.poses(), std::size_t(camera.height), std::size_t(camera.width)});
  drawing.each([&](Workspace& at, std::size_t pose) { fill_coverage(at.rows, out.data() + pixels * pose, at.change); });
  return out;
}

using Outlines = std::tuple<std::optional<Made<float>>, Made<std::int64_t>, Made<std::int64_t>, Made<double>,
                            Made<double>, Made<double>>;

Outlines outlines(const Mesh& mesh, const Camera& camera, const Given<double>& links, int lines_per_pixel,
                  bool with_coverage, std::size_t threads, const Decision& decide) {
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, decide, kBend};
  drawing.check();
  const std::size_t poses = drawing.poses(), pixels = std::size_t(camera.width) * camera.height;
  std::optional<Made<float>> image;
  if (with_coverage) image = zeros<float>({poses, std::size_t(camera.height), std::size_t(camera.width)});
  std::vector<std::vector<OutlinePoint>> of_poses(poses);
  drawing.each([&](Workspace& at, std::size_t pose) {
    if (image) fill_coverage(at.rows, image->data() + pixels * pose, at.change);
    drawing.find_lines(at.columns, at.outline, Grid::columns(camera), pose);
    std::vector<OutlinePoint>& points = of_poses[pose];
    add_points(at.rows, at.outline, camera, points);
    add_points(at.columns, at.outline, camera, points);
    std::stable_sort(points.begin(), points.end(), [](const auto& a, const auto& b) { return a.link < b.link; });
  });
  Made<std::int64_t> begin = zeros<std::int64_t>({poses + 1});
  for (std::size_t i = 0; i < poses; ++i) begin.data()[i + 1] = begin.data()[i] + std::int64_t(of_poses[i].size());
  const std::size_t count = begin.data()[poses];
  Made<std::int64_t> link = zeros<std::int64_t>({count});
  Made<double> pixel = zeros<double>({count, 2}), normal = zeros<double>({count, 2}), point = zeros<double>({count, 3});
  std::size_t i = 0;
  for (const std::vector<OutlinePoint>& points : of_poses) {
    for (const OutlinePoint& each : points) {
      link.data()[i] = each.link;
      std::copy(each.pixel.begin(), each.pixel.end(), pixel.data() + 2 * i);
      std::copy(each.normal.begin(), each.normal.end(), normal.data() + 2 * i);
      std::copy(each.point.begin(), each.point.end(), point.data() + 3 * i);
      ++i;
    }
  }
  return {std::move(image), begin, link, pixel, normal, point};
}

// Refuse offsets (C + 1,) that do not divide `count` points among C poses.
std::size_t checked_poses(const Given<std::int64_t>& begin, std::size_t count) {
  check_shape("begin", begin, {kAny});
  const std::int64_t* at = begin.data();
  bool right = begin.size() > 0 && at[0] == 0 && at[begin.size() - 1] == std::int64_t(count);
  for (std::size_t i = 1; right && i < begin.size(); ++i) right = at[i] >= at[i - 1];
  if (!right) throw std::invalid_argument("begin: expected ascending offsets from 0 to the number of points");
  return begin.size() - 1;
}

std::tuple<Made<double>, Made<double>, Made<double>> move_points(
    const Camera& camera, const Given<std::int64_t>& begin, const Given<std::int64_t>& link,
    const Given<double>& points, const Given<double>& directions, const Given<double>& camera_from_root,
    const Given<double>& root_from_link, const Given<double>& by_joint) {
  check_shape("link", link, {kAny});
  const std::size_t count = link.size(), poses = checked_poses(begin, count);
  const long n = static_cast<long>(count), c = static_cast<long>(poses);
  check_shape("points", points, {n, 3}), check_shape("directions", directions, {n, 2});
  check_shape("camera_from_root", camera_from_root, {c, 4, 4});
  check_shape("root_from_link", root_from_link, {c, kAny, 4, 4});
  const std::size_t links = root_from_link.shape(1);
  check_shape("by_joint", by_joint, {c, kAny, static_cast<long>(links), 4, 4});
  const std::size_t joints = by_joint.shape(1), unknowns = 6 + joints;
  for (std::size_t i = 0; i < count; ++i) {
    if (link.data()[i] < 0 || std::size_t(link.data()[i]) >= links) {
      throw std::invalid_argument("link: expected numbers of links, got " + std::to_string(link.data()[i]));
    }
  }
  Made<double> depth = zeros<double>({count}), pixel = zeros<double>({count, 2});
  Made<double> jacobian = zeros<double>({count, unknowns});
  const nb::gil_scoped_release released;
  for (std::size_t pose = 0; pose < poses; ++pose) {
    const Placed at{camera_from_root.data() + 16 * pose, root_from_link.data() + 16 * links * pose,
                    by_joint.data() + 16 * links * joints * pose, int(links), int(joints)};
    for (std::int64_t i = begin.data()[pose]; i < begin.data()[pose + 1]; ++i) {
      const double *point = points.data() + 3 * i, *direction = directions.data() + 2 * i;
      const Moved moved = move_point(camera, at, Index(link.data()[i]), {point[0], point[1], point[2]},
                                     {direction[0], direction[1]}, jacobian.data() + unknowns * i);
      depth.data()[i] = moved.depth;
      pixel.data()[2 * i] = moved.pixel[0], pixel.data()[2 * i + 1] = moved.pixel[1];
    }
  }
  return {depth, pixel, jacobian};
}

Made<double> cauchy_losses(const std::vector<Given<float>>& images, const Given<float>& target,
                           const Given<float>& weight, double cauchy) {
  check_shape("target", target, {kAny, kAny});
  const long height = static_cast<long>(target.shape(0)), width = static_cast<long>(target.shape(1));
  check_shape("weight", weight, {height, width});
  for (const Given<float>& image : images) check_shape("images", image, {height, width});
  Made<double> out = zeros<double>({images.size()});
  const nb::gil_scoped_release released;
  for (std::size_t i = 0; i < images.size(); ++i) {
    out.data()[i] = cauchy_loss(images[i].data(), target.data(), weight.data(), target.size(), cauchy);
  }
  return out;
}

std::tuple<Made<float>, Made<float>> sample_profiles(const std::vector<Given<float>>& images,
                                                     const Given<float>& target, const Given<float>& weight,
                                                     const Given<std::int64_t>& begin, const Given<double>& pixels,
                                                     const Given<double>& normals, int reach) {
  check_shape("pixels", pixels, {kAny, 2});
  const std::size_t count = pixels.shape(0), poses = checked_poses(begin, count);
  check_shape("normals", normals, {static_cast<long>(count), 2});
  check_shape("target", target, {kAny, kAny});
  const long height = static_cast<long>(target.shape(0)), width = static_cast<long>(target.shape(1));
  check_shape("weight", weight, {height, width});
  if (width == 0 || height == 0) throw std::invalid_argument("target: expected at least one pixel");
  if (images.size() != poses) throw std::invalid_argument("images: expected one of each pose");
  for (const Given<float>& image : images) check_shape("images", image, {height, width});
  check_positive("reach", reach);
  const std::size_t samples = 2 * std::size_t(reach) + 1;
  Made<float> residual = zeros<float>({count, samples}), share = zeros<float>({count, samples});
  const nb::gil_scoped_release released;
  for (std::size_t pose = 0; pose < poses; ++pose) {
    const float* image = images[pose].data();
    for (std::int64_t i = begin.data()[pose]; i < begin.data()[pose + 1]; ++i) {
      const double *at = pixels.data() + 2 * i, *normal = normals.data() + 2 * i;
      const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1]);
      for (std::size_t k = 0; k < samples; ++k) {
        const double off = (double(k) - reach) / length;
        const double u = at[0] + off * normal[0], v = at[1] + off * normal[1];
        residual.data()[samples * i + k] =
            sample(image, int(width), int(height), u, v) - sample(target.data(), int(width), int(height), u, v);
        share.data()[samples * i + k] = float(length) * sample(weight.data(), int(width), int(height), u, v);
      }
    }
  }
  return {residual, share};
}

std::tuple<Made<double>, Made<double>> all_normal_equations(
    const Given<std::int64_t>& begin, const Given<float>& residual, const Given<float>& weight,
    const Given<double>& jacobian, const Given<double>& density, double cauchy, const Given<double>& change) {
  check_shape("residual", residual, {kAny, kAny});
  const std::size_t count = residual.shape(0), samples = residual.shape(1), poses = checked_poses(begin, count);
  const long n = static_cast<long>(count), k = static_cast<long>(samples);
  check_shape("weight", weight, {n, k}), check_shape("jacobian", jacobian, {n, kAny});
  check_shape("density", density, {k});
  const std::size_t unknowns = jacobian.shape(1);
  check_shape("change", change, {static_cast<long>(poses), static_cast<long>(unknowns)});
  Made<double> information = zeros<double>({poses, unknowns, unknowns}), slope = zeros<double>({poses, unknowns});
  const nb::gil_scoped_release released;
  for (std::size_t pose = 0; pose < poses; ++pose) {
    const std::int64_t from = begin.data()[pose];
    const Profiles profiles{residual.data() + samples * from,
                            weight.data() + samples * from,
                            jacobian.data() + unknowns * from,
                            std::size_t(begin.data()[pose + 1] - from),
                            int(samples),
                            int(unknowns)};
    normal_equations(profiles, density.data(), cauchy, change.data() + unknowns * pose,
                     information.data() + unknowns * unknowns * pose, slope.data() + unknowns * pose);
  }
  return {information, slope};
}

}  // namespace
}  // namespace kernel

NB_MODULE(_kernel, module) {
  using namespace kernel;
  // Objects that caches of the package keep until the end of the process are no leaks.
  nb::set_leak_warnings(false);
  module.doc() = "Silhouettes of an instrument for many poses: sums, masks, coverage, outlines, and their derivatives.";

  nb::class_<Camera>(module, "Camera", "A camera and the distortion of its lens.")
      .def("__init__",
           [](Camera* self, int width, int height, double fx, double fy, double cx, double cy, const std::string& model,
              const std::vector<double>& coefficients, double radius) {
             new (self) Camera(make_camera(width, height, fx, fy, cx, cy, model, coefficients, radius));
           },
           "width"_a, "height"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "model"_a, "coefficients"_a, "radius"_a,
           "Take the intrinsics, px; no coefficients of other models than equidistant are a pinhole. The model holds up "
           "to an undistorted radius.");

  nb::class_<Chain>(module, "Chain", "A tree of K joints below a root link, every parent before its children.")
      .def("__init__",
           [](Chain* self, const std::vector<int>& parents, const std::vector<int>& drivers,
              const std::vector<bool>& sliding, const std::vector<double>& multipliers,
              const std::vector<double>& offsets, const Given<double>& terms) {
             new (self) Chain(make_chain(parents, drivers, sliding, multipliers, offsets, terms));
           },
           "parents"_a, "drivers"_a, "sliding"_a, "multipliers"_a, "offsets"_a, "terms"_a,
           "Take the joints; their transforms are the sums of their terms (K, 3, 4, 4) with weights 1, sin q (or q of "
           "sliding ones) and cos q (or 1).")
      .def("forward", &forward, "values"_a, "selected"_a, "derivatives"_a,
           "Compute root_from_link (N, L, 4, 4) of selected joints' links, the root's for -1, from values (N, J), and "
           "the derivatives (N, J, L, 4, 4) or None.");

  nb::class_<Mesh>(module, "Mesh", "The meshes of the links of an instrument, with their edges.")
      .def("__init__",
           [](Mesh* self, const std::vector<std::tuple<Given<double>, Given<Index>>>& links) {
             new (self) Mesh(make_mesh(links));
           },
           "links"_a, "Take vertices (V, 3), m, and faces (F, 3) of each link.")
      .def_prop_ro("edges", [](const Mesh& mesh) { return mesh.edges.size(); }, "Number of edges.")
      .def("sums", &sums, "camera"_a, "camera_from_link"_a, "table"_a, "lines_per_pixel"_a, "to_pixel"_a, "threads"_a,
           "decide"_a.none(), "Sum K images, by their prefix sums (H, W + 1, K), over C silhouettes: (C, K).")
      .def("masks", &masks, "camera"_a, "camera_from_link"_a, "threads"_a, "decide"_a.none(),
           "Find the pixels whose centres are covered in C poses: (C, H, W).")
      .def("coverage", &coverage, "camera"_a, "camera_from_link"_a, "lines_per_pixel"_a, "threads"_a,
           "decide"_a.none(), "Compute the covered fraction of each pixel in C poses: (C, H, W).")
      .def("outlines", &outlines, "camera"_a, "camera_from_link"_a, "lines_per_pixel"_a, "with_coverage"_a, "threads"_a,
           "decide"_a.none(),
           "Find N points on the outlines of C poses: coverage (C, H, W) or None, offsets (C + 1,) of the poses' points, "
           "links (N,), pixels (N, 2), normals (N, 2), points (N, 3) in the links' frames.");

  module.def("move_points", &move_points, "camera"_a, "begin"_a, "link"_a, "points"_a, "directions"_a,
             "camera_from_root"_a, "root_from_link"_a, "by_joint"_a,
             "Project N points of C poses: depths (N,), pixels (N, 2), Jacobians (N, 6 + J) along directions (N, 2).");
  module.def("cauchy_losses", &cauchy_losses, "images"_a, "target"_a, "weight"_a, "cauchy"_a,
             "Compute the Cauchy losses (C,) of the differences of C images from a target (H, W).");
  module.def("sample_profiles", &sample_profiles, "images"_a, "target"_a, "weight"_a, "begin"_a, "pixels"_a,
             "normals"_a, "reach"_a,
             "Sample C images less a target, and weights times lengths of the normals, along N normals: (N, K) each.");
  module.def("normal_equations", &all_normal_equations, "begin"_a, "residual"_a, "weight"_a, "jacobian"_a, "density"_a,
             "cauchy"_a, "change"_a,
             "Compute information (C, D, D) and slope (C, D) of half the robust loss after small changes (C, D).");
}
