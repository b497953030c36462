// The meshes of an instrument's links, with the planes of their faces and their edges.
//
// The layer count of an image point is the number of triangles that project onto it. It changes only across outline
// edges: edges between a front-facing and a back-facing triangle, boundary edges with a single face, and edges between
// two faces of opposite winding that are both front-facing or both back-facing. Edges with more than two faces are
// split into pairs of faces; this is exact, because the change of the layer count across an edge is a sum over its
// faces.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "camera.hpp"

namespace kernel {

using Index = std::int32_t;
using Triangle = std::array<Index, 3>;

struct Edge {
  Index start, end;     // vertices, in the winding order of the first face
  Index first, second;  // faces; those of a boundary edge are the same
  bool flip;            // an edge is outline where front(first) xor front(second) xor flip

  // Magnitude of the change of the layer count across the edge where it is outline.
  int weight() const { return first == second ? 1 : 2; }
};

// A link: its vertices, faces and edges are those from `*_begin` to the next link's. The first of its edges, up to
// `flip_begin`, do not flip; nearly all do not.
struct Link {
  Index vertex_begin, face_begin, edge_begin, flip_begin;
  Vector3 low, high;  // corners of its bounding box, m
};

class Mesh {
 public:
  std::vector<Vector3> vertices;  // m, in the frames of their links
  std::vector<Triangle> faces;    // indices of vertices of all links
  std::vector<Edge> edges;
  std::vector<Link> links;           // and one more, which begins where the last one ends
  std::vector<Index> first, second;  // faces of the edges, by themselves
  // Planes of faces: a face is front-facing from a camera at c if normal @ c + offset > 0.
  std::vector<float> normal_x, normal_y, normal_z, offset;

  Mesh() { links.push_back({}); }

  int link_count() const { return static_cast<int>(links.size()) - 1; }

  // Add a link of V > 0 vertices (V, 3) and F faces (F, 3), whose indices are within these.
  void add(const double* points, std::size_t point_count, const Index* corners, std::size_t face_count) {
    const Index base = static_cast<Index>(vertices.size()), first_face = static_cast<Index>(faces.size());
    Vector3 low = {points[0], points[1], points[2]}, high = low;
    for (std::size_t i = 0; i < 3 * point_count; i += 3) {
      vertices.push_back({points[i], points[i + 1], points[i + 2]});
      for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], points[i + k]), high[k] = std::max(high[k], points[i + k]);
    }
    for (std::size_t i = 0; i < 3 * face_count; i += 3) {
      faces.push_back({base + corners[i], base + corners[i + 1], base + corners[i + 2]});
      add_plane(faces.back());
    }
    links.back().low = low, links.back().high = high;
    const std::size_t first_edge = edges.size();
    pair_edges(base, first_face);
    const auto flips =
        std::stable_partition(edges.begin() + first_edge, edges.end(), [](const Edge& edge) { return !edge.flip; });
    links.back().flip_begin = static_cast<Index>(flips - edges.begin());
    for (std::size_t i = first_edge; i < edges.size(); ++i) {
      first.push_back(edges[i].first), second.push_back(edges[i].second);
    }
    links.push_back({static_cast<Index>(vertices.size()),
                     static_cast<Index>(faces.size()),
                     static_cast<Index>(edges.size()),
                     0,
                     {},
                     {}});
  }

 private:
  void add_plane(const Triangle& face) {
    const Vector3 &a = vertices[face[0]], &b = vertices[face[1]], &c = vertices[face[2]];
    const Vector3 p = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, q = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    Vector3 n = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
    const double length = std::max(std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-30);
    double off = 0.0;
    for (int k = 0; k < 3; ++k) n[k] /= length, off -= n[k] * (a[k] + b[k] + c[k]) / 3.0;
    normal_x.push_back(static_cast<float>(n[0])), normal_y.push_back(static_cast<float>(n[1]));
    normal_z.push_back(static_cast<float>(n[2])), offset.push_back(static_cast<float>(off));
  }

  struct HalfEdge {
    Index low, high, face;
    bool forward;  // from the lower to the higher vertex
  };

  // Pair the faces of the last link along its edges. At each edge faces of either winding are paired with each other
  // as far as there are such, and those that are left with each other.
  void pair_edges(Index base, Index first_face) {
    const std::size_t count = vertices.size() - base;
    std::vector<std::size_t> begin(count + 1, 0);
    const auto each_half = [&](const auto& use) {
      for (std::size_t face = first_face; face < faces.size(); ++face) {
        for (int k = 0; k < 3; ++k) {
          const Index a = faces[face][k], b = faces[face][(k + 1) % 3];
          use(HalfEdge{std::min(a, b), std::max(a, b), static_cast<Index>(face), a < b});
        }
      }
    };
    each_half([&](const HalfEdge& half) { ++begin[half.low - base + 1]; });
    for (std::size_t i = 1; i <= count; ++i) begin[i] += begin[i - 1];
    std::vector<HalfEdge> halves(begin.back());
    std::vector<std::size_t> next(begin.begin(), begin.end() - 1);
    each_half([&](const HalfEdge& half) { halves[next[half.low - base]++] = half; });
    for (std::size_t i = 0; i < count; ++i) {
      const auto from = halves.begin() + begin[i], to = halves.begin() + begin[i + 1];
      std::stable_sort(from, to, [](const HalfEdge& a, const HalfEdge& b) { return a.high < b.high; });
      for (auto one = from; one != to;) {
        const auto other = std::find_if(one, to, [&](const HalfEdge& half) { return half.high != one->high; });
        pair_group(one, other);
        one = other;
      }
    }
  }

  using Halves = std::vector<HalfEdge>::const_iterator;

  void pair_group(Halves from, Halves to) {
    std::vector<HalfEdge> rest[2];
    for (; from != to; ++from) {
      const HalfEdge& half = *from;
      std::vector<HalfEdge>& opposite = rest[!half.forward];
      if (opposite.empty()) {
        rest[half.forward].push_back(half);
      } else {
        add_edge(opposite.front(), half.face, false);
        opposite.erase(opposite.begin());
      }
    }
    for (const std::vector<HalfEdge>& alike : rest) {
      for (std::size_t i = 0; i < alike.size(); i += 2) {
        add_edge(alike[i], i + 1 == alike.size() ? alike[i].face : alike[i + 1].face, true);
      }
    }
  }

  void add_edge(const HalfEdge& half, Index second, bool flip) {
    const Index start = half.forward ? half.low : half.high, end = half.forward ? half.high : half.low;
    edges.push_back({start, end, half.face, second, flip});
  }
};

}  // namespace kernel
