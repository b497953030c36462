// Errors that many points of a contour share, and what the contour tells of a pose once they are eliminated.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "comparison.hpp"

namespace kernel {

constexpr int kLasting = 2;  // errors, the first ones, that last from frame to frame: both sides of the shaft's
constexpr int kMargin = kLasting;

// How errors are shared: the axis of the shaft, if there is one, which is the root link; m between nodes along it; the
// number of points that an error displaces at least, for it to count.
struct Sharing {
  std::optional<std::array<Vector3, 2>> shaft;  // a point, m, and the direction
  double nodes;
  int least;
};

// Standard deviations, px, of the errors of a contour.
struct Deviations {
  double side, margin, node, link;
};

// How much larger errors are that the mask shows: by `factor` standard deviations a pixel beyond the usual, up to `most` px.
struct Shown {
  double usual, factor, most;
};

// M errors of N points of an outline: the shares with which the few that displace a point do so.
class SharedErrors {
 public:
  struct Share {
    int error;
    double of;
  };

  std::vector<double> deviations;  // (M,), px

  // `axis` is the unit vector in the image along which the shaft points; every `stride`-th point is used.
  SharedErrors(const std::vector<OutlinePoint>& points, int stride, const Vector2& axis, const Sharing& sharing,
               const Deviations& deviation) {
    deviations = {deviation.side, deviation.side, deviation.margin};
    std::array<double, 2> first, last;  // nodes along each side
    std::array<bool, 2> seen{};
    std::vector<std::array<double, 2>> facing;  // forwards and across
    std::vector<double> along;
    Index links = 0;
    for (std::size_t i = 0; i < points.size(); i += stride) {
      const OutlinePoint& at = points[i];
      const double length = std::sqrt(at.normal[0] * at.normal[0] + at.normal[1] * at.normal[1]);
      const double u = at.normal[0] / length, v = at.normal[1] / length;
      facing.push_back({u * axis[0] + v * axis[1], v * axis[0] - u * axis[1]});
      along.push_back(0.0);
      links = std::max(links, at.link + 1);
      if (!of_shaft(at, sharing)) continue;
      for (int k = 0; k < 3; ++k) along.back() += (at.point[k] - (*sharing.shaft)[0][k]) * (*sharing.shaft)[1][k];
      along.back() /= sharing.nodes;
      if (facing.back()[1] == 0.0) continue;
      const int side = facing.back()[1] < 0.0;
      const double from = std::floor(along.back()), to = std::ceil(along.back());
      first[side] = seen[side] ? std::min(first[side], from) : from;
      last[side] = seen[side] ? std::max(last[side], to) : to;
      seen[side] = true;
    }
    std::array<int, 2> nodes{};
    for (int side = 0; side < 2; ++side) {
      if (seen[side] && !(last[side] - first[side] < 1e5)) throw std::invalid_argument("points: expected a shorter shaft");
      nodes[side] = int(deviations.size());
      deviations.resize(deviations.size() + (seen[side] ? int(last[side] - first[side]) + 1 : 0), deviation.node);
    }
    const int others = int(deviations.size());
    deviations.resize(others + 4 * links, deviation.link);
    for (std::size_t k = 0; k < facing.size(); ++k) {
      const OutlinePoint& at = points[stride * k];
      const auto [ahead, aside] = facing[k];
      begin_.push_back(shares_.size());
      const bool shaft = of_shaft(at, sharing);
      const int side = aside < 0.0;
      if (shaft && aside != 0.0) shares_.push_back({side, 1.0});
      shares_.push_back({kMargin, 1.0});
      if (shaft && aside != 0.0) {
        const double node = std::floor(along[k]), rest = along[k] - node;
        const int error = nodes[side] + int(node - first[side]);
        shares_.push_back({error, 1.0 - rest});
        if (rest > 0.0) shares_.push_back({error + 1, rest});
      } else if (!shaft) {
        if (ahead != 0.0) shares_.push_back({others + 4 * at.link + (ahead < 0.0), std::abs(ahead)});
        if (aside != 0.0) shares_.push_back({others + 4 * at.link + 2 + (aside < 0.0), std::abs(aside)});
      }
    }
    begin_.push_back(shares_.size());
    leave_out_rare(sharing.least);
  }

  std::size_t points() const { return begin_.size() - 1; }

  template <class Use>
  void each(std::size_t point, const Use& use) const {
    for (std::size_t i = begin_[point]; i < begin_[point + 1]; ++i) use(shares_[i].error, shares_[i].of);
  }

  // Make standard deviations as large as the mask shows the errors, by how much it lies outwards of the points, px. The
  // margin of the whole mask stays as it is.
  void enlarge(const double* offsets, const Shown& shown) {
    std::vector<double> sums(deviations.size()), shares(deviations.size());
    for (std::size_t k = 0; k < points(); ++k) {
      const double off = within(offsets[k], -shown.most, shown.most);
      each(k, [&](int error, double of) { sums[error] += of * off, shares[error] += of; });
    }
    for (std::size_t m = 0; m < deviations.size(); ++m) {
      if (m == kMargin) continue;
      const double more = shown.factor * std::max(std::abs(sums[m] / std::max(shares[m], 1e-9)) - shown.usual, 0.0);
      deviations[m] = std::sqrt(deviations[m] * deviations[m] + more * more);
    }
  }

 private:
  static bool of_shaft(const OutlinePoint& at, const Sharing& sharing) { return sharing.shaft && at.link == 0; }

  // Leave out errors of too few points; those that last and the margin stay.
  void leave_out_rare(int least) {
    std::vector<int> counts(deviations.size()), place(deviations.size(), -1);
    for (const Share& one : shares_) ++counts[one.error];
    std::vector<double> kept;
    for (std::size_t m = 0; m < deviations.size(); ++m) {
      if (m > kMargin && counts[m] < least) continue;
      place[m] = int(kept.size()), kept.push_back(deviations[m]);
    }
    deviations = kept;
    std::vector<Share> shares;
    std::vector<std::size_t> begin;
    for (std::size_t k = 0; k + 1 < begin_.size(); ++k) {
      begin.push_back(shares.size());
      each(k, [&](int error, double of) {
        if (place[error] >= 0) shares.push_back({place[error], of});
      });
    }
    begin.push_back(shares.size());
    shares_ = std::move(shares), begin_ = std::move(begin);
  }

  std::vector<Share> shares_;
  std::vector<std::size_t> begin_;  // of each point's shares
};

// Numbers of the unknowns of a pose's term: D by which the points move, E more displacements of them, and the lasting errors
// of V views, of which this is one.
struct Unknowns {
  int moving, more, views, view;

  int kept() const { return moving + more + kLasting * views; }
};

// Adds information (A, A) and slope (A,) of half the robust loss of a view of a pose, of its A = D + E + 2 V unknowns, with
// the other errors eliminated. `more` (N, E) are px of displacement of the N points, every `stride`-th one.
inline void add_shared_equations(const Comparison& at, int stride, const std::vector<double>& density, double cauchy,
                                 double factor, const SharedErrors& errors, const double* more, const Unknowns& unknowns,
                                 double* information, double* slope) {
  const std::size_t A = unknowns.kept(), R = errors.deviations.size() - kLasting, all = A + R;
  std::vector<double> square(all * all), line(all), known(R * R);
  std::vector<std::pair<std::size_t, double>> row;
  const double scale = 1.0 / (cauchy * cauchy);
  for (std::size_t k = 0; k < errors.points(); ++k) {
    const std::size_t i = stride * k;
    auto [across, along] = pull(at, i, 0.0, density, scale);
    if (across == 0.0) continue;
    across *= factor * stride, along *= factor * stride;
    row.clear();
    for (int d = 0; d < unknowns.moving; ++d) row.emplace_back(row.size(), at.jacobian[at.unknowns * i + d]);
    for (int e = 0; e < unknowns.more; ++e) row.emplace_back(row.size(), more[unknowns.more * k + e]);
    errors.each(k, [&](int error, double of) {
      if (error < kLasting) {
        row.emplace_back(A - kLasting * (unknowns.views - unknowns.view) + error, of * errors.deviations[error]);
      } else {
        row.emplace_back(A + error - kLasting, of);
      }
    });
    for (std::size_t a = 0; a < row.size(); ++a) {
      const double left = across * row[a].second;
      line[row[a].first] += along * row[a].second;
      for (std::size_t b = 0; b <= a; ++b) square[all * row[a].first + row[b].first] += left * row[b].second;
    }
  }
  for (std::size_t a = 0; a < all; ++a) {
    for (std::size_t b = 0; b < a; ++b) square[all * b + a] = square[all * a + b];
  }
  for (std::size_t m = 0; m < R; ++m) {
    const double deviation = errors.deviations[kLasting + m];
    known[(R + 1) * m] = 1.0 / (deviation * deviation);
  }
  std::vector<double> left(A * A), left_line(A);
  eliminate_last(square.data(), line.data(), known.data(), A, R, left.data(), left_line.data());
  for (std::size_t k = 0; k < A * A; ++k) information[k] += left[k];
  for (std::size_t k = 0; k < A; ++k) slope[k] += left_line[k];
}

}  // namespace kernel
