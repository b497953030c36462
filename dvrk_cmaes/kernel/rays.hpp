// Rays through the spans between neighbouring crossings of image lines: one decides whether a span is covered.
//
// Coverage changes only where a line crosses an outline edge, so any point of a span tells; its middle is farthest from
// both ends. The outline of a link encloses what the link covers: a ray is traced against a link only where the line
// crosses the link's outline before and after the span.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "lines.hpp"

namespace kernel {

// The spans of many poses' lines, and what their rays have hit so far.
class SpanRays {
 public:
  // Add the spans of the lines of a pose, whose links are camera_from_link (L, 4, 4). Those shorter than `shortest`, px,
  // are not traced. With `to_pixel`, rays pass the centres of pixels, and spans without one are not traced.
  void add(Lines& lines, const Outline& outline, const Camera& camera, const double* links, bool to_pixel, double shortest) {
    const double extent = lines.grid.extent;
    const auto start_of = [&](const Crossing& crossing) {
      return to_pixel ? within(std::ceil(crossing.along), 0.0, extent) : crossing.along;
    };
    for (int line = 0; line < lines.grid.count(); ++line) {
      const Index begin = lines.begin[line], end = lines.begin[line + 1];
      find_enclosing(lines, outline, begin, end);
      for (Index i = begin; i + 1 < end; ++i) {
        const double start = start_of(lines.crossings[i]), length = start_of(lines.crossings[i + 1]) - start;
        if (length < (to_pixel ? 1.0 : shortest)) continue;
        double middle = start + 0.5 * length;
        if (to_pixel) middle = std::floor(middle - 0.5);
        const double across = lines.grid.place_of(line);
        const Vector2 pixel = lines.grid.vertical ? Vector2{across, middle} : Vector2{middle, across};
        rays_.push_back({&lines, i, links, camera.undistorted(pixel), enclosing_[i - begin]});
      }
    }
    all_.push_back(&lines);
  }

  // The numbers of the rays that may hit a link and have not hit another one.
  const std::vector<std::size_t>& towards(int link) {
    chosen_.clear();
    for (std::size_t i = 0; i < rays_.size(); ++i) {
      if (rays_[i].links & bit(link)) chosen_.push_back(i);
    }
    return chosen_;
  }

  // Write origin and direction of a ray, (3,) each, in the frame of a link.
  void write(std::size_t number, int link, float* origin, float* direction) const {
    const Ray& ray = rays_[number];
    const Pose pose{ray.camera_from_link + 16 * link};
    const Vector3 centre = pose.centre();
    for (int k = 0; k < 3; ++k) {
      const double along = pose.m[k] * ray.at[0] + pose.m[4 + k] * ray.at[1] + pose.m[8 + k];
      direction[k] = static_cast<float>(along), origin[k] = static_cast<float>(centre[k] + kNear * along);
    }
  }

  // Note that a ray has hit a link.
  void mark(std::size_t number) {
    rays_[number].lines->crossings[rays_[number].crossing].covered = true;
    rays_[number].links = 0;
  }

  // Decide what was not traced: a short span is as the one before it, and nothing is covered after the last crossing.
  void finish() {
    std::size_t next = 0;
    for (Lines* lines : all_) {
      for (int line = 0; line < lines->grid.count(); ++line) {
        bool covered = false;
        for (Index i = lines->begin[line]; i < lines->begin[line + 1]; ++i) {
          Crossing& crossing = lines->crossings[i];
          const bool traced = next < rays_.size() && rays_[next].lines == lines && rays_[next].crossing == i;
          if (traced) ++next, covered = crossing.covered;
          crossing.covered = covered && i + 1 < lines->begin[line + 1];
        }
      }
    }
    rays_.clear(), all_.clear();
  }

 private:
  struct Ray {
    Lines* lines;
    Index crossing;  // at which the span begins
    const double* camera_from_link;
    Vector2 at;           // in the undistorted image, at depth 1
    std::uint64_t links;  // that it may hit, a bit for each; none once it has hit one
  };

  static std::uint64_t bit(int link) { return std::uint64_t(1) << (link % 64); }

  // Find the links whose outline a line crosses both before and after each of its spans.
  void find_enclosing(const Lines& lines, const Outline& outline, Index begin, Index end) {
    enclosing_.resize(std::max(end - begin, 0)), crossed_.resize(enclosing_.size());
    std::uint64_t seen = 0;
    for (Index i = begin; i < end; ++i) {
      crossed_[i - begin] = bit(outline.link_of(lines.crossings[i].piece));
      enclosing_[i - begin] = seen |= crossed_[i - begin];
    }
    seen = 0;
    for (Index i = end; i-- > begin;) {
      enclosing_[i - begin] &= seen;
      seen |= crossed_[i - begin];
    }
  }

  std::vector<Ray> rays_;
  std::vector<Lines*> all_;
  std::vector<std::size_t> chosen_;
  std::vector<std::uint64_t> enclosing_, crossed_;
};

}  // namespace kernel
