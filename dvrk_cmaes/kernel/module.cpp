// The Python module dvrk_cmaes._kernel. Shapes and indices are checked here, once; the headers rely on them.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <initializer_list>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "camera.hpp"
#include "chain.hpp"
#include "comparison.hpp"
#include "contour.hpp"
#include "dense.hpp"
#include "differences.hpp"
#include "lines.hpp"
#include "mesh.hpp"
#include "moving.hpp"
#include "nearest.hpp"
#include "outline.hpp"
#include "rays.hpp"
#include "rotation.hpp"
#include "shared.hpp"
#include "silhouette.hpp"
#include "straight.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace kernel {
namespace {

template <class T>
using Given = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using Made = nb::ndarray<nb::numpy, T>;

constexpr long kAny = -1;
constexpr std::int64_t kMostLinks = 1000;

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
Made<T> zeros(const std::vector<std::size_t>& shape) {
  std::size_t count = 1;
  for (std::size_t length : shape) count *= length;
  T* data = new T[std::max<std::size_t>(count, 1)]();
  nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
  return Made<T>(data, shape.size(), shape.data(), owner);
}

template <class T>
Made<T> copied(const std::vector<T>& values) {
  Made<T> out = zeros<T>({values.size()});
  std::copy(values.begin(), values.end(), out.data());
  return out;
}

// The outline of a pose, and where it crosses image lines.
struct Drawn {
  Outline outline;
  Lines rows, columns;
};

struct Workspace {
  Drawn drawn;
  std::vector<std::int32_t> change;
  Blurred image;
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
  Camera camera{width, height, fx, fy, cx, cy, lens};
  if (!camera.is_pinhole()) camera.bend = camera.largest_bend();
  return camera;
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
                 const std::vector<double>& multipliers, const std::vector<double>& offsets, const Given<double>& terms) {
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

// Traces rays against a link: called with its number, origins (N, 3) and directions (N, 3) in its frame; returns which
// rays hit it, (N,). Without, layers are counted.
using Trace = std::optional<nb::callable>;

// What is drawn of each pose, and how.
struct Drawing {
  const Mesh& mesh;
  const Camera& camera;
  const Given<double>& links;
  int lines_per_pixel;
  std::size_t threads;
  const Trace& trace;
  double bend;               // px, by which a piece of the outline may be off the image of a straight line
  bool columns = false;      // whether the columns are crossed as well as the rows, as `find_points` needs it
  bool to_pixel = false;     // whether only the pixels' centres matter
  double shortest = kClose;  // px, of the spans through which rays are traced

  std::size_t poses() const { return links.shape(0); }
  const double* links_of(std::size_t pose) const { return links.data() + 16 * mesh.link_count() * pose; }

  void check() const {
    check_shape("camera_from_link", links, {kAny, mesh.link_count(), 4, 4});
    check_finite("camera_from_link", links.data(), links.size());
    check_positive("lines_per_pixel", lines_per_pixel);
    if (lines_per_pixel >= kMostLines || lines_per_pixel * camera.height > kMostLines) {
      throw std::invalid_argument("lines_per_pixel: expected fewer lines in all");
    }
  }

  // Call `use(workspace, drawn, pose)` with what is drawn of each pose, without the interpreter's lock; after `check`.
  template <class Use>
  void each(const Use& use) const {
    const std::size_t most = poses() * mesh.edges.size() < kFewEdges ? 1 : threads;
    std::optional<nb::gil_scoped_release> released(std::in_place);
    if (!trace) {
      each_pose(poses(), most, [&](Workspace& at, std::size_t pose) {
        find(at.drawn.outline, at.drawn, pose);
        at.drawn.rows.count_layers();
        if (columns) at.drawn.columns.count_layers();
        use(at, at.drawn, pose);
      });
      return;
    }
    thread_local std::vector<Drawn> drawn;
    thread_local Outline shared;  // where only points need the outlines afterwards, its memory stays in the cache
    std::vector<Drawn>& all = drawn;
    if (all.size() < poses()) all.resize(poses());
    SpanRays rays;
    for (std::size_t pose = 0; pose < poses(); ++pose) {
      Outline& outline = columns ? all[pose].outline : shared;
      find(outline, all[pose], pose);
      rays.add(all[pose].rows, outline, camera, links_of(pose), to_pixel, shortest);
      if (columns) rays.add(all[pose].columns, outline, camera, links_of(pose), to_pixel, shortest);
    }
    released.reset();
    for (int link = 0; link < mesh.link_count(); ++link) trace_link(rays, link);
    released.emplace();
    rays.finish();
    each_pose(poses(), most, [&](Workspace& at, std::size_t pose) { use(at, all[pose], pose); });
  }

  // Find the points where the outline crosses rows and columns, sorted by link.
  void find_points(const Drawn& at, std::vector<OutlinePoint>& points) const {
    add_points(at.rows, at.outline, camera, points);
    add_points(at.columns, at.outline, camera, points);
    std::stable_sort(points.begin(), points.end(), [](const auto& a, const auto& b) { return a.link < b.link; });
  }

 private:
  static constexpr std::size_t kFewEdges = 30000;  // of all poses; starting a thread takes as long as these

  void find(Outline& outline, Drawn& at, std::size_t pose) const {
    outline.find(mesh, camera, links_of(pose), camera.is_pinhole() ? 0.0 : camera.straight_length(bend));
    at.rows.find(outline.pieces, Grid::rows(camera, lines_per_pixel));
    if (columns) at.columns.find(outline.pieces, Grid::columns(camera));
  }

  // Trace the rays of all poses against a link together.
  void trace_link(SpanRays& rays, int link) const {
    const std::vector<std::size_t>& chosen = rays.towards(link);
    if (chosen.empty()) return;
    Made<float> origins = zeros<float>({chosen.size(), 3}), directions = zeros<float>({chosen.size(), 3});
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      rays.write(chosen[i], link, origins.data() + 3 * i, directions.data() + 3 * i);
    }
    const auto hit = nb::cast<nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(
        (*trace)(link, std::move(origins), std::move(directions)));
    check_shape("hit", hit, {static_cast<long>(chosen.size())});
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      if (hit.data()[i]) rays.mark(chosen[i]);
    }
  }
};

// Most spans are shorter, between edges inside the outline; all of a row's together hardly change a sum.
constexpr double kNegligible = 1.0 / 4;               // px
constexpr double kBend = 0.004, kExactBend = 0.0005;  // px; the latter where whole pixels are asked for

Made<double> sums(const Mesh& mesh, const Camera& camera, const Given<double>& links, const Given<double>& table,
                  int lines_per_pixel, bool to_pixel, std::size_t threads, const Trace& trace,
                  const std::optional<std::array<int, 2>>& part) {
  check_shape("table", table, {camera.height, camera.width + 1, kAny});
  if (part && (trace || (*part)[0] < 0)) throw std::invalid_argument("part: expected links, and no rays");
  const Drawing drawing{mesh,  camera,   links,      lines_per_pixel, threads, trace, to_pixel ? kExactBend : kBend,
                        false, to_pixel, kNegligible};
  drawing.check();
  const std::size_t images = table.shape(2);
  Made<double> out = zeros<double>({part ? std::size_t(2) : 1, drawing.poses(), images});
  drawing.each([&](Workspace& own, const Drawn& at, std::size_t pose) {
    const auto add = [&](std::size_t place) {
      double* sum = out.data() + images * (drawing.poses() * place + pose);
      add_sums(at.rows, table.data(), static_cast<int>(images), to_pixel, sum);
      for (std::size_t k = 0; k < images; ++k) sum[k] /= lines_per_pixel;
    };
    add(0);
    if (!part) return;
    own.drawn.rows.count_layers(at.outline.first_piece((*part)[0]), at.outline.first_piece((*part)[1]));
    add(1);
  });
  return out;
}

Made<bool> masks(const Mesh& mesh, const Camera& camera, const Given<double>& links, std::size_t threads,
                 const Trace& trace) {
  const Drawing drawing{mesh, camera, links, 1, threads, trace, kExactBend, false, true};
  drawing.check();
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  Made<bool> out = zeros<bool>({drawing.poses(), std::size_t(camera.height), std::size_t(camera.width)});
  drawing.each([&](Workspace&, const Drawn& at, std::size_t pose) { fill_mask(at.rows, out.data() + pixels * pose); });
  return out;
}

Made<float> coverage(const Mesh& mesh, const Camera& camera, const Given<double>& links, int lines_per_pixel,
                     std::size_t threads, const Trace& trace) {
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, trace, kBend};
  drawing.check();
  const std::size_t pixels = std::size_t(camera.width) * camera.height;
  Made<float> out = zeros<float>({drawing.poses(), std::size_t(camera.height), std::size_t(camera.width)});
  drawing.each([&](Workspace& at, const Drawn& drawn, std::size_t pose) {
    fill_coverage(drawn.rows, out.data() + pixels * pose, at.change);
  });
  return out;
}

using Outlines = std::tuple<Made<std::int64_t>, Made<std::int64_t>, Made<double>, Made<double>, Made<double>>;

Outlines outlines(const Mesh& mesh, const Camera& camera, const Given<double>& links, int lines_per_pixel,
                  std::size_t threads, const Trace& trace) {
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, trace, kBend, true};
  drawing.check();
  const std::size_t poses = drawing.poses();
  std::vector<std::vector<OutlinePoint>> of_poses(poses);
  drawing.each([&](Workspace&, const Drawn& at, std::size_t pose) { drawing.find_points(at, of_poses[pose]); });
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
  return {begin, link, pixel, normal, point};
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
    const Camera& camera, const Given<std::int64_t>& begin, const Given<std::int64_t>& link, const Given<double>& points,
    const Given<double>& directions, const Given<double>& camera_from_root, const Given<double>& root_from_link,
    const Given<double>& by_joint) {
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

// Whether any of several numbers differs from another one.
bool differs(const float* values, std::size_t count, float other) {
  int found = 0;
  for (std::size_t i = 0; i < count; ++i) found |= values[i] != other;
  return found;
}

Target make_target(const Given<float>& mask, const Given<float>& weight, const std::vector<float>& taps, int reach) {
  check_shape("mask", mask, {kAny, kAny});
  const long height = static_cast<long>(mask.shape(0)), width = static_cast<long>(mask.shape(1));
  check_shape("weight", weight, {height, width});
  if (mask.size() == 0 || width > (1 << 14) || height > (1 << 14)) {
    throw std::invalid_argument("mask: expected at least one pixel, and at most 16384 in a row or column");
  }
  if (taps.empty() || taps.size() > 1000) throw std::invalid_argument("taps: expected 1 to 1000 of them");
  if (reach < 1 || reach > 1000) throw std::invalid_argument("reach: expected 1 to 1000 px");
  Target target;
  target.taps = taps, target.reach = reach;
  target.weight.assign(weight.data(), weight.data() + weight.size());
  target.weighted = differs(target.weight.data(), target.weight.size(), 1.0f);
  target.mask.begin(int(width), int(height), taps);
  for (long row = 0; row < height; ++row) {
    const float* values = mask.data() + width * row;
    constexpr int kBlock = 32;  // pixels that are looked at together
    for (int i = 0; i < width; ++i) {
      if (i > 0) {
        while (i + kBlock <= width && !differs(values + i, kBlock, values[i - 1])) i += kBlock;
        if (i == width || values[i] == values[i - 1]) continue;
      }
      if (!std::isfinite(values[i])) throw std::invalid_argument("mask: expected finite numbers");
      target.mask.runs.push_back({i, values[i]});
    }
    target.mask.end_row();
  }
  target.mask.blur();
  return target;
}

using Compared = std::vector<std::shared_ptr<Comparison>>;

Compared compare(const Mesh& mesh, const Camera& camera, const Target& target, const Given<double>& camera_from_root,
                 const Given<double>& root_from_link, const std::optional<Given<double>>& by_joint,
                 const Given<double>& camera_from_link, int lines_per_pixel, const std::vector<double>& cauchy,
                 std::size_t threads, const Trace& trace) {
  const Drawing drawing{mesh, camera, camera_from_link, lines_per_pixel, threads, trace, kBend, by_joint.has_value()};
  drawing.check();
  const long c = static_cast<long>(drawing.poses()), l = mesh.link_count();
  check_shape("camera_from_root", camera_from_root, {c, 4, 4});
  check_shape("root_from_link", root_from_link, {c, l, 4, 4});
  if (by_joint) check_shape("by_joint", *by_joint, {c, kAny, l, 4, 4});
  if (target.mask.width() != camera.width || target.mask.height() != camera.height) {
    throw std::invalid_argument("target: expected the size of the camera's images");
  }
  for (double width : cauchy) {
    if (!(width > 0.0)) throw std::invalid_argument("cauchy: expected positive numbers");
  }
  const int joints = by_joint ? int(by_joint->shape(1)) : 0;
  Compared found(c);
  drawing.each([&](Workspace& at, const Drawn& drawn, std::size_t pose) {
    found[pose] = std::make_shared<Comparison>();
    Comparison& one = *found[pose];
    at.image.begin(camera.width, camera.height, target.taps);
    at.image.cover(drawn.rows);
    at.image.blur();
    for (double width : cauchy) one.losses.push_back(cauchy_loss(at.image, target, width));
    one.runs = at.image.runs, one.first = at.image.first;
    if (!by_joint) return;
    drawing.find_points(drawn, one.points);
    const Placed placed{camera_from_root.data() + 16 * pose, root_from_link.data() + 16 * l * pose,
                        by_joint->data() + 16 * l * joints * pose, int(l), joints};
    add_samples(at.image, target, camera, placed, one);
    one.outlined = true;
  });
  return found;
}

// Replace the derivatives of the outlines of C comparisons by central differences. `links` (C, 2 D, L, 4, 4) are the poses
// of the links after each unknown was changed by its step (C, D), then after minus that.
void difference(const Mesh& mesh, const Camera& camera, const Compared& compared, const Given<double>& links,
                const Given<double>& steps, int lines_per_pixel, std::size_t threads, const Trace& trace) {
  const long count = static_cast<long>(compared.size()), l = mesh.link_count();
  check_shape("steps", steps, {count, kAny});
  const std::size_t D = steps.shape(1);
  check_shape("camera_from_link", links, {count * 2 * static_cast<long>(D), l, 4, 4});
  for (std::size_t i = 0; i < steps.size(); ++i) {
    if (!(steps.data()[i] > 0.0)) throw std::invalid_argument("steps: expected positive numbers");
  }
  for (const auto& one : compared) {
    if (!one || !one->outlined || one->unknowns != static_cast<int>(D)) {
      throw std::invalid_argument("compared: expected comparisons with outlines and as many unknowns as steps");
    }
  }
  const Drawing drawing{mesh, camera, links, lines_per_pixel, threads, trace, kBend, true};
  drawing.check();
  std::vector<std::vector<double>> places(drawing.poses());  // of the points of each moved outline, px along their lines
  drawing.each([&](Workspace&, const Drawn& at, std::size_t pose) {
    places[pose] = moved_places(compared[pose / (2 * D)]->points, at.rows, at.columns);
  });
  for (long k = 0; k < count; ++k) {
    Comparison& one = *compared[k];
    for (std::size_t d = 0; d < D; ++d) {
      const std::size_t first = 2 * D * k + d;
      difference_points(one.points, places[first], places[first + D], steps.data()[D * k + d], d, D, one.jacobian);
    }
    one.differenced = true;
  }
}

void make_contour_errors(ContourErrors* self, int reach, int least, double normal_median, double least_sigma, double clip,
                         double correlated, double length, double farthest, double grid, double inflation) {
  check_positive("reach", reach), check_positive("least", least);
  for (double value : {least_sigma, clip, length, farthest, inflation}) {
    if (!(value > 0.0)) throw std::invalid_argument("errors: expected positive numbers");
  }
  if (!(correlated >= 0.0 && correlated < 1.0)) throw std::invalid_argument("correlated: expected 0 to 1");
  new (self) ContourErrors{reach, least, normal_median, least_sigma, clip, correlated, length, farthest, grid, inflation};
}

using Quadratics = std::tuple<Made<double>, Made<double>>;

std::tuple<Made<double>, Made<double>, Made<double>> contours(
    const Mesh& mesh, const Camera& camera, const Given<bool>& mask, const Given<float>& weight,
    const Given<double>& camera_from_root, const Given<double>& root_from_link, const Given<double>& by_joint,
    const Given<double>& camera_from_link, const ContourErrors& errors, std::size_t threads, const Trace& trace) {
  const Drawing drawing{mesh, camera, camera_from_link, 1, threads, trace, kBend, true};
  drawing.check();
  const long c = static_cast<long>(drawing.poses()), l = mesh.link_count();
  check_shape("camera_from_root", camera_from_root, {c, 4, 4});
  check_shape("root_from_link", root_from_link, {c, l, 4, 4}), check_shape("by_joint", by_joint, {c, kAny, l, 4, 4});
  check_shape("mask", mask, {camera.height, camera.width}), check_shape("weight", weight, {camera.height, camera.width});
  const std::size_t joints = by_joint.shape(1), D = 6 + joints;
  const ContourMask seen{mask.data(), weight.data(), camera.width, camera.height};
  Made<double> information = zeros<double>({std::size_t(c), D, D}), slope = zeros<double>({std::size_t(c), D});
  Made<double> cost = zeros<double>({std::size_t(c)});
  drawing.each([&](Workspace&, const Drawn& at, std::size_t pose) {
    std::vector<OutlinePoint> points;
    drawing.find_points(at, points);
    const Placed placed{camera_from_root.data() + 16 * pose, root_from_link.data() + 16 * l * pose,
                        by_joint.data() + 16 * l * joints * pose, int(l), int(joints)};
    cost.data()[pose] = contour_equations(seen, points, jacobian_of(camera, placed, points), D, errors,
                                          information.data() + D * D * pose, slope.data() + D * pose);
  });
  return {information, slope, cost};
}

// Numbers of each point of an outline, (N, length).
template <class T, class Values>
Made<T> of_points(const Comparison& at, std::size_t length, const Values& values) {
  Made<T> out = length ? zeros<T>({at.points.size(), length}) : zeros<T>({at.points.size()});
  const std::size_t each = std::max<std::size_t>(length, 1);
  for (std::size_t i = 0; i < at.points.size(); ++i) std::copy_n(values(i), each, out.data() + each * i);
  return out;
}

Made<float> coverage_of(const Comparison& at, int width) {
  const std::size_t height = at.first.size() - 1;
  if (width < 1) throw std::invalid_argument("width: expected that of the images");
  Made<float> out = zeros<float>({height, std::size_t(width)});
  for (std::size_t row = 0; row < height; ++row) {
    for (Index i = at.first[row]; i < at.first[row + 1]; ++i) {
      const int end = i + 1 < at.first[row + 1] ? at.runs[i + 1].begin : width;
      if (end > width || at.runs[i].begin >= width) throw std::invalid_argument("width: expected that of the images");
      std::fill(out.data() + width * row + at.runs[i].begin, out.data() + width * row + end, at.runs[i].value);
    }
  }
  return out;
}

// Refuse what are not comparisons, with outlines, of `count` poses in as many views as there are factors.
void check_compared(const Compared& compared, const std::vector<double>& factors, const std::vector<double>& density,
                    std::size_t count, std::size_t unknowns) {
  if (factors.empty() || compared.size() != factors.size() * count) {
    throw std::invalid_argument("compared: expected as many of each pose as factors");
  }
  for (const auto& one : compared) {
    if (!one || !one->outlined || one->unknowns != int(unknowns)) {
      throw std::invalid_argument("compared: expected comparisons with derivatives by as many unknowns as changes");
    }
    if (one->samples != int(density.size())) throw std::invalid_argument("density: expected one of each sample");
  }
}

Quadratics normal_equations(const Compared& compared, const std::vector<double>& factors, const std::vector<double>& density,
                            double cauchy, const Given<double>& change) {
  check_shape("change", change, {kAny, kAny});
  const std::size_t count = change.shape(0), D = change.shape(1), views = factors.size();
  check_compared(compared, factors, density, count, D);
  Made<double> information = zeros<double>({count, D, D}), slope = zeros<double>({count, D});
  const nb::gil_scoped_release released;
  for (std::size_t pose = 0; pose < count; ++pose) {
    double* const square = information.data() + D * D * pose;
    for (std::size_t view = 0; view < views; ++view) {
      add_normal_equations(*compared[views * pose + view], density, cauchy, factors[view], change.data() + D * pose, square,
                           slope.data() + D * pose);
    }
    for (std::size_t a = 0; a < D; ++a) {
      for (std::size_t b = 0; b < a; ++b) square[D * b + a] = square[D * a + b];
    }
  }
  return {information, slope};
}

void check_solved(const Made<double>& found) {
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!std::isfinite(found.data()[i])) throw std::invalid_argument("equations: expected finite ones with a solution");
  }
}

Sharing make_sharing(const std::optional<Given<double>>& shaft, double nodes, int least) {
  Sharing sharing{std::nullopt, nodes, least};
  if (!(nodes > 0.0)) throw std::invalid_argument("nodes: expected a positive number");
  if (shaft) {
    check_shape("shaft", *shaft, {2, 3}), check_finite("shaft", shaft->data(), 6);
    const double* at = shaft->data();
    sharing.shaft = {{{at[0], at[1], at[2]}, {at[3], at[4], at[5]}}};
  }
  return sharing;
}

std::tuple<Made<double>, Made<double>> shared_errors(const Given<std::int64_t>& link, const Given<double>& normals,
                                                     const Given<double>& points, const Vector2& axis,
                                                     const std::array<double, 4>& deviations, const Sharing& sharing,
                                                     const std::optional<Given<double>>& offsets, const Shown& shown) {
  check_shape("link", link, {kAny});
  const long n = static_cast<long>(link.size());
  check_shape("normals", normals, {n, 2}), check_shape("points", points, {n, 3});
  check_finite("points", points.data(), points.size());
  if (offsets) check_shape("offsets", *offsets, {n});
  std::vector<OutlinePoint> outline;
  for (long i = 0; i < n; ++i) {
    const double *normal = normals.data() + 2 * i, *at = points.data() + 3 * i;
    if (link.data()[i] < 0 || link.data()[i] >= kMostLinks) throw std::invalid_argument("link: expected numbers of links");
    outline.push_back({Index(link.data()[i]), {}, {normal[0], normal[1]}, {at[0], at[1], at[2]}});
  }
  SharedErrors errors(outline, 1, axis, sharing, {deviations[0], deviations[1], deviations[2], deviations[3]});
  if (offsets) errors.enlarge(offsets->data(), shown);
  const std::size_t M = errors.deviations.size();
  Made<double> columns = zeros<double>({std::size_t(n), M});
  for (long i = 0; i < n; ++i) errors.each(i, [&](int error, double of) { columns.data()[M * i + error] = of; });
  return {columns, copied(errors.deviations)};
}

Quadratics shared_equations(const Compared& compared, const std::vector<double>& factors, const std::vector<double>& density,
                            double cauchy, int stride, const std::vector<Vector2>& axes,
                            const std::vector<std::array<double, 4>>& deviations, const Sharing& sharing,
                            const std::vector<Given<double>>& more, const std::vector<Given<double>>& offsets,
                            const Shown& shown, int views) {
  check_positive("stride", stride), check_positive("views", views);
  const std::size_t count = compared.size() / views, all = compared.size();
  const int D = compared.empty() || !compared[0] ? 0 : compared[0]->unknowns;
  const int E = more.empty() ? 0 : int(more[0].ndim() == 2 ? more[0].shape(1) : 0);
  check_compared(compared, factors, density, 1, D);
  if (all != count * views || axes.size() != all || deviations.size() != all || (!more.empty() && more.size() != all) ||
      (!offsets.empty() && offsets.size() != all)) {
    throw std::invalid_argument("compared: expected as many as axes, deviations, offsets and others, of all views");
  }
  for (std::size_t i = 0; i < all; ++i) {
    const long points = (static_cast<long>(compared[i]->points.size()) + stride - 1) / stride;
    if (!more.empty()) check_shape("more", more[i], {points, E});
    if (!offsets.empty()) check_shape("offsets", offsets[i], {points});
    for (const OutlinePoint& at : compared[i]->points) check_finite("points", at.point.data(), 3);
  }
  const std::size_t A = Unknowns{D, E, views, 0}.kept();
  Made<double> information = zeros<double>({count, A, A}), slope = zeros<double>({count, A});
  const nb::gil_scoped_release released;
  for (std::size_t i = 0; i < all; ++i) {
    const auto [side, margin, node, link] = deviations[i];
    SharedErrors errors(compared[i]->points, stride, axes[i], sharing, {side, margin, node, link});
    if (!offsets.empty()) errors.enlarge(offsets[i].data(), shown);
    const std::size_t pose = i / views;
    add_shared_equations(*compared[i], stride, density, cauchy, factors[i], errors, more.empty() ? nullptr : more[i].data(),
                         {D, E, views, int(i % views)}, information.data() + A * A * pose, slope.data() + A * pose);
  }
  check_solved(information);
  return {information, slope};
}

Made<double> minimise_all(const Compared& compared, const std::vector<double>& factors, const std::vector<double>& density,
                          double cauchy, const Given<double>& weight, const Given<double>& information,
                          const Given<double>& slope, const std::optional<Given<double>>& damping, int iterations,
                          double solved, const std::array<double, 2>& least, double farthest) {
  check_shape("slope", slope, {kAny, kAny});
  const long count = static_cast<long>(slope.shape(0)), unknowns = static_cast<long>(slope.shape(1));
  check_shape("weight", weight, {count}), check_shape("information", information, {count, unknowns, unknowns});
  if (damping) check_shape("damping", *damping, {count});
  if (!compared.empty()) check_compared(compared, factors, density, count, unknowns);
  const std::size_t D = unknowns, views = compared.empty() ? 0 : factors.size();
  Made<double> out = zeros<double>({std::size_t(count), D});
  const nb::gil_scoped_release released;
  const Minimisation how{iterations, solved, least[0], least[1], farthest};
  for (long pose = 0; pose < count; ++pose) {
    const auto each_view = [&](const auto& use) {
      for (std::size_t view = 0; view < views; ++view) use(*compared[views * pose + view], view);
    };
    std::vector<double> change(D, 0.0);
    minimise(
        how, information.data() + D * D * pose, slope.data() + D * pose, damping ? damping->data()[pose] : -1.0,
        [&](const double* at, double* square, double* line) {
          each_view([&](const Comparison& one, std::size_t view) {
            const double factor = weight.data()[pose] * factors[view];
            add_normal_equations(one, density, cauchy, factor, at, square, line);
          });
        },
        change);
    double largest = 0.0;
    each_view(
        [&](const Comparison& one, std::size_t) { largest = std::max(largest, largest_displacement(one, change.data())); });
    const double share = std::min(1.0, farthest / std::max(largest, 1e-12));
    for (std::size_t d = 0; d < D; ++d) out.data()[D * pose + d] = share * change[d];
  }
  return out;
}

std::vector<std::tuple<Made<double>, Made<std::int64_t>, double>> fit_lines(
    const Given<double>& points, const Given<double>& normals, const Given<double>& lines, double sigma, double near,
    double facing, double gap, double least_sigma, double reach, double least_reach, double normal_median, int iterations,
    int least) {
  check_shape("points", points, {kAny, 2}), check_shape("normals", normals, {static_cast<long>(points.shape(0)), 2});
  check_shape("lines", lines, {kAny, 3});
  for (const Given<double>* one : {&points, &normals, &lines}) check_finite("contour and lines", one->data(), one->size());
  const ContourPoints contour{points.data(), normals.data(), points.shape(0)};
  const LineFit how{sigma, near, facing, gap, least_sigma, reach, least_reach, normal_median, iterations, least};
  std::vector<std::tuple<Made<double>, Made<std::int64_t>, double>> found;
  for (std::size_t i = 0; i < lines.shape(0); ++i) {
    const double* line = lines.data() + 3 * i;
    const FittedLine fitted = fit_line(contour, {line[0], line[1], line[2]}, how);
    const std::vector<std::int64_t> index(fitted.points.begin(), fitted.points.end());
    found.emplace_back(copied(std::vector<double>(fitted.line.begin(), fitted.line.end())), copied(index), fitted.sigma);
  }
  return found;
}

std::vector<std::tuple<Made<std::int64_t>, Made<double>>> straight_stretches(const Given<double>& outline,
                                                                             const Given<double>& corners, double band,
                                                                             double gap, double shortest, double side) {
  check_shape("outline", outline, {kAny, 2}), check_shape("corners", corners, {kAny, 2});
  for (const Given<double>* one : {&outline, &corners}) check_finite("outline and corners", one->data(), one->size());
  const std::size_t count = corners.shape(0);
  std::vector<Stretch> found;
  for (std::size_t k = 0; k < count; ++k) {
    const double *from = corners.data() + 2 * k, *to = corners.data() + 2 * ((k + 1) % count);
    const double u = to[0] - from[0], v = to[1] - from[1], length = std::sqrt(u * u + v * v);
    if (!(length > 0.0) || length < side) continue;
    add_stretches(outline.data(), outline.shape(0), {from[0], from[1]}, {u / length, v / length}, band, gap, shortest,
                  found);
  }
  std::vector<std::tuple<Made<std::int64_t>, Made<double>>> out;
  for (const Stretch& one : found) out.emplace_back(copied(one.points), copied(one.along));
  return out;
}

Made<double> sobel_at(const Given<float>& image, const Given<std::int64_t>& pixels) {
  check_shape("image", image, {kAny, kAny}), check_shape("pixels", pixels, {kAny, 2});
  const std::int64_t height = image.shape(0), width = image.shape(1);
  Made<double> out = zeros<double>({pixels.shape(0), 2});
  for (std::size_t i = 0; i < pixels.shape(0); ++i) {
    const std::int64_t u = pixels.data()[2 * i], v = pixels.data()[2 * i + 1];
    if (u < 0 || u >= width || v < 0 || v >= height) throw std::invalid_argument("pixels: expected some of the image's");
    const auto at = [&](int down, int right) {
      const std::int64_t row = std::clamp<std::int64_t>(v + down, 0, height - 1);
      return double(image.data()[width * row + std::clamp<std::int64_t>(u + right, 0, width - 1)]);
    };
    const double rising = at(1, 1) - at(-1, -1), falling = at(-1, 1) - at(1, -1);
    out.data()[2 * i] = (rising + falling + 2.0 * (at(0, 1) - at(0, -1))) / 8.0;
    out.data()[2 * i + 1] = (rising - falling + 2.0 * (at(1, 0) - at(-1, 0))) / 8.0;
  }
  return out;
}

std::tuple<Made<double>, Made<double>> line_support(const Given<double>& points, const Given<double>& normals,
                                                    const Given<double>& lines, double sigma, double facing) {
  check_shape("points", points, {kAny, 2}), check_shape("normals", normals, {static_cast<long>(points.shape(0)), 2});
  check_shape("lines", lines, {kAny, 3});
  for (const Given<double>* one : {&points, &normals, &lines}) check_finite("contour and lines", one->data(), one->size());
  if (!(sigma > 0.0)) throw std::invalid_argument("sigma: expected a positive number");
  const ContourPoints contour{points.data(), normals.data(), points.shape(0)};
  Made<double> sums = zeros<double>({lines.shape(0)}), middles = zeros<double>({lines.shape(0), 2});
  for (std::size_t i = 0; i < lines.shape(0); ++i) {
    const double* line = lines.data() + 3 * i;
    const Support found = support_of(contour, {line[0], line[1], line[2]}, sigma, facing);
    sums.data()[i] = found.sum;
    std::copy(found.middle.begin(), found.middle.end(), middles.data() + 2 * i);
  }
  return {sums, middles};
}

Made<double> signed_distances(const Given<bool>& mask, const Given<double>& pixels, double farthest) {
  check_shape("mask", mask, {kAny, kAny}), check_shape("pixels", pixels, {kAny, 2});
  if (mask.size() == 0) throw std::invalid_argument("mask: expected at least one pixel");
  if (!(farthest >= 1.0 && farthest <= 1e6)) throw std::invalid_argument("farthest: expected 1 to 1000000 px");
  check_finite("pixels", pixels.data(), pixels.size());
  Made<double> out = zeros<double>({pixels.shape(0)});
  const nb::gil_scoped_release released;
  NearestOther nearest(mask.data(), std::int64_t(mask.shape(1)), std::int64_t(mask.shape(0)));
  for (std::size_t i = 0; i < pixels.shape(0); ++i) {
    out.data()[i] = signed_distance(nearest, pixels.data()[2 * i], pixels.data()[2 * i + 1], farthest);
  }
  return out;
}

// An array (..., numbers), of which the rows are matrices or vectors of a known shape.
struct Rows {
  std::vector<std::size_t> shape;  // of the rows
  std::size_t count = 1, size = 1;

  Rows(const char* name, const Given<double>& array, std::initializer_list<long> row) {
    std::size_t axis = array.ndim() - row.size();
    bool right = array.ndim() >= row.size();
    for (long length : row) {
      if (!right) break;
      right = length == kAny ? array.shape(axis) >= 6 : static_cast<long>(array.shape(axis)) == length;
      size *= array.shape(axis++);
    }
    if (!right) throw std::invalid_argument(std::string(name) + ": expected an array of other rows");
    for (std::size_t k = 0; k + row.size() < array.ndim(); ++k) shape.push_back(array.shape(k)), count *= shape.back();
  }

  // A new array of as many rows of another shape.
  Made<double> make(std::initializer_list<std::size_t> row) const {
    std::vector<std::size_t> whole(shape);
    whole.insert(whole.end(), row);
    return zeros<double>(whole);
  }
};

// The rows of both, of which one may be a single one; refuse others.
const Rows& both_rows(const Rows& one, const Rows& other) {
  if (!one.shape.empty() && !other.shape.empty() && one.shape != other.shape) {
    throw std::invalid_argument("poses: expected as many of both, or a single one");
  }
  return one.shape.empty() ? other : one;
}

Made<double> exponentials(const Given<double>& vectors) {
  const Rows rows("vectors", vectors, {3});
  Made<double> out = rows.make({3, 3});
  for (std::size_t i = 0; i < rows.count; ++i) rotation_by(vectors.data() + 3 * i, out.data() + 9 * i, 3);
  return out;
}

Made<double> logarithms(const Given<double>& rotations) {
  const Rows rows("rotations", rotations, {3, 3});
  Made<double> out = rows.make({3});
  for (std::size_t i = 0; i < rows.count; ++i) rotation_vector(rotations.data() + 9 * i, 3, out.data() + 3 * i);
  return out;
}

Made<double> moved(const Given<double>& poses, const Given<double>& changes) {
  const Rows of_poses("poses", poses, {4, 4}), of_changes("changes", changes, {kAny});
  const Rows& both = both_rows(of_poses, of_changes);
  Made<double> out = both.make({4, 4});
  const std::size_t pose = of_poses.shape.empty() ? 0 : 16, change = of_changes.shape.empty() ? 0 : of_changes.size;
  for (std::size_t i = 0; i < both.count; ++i) {
    move_pose(poses.data() + pose * i, changes.data() + change * i, out.data() + 16 * i);
  }
  return out;
}

Made<double> changes_between(const Given<double>& poses, const Given<double>& others) {
  const Rows of_poses("poses", poses, {4, 4}), of_others("others", others, {4, 4});
  const Rows& both = both_rows(of_poses, of_others);
  Made<double> out = both.make({6});
  const std::size_t pose = of_poses.shape.empty() ? 0 : 16, other = of_others.shape.empty() ? 0 : 16;
  for (std::size_t i = 0; i < both.count; ++i) {
    change_of_pose(poses.data() + pose * i, others.data() + other * i, out.data() + 6 * i);
  }
  return out;
}

std::tuple<Made<double>, Made<double>> eliminate_frames(const Given<double>& diagonal, const Given<double>& beside,
                                                        const Given<double>& right) {
  check_shape("diagonal", diagonal, {kAny, kAny, kAny});
  const std::size_t N = diagonal.shape(0), M = diagonal.shape(1);
  if (N == 0) throw std::invalid_argument("diagonal: expected at least one frame");
  check_shape("diagonal", diagonal, {kAny, long(M), long(M)});
  check_shape("beside", beside, {long(N) - 1, long(M), long(M)}), check_shape("right", right, {long(N), long(M), kAny});
  Made<double> inverses = zeros<double>({N, M, M}), left = zeros<double>({N, M, right.shape(2)});
  const nb::gil_scoped_release released;
  std::copy_n(right.data(), right.size(), left.data());
  eliminate_chain(diagonal.data(), beside.data(), inverses.data(), left.data(), N, M, right.shape(2));
  check_solved(inverses);
  return {inverses, left};
}

std::tuple<Made<double>, Made<double>> eliminate_unknowns(const Given<double>& information, const Given<double>& slope,
                                                          const Given<double>& known) {
  check_shape("slope", slope, {kAny, kAny}), check_shape("known", known, {kAny, kAny});
  const std::size_t N = slope.shape(0), all = slope.shape(1), M = known.shape(0);
  check_shape("known", known, {long(M), long(M)}), check_shape("information", information, {long(N), long(all), long(all)});
  if (M > all) throw std::invalid_argument("known: expected at most as many unknowns as the terms have");
  const std::size_t D = all - M;
  Made<double> left = zeros<double>({N, D, D}), left_slope = zeros<double>({N, D});
  const nb::gil_scoped_release released;
  for (std::size_t n = 0; n < N; ++n) {
    eliminate_last(information.data() + all * all * n, slope.data() + all * n, known.data(), D, M, left.data() + D * D * n,
                   left_slope.data() + D * n);
  }
  check_solved(left);
  return {left, left_slope};
}

}  // namespace
}  // namespace kernel

NB_MODULE(_kernel, module) {
  using namespace kernel;
  // Objects that caches of the package keep until the end of the process are no leaks.
  nb::set_leak_warnings(false);
  module.doc() = "Silhouettes of an instrument for many poses: sums, masks, coverage, outlines, and their derivatives.";

  nb::class_<Camera>(module, "Camera", "A camera and the distortion of its lens.")
      .def(
          "__init__",
          [](Camera* self, int width, int height, double fx, double fy, double cx, double cy, const std::string& model,
             const std::vector<double>& coefficients,
             double radius) { new (self) Camera(make_camera(width, height, fx, fy, cx, cy, model, coefficients, radius)); },
          "width"_a, "height"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "model"_a, "coefficients"_a, "radius"_a,
          "Take the intrinsics, px; no coefficients of other models than equidistant are a pinhole. The model holds up "
          "to an undistorted radius.");

  nb::class_<Chain>(module, "Chain", "A tree of K joints below a root link, every parent before its children.")
      .def(
          "__init__",
          [](Chain* self, const std::vector<int>& parents, const std::vector<int>& drivers, const std::vector<bool>& sliding,
             const std::vector<double>& multipliers, const std::vector<double>& offsets, const Given<double>& terms) {
            new (self) Chain(make_chain(parents, drivers, sliding, multipliers, offsets, terms));
          },
          "parents"_a, "drivers"_a, "sliding"_a, "multipliers"_a, "offsets"_a, "terms"_a,
          "Take the joints; their transforms are the sums of their terms (K, 3, 4, 4) with weights 1, sin q (or q of "
          "sliding ones) and cos q (or 1).")
      .def("forward", &forward, "values"_a, "selected"_a, "derivatives"_a,
           "Compute root_from_link (N, L, 4, 4) of selected joints' links, the root's for -1, from values (N, J), and "
           "the derivatives (N, J, L, 4, 4) or None.");

  nb::class_<Mesh>(module, "Mesh", "The meshes of the links of an instrument, with their edges.")
      .def(
          "__init__",
          [](Mesh* self, const std::vector<std::tuple<Given<double>, Given<Index>>>& links) {
            new (self) Mesh(make_mesh(links));
          },
          "links"_a, "Take vertices (V, 3), m, and faces (F, 3) of each link.")
      .def_prop_ro(
          "edges", [](const Mesh& mesh) { return mesh.edges.size(); }, "Number of edges.")
      .def("sums", &sums, "camera"_a, "camera_from_link"_a, "table"_a, "lines_per_pixel"_a, "to_pixel"_a, "threads"_a,
           "trace"_a.none(), "part"_a = nb::none(),
           "Sum K images, by their prefix sums (H, W + 1, K), over C silhouettes, and over those of the links from one to "
           "before another one, where these are given: (1 or 2, C, K).")
      .def("masks", &masks, "camera"_a, "camera_from_link"_a, "threads"_a, "trace"_a.none(),
           "Find the pixels whose centres are covered in C poses: (C, H, W).")
      .def("coverage", &coverage, "camera"_a, "camera_from_link"_a, "lines_per_pixel"_a, "threads"_a, "trace"_a.none(),
           "Compute the covered fraction of each pixel in C poses: (C, H, W).")
      .def("outlines", &outlines, "camera"_a, "camera_from_link"_a, "lines_per_pixel"_a, "threads"_a, "trace"_a.none(),
           "Find N points on the outlines of C poses: offsets (C + 1,) of the poses' points, links (N,), pixels (N, 2), "
           "normals (N, 2), points (N, 3) in the links' frames.")
      .def("compare", &compare, "camera"_a, "target"_a, "camera_from_root"_a, "root_from_link"_a, "by_joint"_a.none(),
           "camera_from_link"_a, "lines_per_pixel"_a, "cauchy"_a, "threads"_a, "trace"_a.none(),
           "Compare C silhouettes with a target: losses by widths, and outlines if derivatives by joints are given.")
      .def("difference", &difference, "camera"_a, "compared"_a, "camera_from_link"_a, "steps"_a, "lines_per_pixel"_a,
           "threads"_a, "trace"_a.none(),
           "Replace the Jacobians of C comparisons by central differences of outlines: of the links' poses "
           "(C * 2 D, L, 4, 4) after each of D steps (C, D) forwards, then after each backwards.")
      .def("contours", &contours, "camera"_a, "mask"_a, "weight"_a, "camera_from_root"_a, "root_from_link"_a, "by_joint"_a,
           "camera_from_link"_a, "errors"_a, "threads"_a, "trace"_a.none(),
           "Compare the outlines of C poses with the contour of a mask: information (C, D, D) and slope (C, D) of half the "
           "sums of squares (C,). All are zero where too few points have a contour within reach.");

  module.def("move_points", &move_points, "camera"_a, "begin"_a, "link"_a, "points"_a, "directions"_a, "camera_from_root"_a,
             "root_from_link"_a, "by_joint"_a,
             "Project N points of C poses: depths (N,), pixels (N, 2), Jacobians (N, 6 + J) along directions (N, 2).");
  nb::class_<Target>(module, "Target", "A mask, blurred, with which silhouettes are compared.")
      .def(
          "__init__",
          [](Target* self, const Given<float>& mask, const Given<float>& weight, const std::vector<float>& taps, int reach) {
            new (self) Target(make_target(mask, weight, taps, reach));
          },
          "mask"_a, "weight"_a, "taps"_a, "reach"_a,
          "Take mask and weights (H, W), the blur's filter from its middle outwards, and px along normals to sample.")
      .def_prop_ro(
          "image",
          [](const Target& target) {
            const std::size_t width = target.mask.width(), height = target.mask.height();
            Made<float> out = zeros<float>({height, width});
            for (std::size_t row = 0; row < height; ++row) {
              std::copy_n(target.mask.row(int(row)), width, out.data() + width * row);
            }
            return out;
          },
          nb::rv_policy::move, "The blurred mask (H, W).");

  nb::class_<ContourErrors>(module, "ContourErrors", "How the errors of a mask's contour are weighed.")
      .def("__init__", &make_contour_errors, "reach"_a, "least"_a, "normal_median"_a, "least_sigma"_a, "clip"_a,
           "correlated"_a, "length"_a, "farthest"_a, "grid"_a, "inflation"_a,
           "Take px up to which the contour is searched, points that are needed, the factor from a median to a standard "
           "deviation, its least, px, where it is cut, the correlated share of the variance, its length, px, how far "
           "errors are correlated, px, the variance of pixels, px^2, and a factor on variances.");
  nb::class_<Sharing>(module, "Sharing", "How errors are shared by the points of a contour.")
      .def(
          "__init__",
          [](Sharing* self, const std::optional<Given<double>>& shaft, double nodes, int least) {
            new (self) Sharing(make_sharing(shaft, nodes, least));
          },
          "shaft"_a.none(), "nodes"_a, "least"_a,
          "Take a point, m, and the direction of the shaft's axis (2, 3), m between nodes along it, and the number of "
          "points that an error displaces at least.");
  nb::class_<Shown>(module, "Shown", "How much larger errors are that a mask shows.")
      .def(
          "__init__", [](Shown* self, double usual, double factor, double most) { new (self) Shown{usual, factor, most}; },
          "usual"_a, "factor"_a, "most"_a, "Take px beyond which they are, standard deviations a pixel, and the most px.");

  nb::class_<Comparison>(module, "Comparison", "A silhouette compared with a mask.")
      .def_ro("losses", &Comparison::losses, "The Cauchy loss of each width that was asked for.")
      .def_ro("outlined", &Comparison::outlined, "Whether the N points of the outline were asked for.")
      .def_ro("differenced", &Comparison::differenced, "Whether their derivatives are by differences.")
      .def_ro("unknowns", &Comparison::unknowns, "Number D of the unknowns by which the points move.")
      .def("coverage", &coverage_of, "width"_a, "Return the covered fraction of each pixel before the blur, (H, W).")
      .def_prop_ro(
          "link",
          [](const Comparison& at) {
            return of_points<std::int64_t>(at, 0, [&](std::size_t i) { return &at.points[i].link; });
          },
          nb::rv_policy::move, "Number of the link of each point, (N,).")
      .def_prop_ro(
          "pixels",
          [](const Comparison& at) {
            return of_points<double>(at, 2, [&](std::size_t i) { return at.points[i].pixel.data(); });
          },
          nb::rv_policy::move, "The points (N, 2), px.")
      .def_prop_ro(
          "normals",
          [](const Comparison& at) {
            return of_points<double>(at, 2, [&](std::size_t i) { return at.points[i].normal.data(); });
          },
          nb::rv_policy::move, "Normals (N, 2), as long as the piece of outline that a point stands for, px.")
      .def_prop_ro(
          "points",
          [](const Comparison& at) {
            return of_points<double>(at, 3, [&](std::size_t i) { return at.points[i].point.data(); });
          },
          nb::rv_policy::move, "The points (N, 3) in the links' frames, m.")
      .def_prop_ro(
          "jacobian",
          [](const Comparison& at) {
            return of_points<double>(at, at.unknowns, [&](std::size_t i) { return at.jacobian.data() + at.unknowns * i; });
          },
          nb::rv_policy::move, "Derivatives (N, D) of the displacements along the unit normals, px.");

  module.def("normal_equations", &normal_equations, "compared"_a, "factors"_a, "density"_a, "cauchy"_a, "change"_a,
             "Compute information (C, D, D) and slope (C, D) of half the robust loss of C poses in V views, each with its "
             "factor, after small changes (C, D).");
  module.def(
      "shared_errors", &shared_errors, "link"_a, "normals"_a, "points"_a, "axis"_a, "deviations"_a, "sharing"_a,
      "offsets"_a.none(), "shown"_a,
      "Find the shared errors of an outline: shares (N, M) and standard deviations (M,), px, from those of sides of the "
      "shaft, the margin, nodes and other links; larger where offsets (N,), px, are given that show it.");
  module.def(
      "shared_equations", &shared_equations, "compared"_a, "factors"_a, "density"_a, "cauchy"_a, "stride"_a, "axes"_a,
      "deviations"_a, "sharing"_a, "more"_a, "offsets"_a, "shown"_a, "views"_a,
      "Compute information (C, A, A) and slope (C, A) of half the robust loss of C poses in V views, by every stride-th "
      "point, with the shared errors eliminated but for the two of each view that last: A = D + E + 2 V with "
      "displacements (N, E) by more unknowns.");
  module.def("signed_distances", &signed_distances, "mask"_a, "pixels"_a, "farthest"_a,
             "Compute the signed distances (N,), px, of pixels (N, 2) to the outline of a mask (H, W), negative inside, at "
             "most so many.");
  module.def("exp_rotation", &exponentials, "vectors"_a, "Convert rotation vectors (..., 3), rad, to matrices (..., 3, 3).");
  module.def("log_rotation", &logarithms, "rotations"_a, "Convert rotation matrices (..., 3, 3) to vectors (..., 3), rad.");
  module.def("moved", &moved, "poses"_a, "changes"_a,
             "Apply changes, the first six of (..., D), in the body's own axes, to poses (..., 4, 4).");
  module.def("change_between", &changes_between, "poses"_a, "others"_a,
             "Compute the changes (..., 6) by which poses (..., 4, 4) become others.");
  module.def("eliminate_chain", &eliminate_frames, "diagonal"_a, "beside"_a, "right"_a,
             "Eliminate N frames of a block-tridiagonal system one after the other: the inverses (N, M, M) of what is left "
             "of the diagonal, and what is left of the right sides (N, M, K).");
  module.def("eliminate_last", &eliminate_unknowns, "information"_a, "slope"_a, "known"_a,
             "Eliminate the last M unknowns of N quadratic terms, of which (M, M) is known beforehand: information "
             "(N, D, D) and slope (N, D) of the others.");
  module.def("fit_lines", &fit_lines, "points"_a, "normals"_a, "lines"_a, "sigma"_a, "near"_a, "facing"_a, "gap"_a,
             "least_sigma"_a, "reach"_a, "least_reach"_a, "normal_median"_a, "iterations"_a, "least"_a,
             "Fit lines (M, 3) to the contour points (N, 2) near them, robustly: each line (3,), the numbers of its points "
             "in their order along it, and their standard deviation, px.");
  module.def(
      "straight_stretches", &straight_stretches, "outline"_a, "corners"_a, "band"_a, "gap"_a, "shortest"_a, "side"_a,
      "Find stretches of an outline (N, 2) beside sides, of a least length, of its hull with corners (K, 2): of each the "
      "numbers of its points in their order, and their places along it, px.");
  module.def("sobel_at", &sobel_at, "image"_a, "pixels"_a,
             "Compute the derivatives (N, 2) of an image (H, W) along its rows and columns at some of its pixels (N, 2), by "
             "Sobel's filter.");
  module.def("line_support", &line_support, "points"_a, "normals"_a, "lines"_a, "sigma"_a, "facing"_a,
             "Compute the support (M,) of lines (M, 3) by contour points (N, 2), normally distributed about them with sigma "
             "px, and the weighted means (M, 2), px, of their points.");
  module.def("minimise", &minimise_all, "compared"_a, "factors"_a, "density"_a, "cauchy"_a, "weight"_a, "information"_a,
             "slope"_a, "damping"_a.none(), "iterations"_a, "solved"_a, "least"_a, "farthest"_a,
             "Find the changes (C, D) that minimise weights (C,) times half the robust losses plus quadratic terms, by at "
             "most so many steps each, up to one whose square is below a number. No point moves farther than so many px.");
}
