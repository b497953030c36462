// The outline edges of one pose as pieces that are straight in the image.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "camera.hpp"
#include "mesh.hpp"

namespace kernel {

// A vertex, or another point of a mesh, in the image; `inverse` is 1 / depth, 1/m.
struct Projected {
  Vector2 undistorted, pixel;
  double inverse;
};

// A part of an edge that is straight in the image. `chord` is the edge's number, or that of a cut (see `Outline`).
struct Piece {
  Vector2 from, to;  // px
  Index chord;
  int change;  // of the layer count from the left to the right side, where the piece runs downwards

  // An aggregate would be made elsewhere and copied in wider parts than it was written in, which stalls the processor.
  Piece(const Vector2& from, const Vector2& to, Index chord, int change)
      : from(from), to(to), chord(chord), change(change) {}
};

// Finds the outline of one pose after another; its arrays keep their memory.
class Outline {
 public:
  std::vector<Piece> pieces;

  // `links` holds camera_from_link (L, 4, 4); an image of a straight line that is shorter than `straight`, px, is taken
  // to be straight.
  void find(const Mesh& mesh, const Camera& camera, const double* links, double straight) {
    mesh_ = &mesh, camera_ = &camera, straight_ = straight;
    pieces.clear(), shares_.clear(), cuts_.clear(), begin_.clear();
    front_.resize(mesh.faces.size());
    outline_.resize(mesh.edges.size());
    seen_.resize(mesh.vertices.size());
    known_.assign(mesh.vertices.size(), 0);
    for (int link = 0; link < mesh.link_count(); ++link) {
      begin_.push_back(pieces.size());
      find_link(link, Pose{links + 16 * link});
    }
  }

  // The link of a piece.
  int link_of(std::size_t piece) const {
    int link = static_cast<int>(begin_.size()) - 1;
    while (begin_[link] > piece) --link;
    return link;
  }

  // The number of the first piece of a link, or of the end.
  Index first_piece(int link) const {
    return static_cast<Index>(link < static_cast<int>(begin_.size()) ? begin_[link] : pieces.size());
  }

  // Whether a piece lies in the near plane, where it cuts a face.
  bool on_near_plane(const Piece& piece) const { return piece.chord < 0 && cuts_[~piece.chord].on_near_plane; }

  struct SurfacePoint {
    Index link;
    Vector3 point;  // m, in the link's frame
    Vector2 undistorted;
  };

  // The point of the surface at a share of the way along a piece.
  SurfacePoint surface_point(const Piece& piece, double share) const {
    if (!shares_.empty()) {
      const Vector2 ends = shares_[&piece - pieces.data()];
      share = ends[0] + share * (ends[1] - ends[0]);
    }
    if (piece.chord < 0) {
      const Cut& cut = cuts_[~piece.chord];
      return between(cut.link, cut.from, cut.to, cut.seen_from, cut.seen_to, share);
    }
    const Edge& edge = mesh_->edges[piece.chord];
    const auto beyond = [](const Link& link, Index vertex) { return link.vertex_begin <= vertex; };
    Index link = 0;
    while (beyond(mesh_->links[link + 1], edge.start)) ++link;
    return between(link, mesh_->vertices[edge.start], mesh_->vertices[edge.end], seen_[edge.start], seen_[edge.end], share);
  }

 private:
  // The part of an edge before the near plane, or the line along which this plane cuts a face. Its number is the
  // complement of its place, so that it is none of an edge.
  struct Cut {
    Index link;
    Vector3 from, to;  // m, in the link's frame
    Projected seen_from, seen_to;
    bool on_near_plane;
  };

  // The point at a share of the way in the undistorted image, along which 1 / depth is linear.
  static SurfacePoint between(Index link, const Vector3& from, const Vector3& to, const Projected& seen_from,
                              const Projected& seen_to, double share) {
    const Vector2 &a = seen_from.undistorted, &b = seen_to.undistorted;
    const double inverse = seen_from.inverse + share * (seen_to.inverse - seen_from.inverse);
    const double along = share * seen_to.inverse / inverse;
    return {link,
            {from[0] + along * (to[0] - from[0]), from[1] + along * (to[1] - from[1]), from[2] + along * (to[2] - from[2])},
            {a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])}};
  }

  void find_link(Index link, Pose pose) {
    const Link& part = mesh_->links[link];
    const Index face_end = mesh_->links[link + 1].face_begin;
    find_front(part.face_begin, face_end, pose);
    const bool cut = nearest_corner(part, pose) < 1.01 * kNear && find_depths(link, pose);
    const auto vertex = [&](Index i) -> const Projected& {
      if (!known_[i]) seen_[i] = project(pose.apply(mesh_->vertices[i])), known_[i] = 1;
      return seen_[i];
    };
    const Index count = find_edges(link);
    for (Index k = 0; k < count; ++k) {
      const Index number = outline_[k];
      const Edge& edge = mesh_->edges[number];
      const int change = front_[edge.first] ? edge.weight() : -edge.weight();
      if (cut && (behind_[edge.start] || behind_[edge.end])) {
        if (behind_[edge.start] && behind_[edge.end]) continue;
        const auto [there, point] = cut_point(edge.start, edge.end, pose);
        const Index kept = behind_[edge.start] ? edge.end : edge.start;
        const Vector3& own = mesh_->vertices[kept];
        const Projected& seen = vertex(kept);
        if (kept == edge.start) {
          add_cut({link, own, point, seen, there, false}, change);
        } else {
          add_cut({link, point, own, there, seen, false}, change);
        }
      } else {
        const Projected &from = vertex(edge.start), &to = vertex(edge.end);
        add(number, from, to, change);
      }
    }
    if (cut) close_cuts(link, part.face_begin, face_end, pose);
  }

  void find_front(Index begin, Index end, Pose pose) {
    const Vector3 centre = pose.centre();
    const float x = static_cast<float>(centre[0]), y = static_cast<float>(centre[1]);
    const float z = static_cast<float>(centre[2]);
    const float *nx = mesh_->normal_x.data(), *ny = mesh_->normal_y.data(), *nz = mesh_->normal_z.data();
    const float* offset = mesh_->offset.data();
    std::uint8_t* front = front_.data();
    for (Index f = begin; f < end; ++f) front[f] = nx[f] * x + ny[f] * y + nz[f] * z + offset[f] > 0.0f;
  }

  // Write the numbers of a link's outline edges; returns how many there are.
  Index find_edges(Index link) {
    const Link& part = mesh_->links[link];
    const std::uint8_t* front = front_.data();
    const Index *first = mesh_->first.data(), *second = mesh_->second.data();
    Index *found = outline_.data(), count = 0;
    for (Index e = part.edge_begin; e < part.flip_begin; ++e) {
      found[count] = e;
      count += front[first[e]] ^ front[second[e]];
    }
    for (Index e = part.flip_begin; e < mesh_->links[link + 1].edge_begin; ++e) {
      if (front[first[e]] == front[second[e]]) found[count++] = e;
    }
    return count;
  }

  double nearest_corner(const Link& part, Pose pose) const {
    double nearest = pose.m[11];
    for (int k = 0; k < 3; ++k) nearest += std::min(pose.m[8 + k] * part.low[k], pose.m[8 + k] * part.high[k]);
    return nearest;
  }

  // Find which vertices of a link are behind the near plane; returns whether any is.
  bool find_depths(Index link, Pose pose) {
    depth_.resize(mesh_->vertices.size()), behind_.resize(mesh_->vertices.size());
    bool any = false;
    for (Index i = mesh_->links[link].vertex_begin; i < mesh_->links[link + 1].vertex_begin; ++i) {
      depth_[i] = pose.depth(mesh_->vertices[i]);
      behind_[i] = depth_[i] < kNear;
      any |= behind_[i] != 0;
    }
    return any;
  }

  Projected project(const Vector3& point) const {
    const Vector2 undistorted = {point[0] / point[2], point[1] / point[2]};
    return {undistorted, camera_->pixel(undistorted), 1.0 / point[2]};
  }

  // Where an edge meets the near plane. Its vertices are taken in the order of their numbers, so that all faces at the
  // edge are cut at the same point.
  std::pair<Projected, Vector3> cut_point(Index one, Index other, Pose pose) const {
    const Index low = std::min(one, other), high = std::max(one, other);
    const Vector3 &a = mesh_->vertices[low], &b = mesh_->vertices[high];
    const double share = (kNear - depth_[low]) / (depth_[high] - depth_[low]);
    const Vector3 point = {a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])};
    Vector3 seen = pose.apply(point);
    seen[2] = kNear;
    return {project(seen), point};
  }

  // Add the lines along which the near plane cuts faces. They close the cut mesh, so that the changes of the layer
  // count sum to zero on every line of the image.
  void close_cuts(Index link, Index begin, Index end, Pose pose) {
    for (Index f = begin; f < end; ++f) {
      const Triangle& face = mesh_->faces[f];
      const int count = behind_[face[0]] + behind_[face[1]] + behind_[face[2]];
      if (count == 0 || count == 3) continue;
      int leaves = 0, returns = 0;  // the sides on which the boundary passes behind the plane and comes back
      for (int k = 0; k < 3; ++k) {
        const bool from = behind_[face[k]], to = behind_[face[(k + 1) % 3]];
        if (!from && to) leaves = k;
        if (from && !to) returns = k;
      }
      const auto [a, from] = cut_point(face[leaves], face[(leaves + 1) % 3], pose);
      const auto [b, to] = cut_point(face[returns], face[(returns + 1) % 3], pose);
      add_cut({link, from, to, a, b, true}, front_[f] ? 1 : -1);
    }
  }

  void add_cut(const Cut& cut, int change) {
    cuts_.push_back(cut);
    add(~static_cast<Index>(cuts_.size() - 1), cut.seen_from, cut.seen_to, change);
  }

  void add(Index chord, const Projected& from, const Projected& to, int change) {
    if (camera_->is_pinhole()) {
      pieces.emplace_back(from.pixel, to.pixel, chord, change);
    } else {
      add_bent(chord, from, to, change);
    }
  }

  // Add the pieces of a line that the lens may bend.
  void add_bent(Index chord, const Projected& from, const Projected& to, int change) {
    Vector2 last = from.pixel;
    double last_share = 0.0;
    const auto add_until = [&](double share, Vector2 pixel) {
      pieces.emplace_back(last, pixel, chord, change);
      shares_.push_back({last_share, share});
      last = pixel, last_share = share;
    };
    const double dx = to.undistorted[0] - from.undistorted[0], dy = to.undistorted[1] - from.undistorted[1];
    const double across = dx * camera_->fx, down = dy * camera_->fy;
    const double square = across * across + down * down;
    if (square > straight_ * straight_) {
      const double length = std::sqrt(square);
      // Only the part within the square around the circle in which the model holds is bent.
      double enter = 0.0, leave = 1.0;
      for (int k = 0; k < 2; ++k) {
        const double start = from.undistorted[k], step = k ? dy : dx, safe = std::abs(step) < 1e-12 ? 1e-12 : step;
        const double a = (-camera_->lens.radius - start) / safe, b = (camera_->lens.radius - start) / safe;
        enter = std::max(enter, std::min(a, b)), leave = std::min(leave, std::max(a, b));
      }
      if (enter < leave) {
        const int count = static_cast<int>(std::ceil(length * (leave - enter) / straight_));
        for (int k = enter > 0.0 ? 0 : 1; k <= count; ++k) {
          const double share = enter + (leave - enter) * k / count;
          if (share >= 1.0) break;
          add_until(share, camera_->pixel({from.undistorted[0] + share * dx, from.undistorted[1] + share * dy}));
        }
      }
    }
    add_until(1.0, to.pixel);
  }

  const Mesh* mesh_ = nullptr;
  const Camera* camera_ = nullptr;
  double straight_ = 0.0;
  std::vector<std::uint8_t> front_, known_, behind_;
  std::vector<Projected> seen_;
  std::vector<double> depth_;
  std::vector<Index> outline_;
  std::vector<Cut> cuts_;
  std::vector<std::size_t> begin_;  // number of the first piece of each link
  std::vector<Vector2> shares_;     // of the undistorted chord at the ends of each piece, where the lens bends lines
};

}  // namespace kernel
