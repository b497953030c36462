// An image that is mostly 0 and 1, blurred: only what is near a change of its values is computed.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "lines.hpp"

namespace kernel {

// Pixels of a row with the same value, up to the next run.
struct Run {
  int begin;
  float value;
};

// A set of the columns of each row, a bit for each.
class Columns {
 public:
  void resize(int width, int height) {
    words_ = (width + 63) / 64, width_ = width;
    bits_.assign(std::size_t(words_) * height, 0);
  }

  // Add the columns from `begin` to before `end`, as far as there are such.
  void add(int row, int begin, int end) {
    begin = std::max(begin, 0), end = std::min(end, width_);
    if (begin >= end) return;
    std::uint64_t* bits = bits_.data() + std::size_t(words_) * row;
    const int first = begin / 64, last = (end - 1) / 64;
    const std::uint64_t from = ~std::uint64_t(0) << (begin % 64), to = ~std::uint64_t(0) >> (63 - (end - 1) % 64);
    if (first == last) {
      bits[first] |= from & to;
      return;
    }
    bits[first] |= from, bits[last] |= to;
    for (int i = first + 1; i < last; ++i) bits[i] = ~std::uint64_t(0);
  }

  void add_row(int row, const Columns& other, int other_row) {
    std::uint64_t* bits = bits_.data() + std::size_t(words_) * row;
    const std::uint64_t* more = other.bits_.data() + std::size_t(words_) * other_row;
    for (int i = 0; i < words_; ++i) bits[i] |= more[i];
  }

  // Call `use(begin, end)` with each stretch of neighbouring columns of a row.
  template <class Use>
  void each(int row, const Use& use) const {
    each_of_both(row, *this, use);
  }

  // The same of the columns that are in this set or in another one.
  template <class Use>
  void each_of_both(int row, const Columns& other, const Use& use) const {
    const std::uint64_t* own = bits_.data() + std::size_t(words_) * row;
    const std::uint64_t* more = other.bits_.data() + std::size_t(words_) * row;
    int begin = -1;
    for (int i = 0; i < words_; ++i) {
      const std::uint64_t bits = own[i] | more[i];
      if (bits == (begin < 0 ? 0 : ~std::uint64_t(0))) continue;
      for (int at = 0; at < 64;) {
        const std::uint64_t rest = (begin < 0 ? bits : ~bits) >> at;
        if (rest == 0) break;
        at += lowest_bit(rest);
        if (begin < 0) {
          begin = 64 * i + at;
        } else {
          use(begin, 64 * i + at);
          begin = -1;
        }
      }
    }
    if (begin >= 0) use(begin, width_);
  }

 private:
  static int lowest_bit(std::uint64_t bits) {
    int place = 0;
    for (int half = 32; half > 0; half /= 2) {
      if ((bits & ((std::uint64_t(1) << half) - 1)) == 0) bits >>= half, place += half;
    }
    return place;
  }

  int words_ = 0, width_ = 0;
  std::vector<std::uint64_t> bits_;
};

// An image that is made row by row of runs, and blurred by a separable filter of odd length. Beyond its borders it has the
// values at these. Its arrays keep their memory.
class Blurred {
 public:
  std::vector<Run> runs;     // of the image before the blur, row by row
  std::vector<Index> first;  // number of the first run of each row, and one more
  Columns band;              // where the blurred image may differ from the image

  // Begin an image. `taps` are those of the filter from its middle outwards; with both sides they sum to 1.
  void begin(int width, int height, const std::vector<float>& taps) {
    clear();
    width_ = width, height_ = height, taps_ = taps, radius_ = static_cast<int>(taps.size()) - 1;
    stride_ = width + 2 * radius_;
    const std::size_t size = std::size_t(stride_) * height;
    if (image_.size() < size) image_.resize(size, 0.0f), across_.resize(size);
    used_.assign(height, 0);
    runs.clear(), first.assign(1, 0);
  }

  // End a row, whose runs were appended.
  void end_row() { first.push_back(static_cast<Index>(runs.size())); }

  // Append the rows of the covered fraction of each pixel. Places are rounded to 2^-16 px, so that sums are exact.
  void cover(const Lines& lines) {
    constexpr int kOne = 1 << 16;
    const int per_pixel = lines.grid.per_pixel;
    int row = 0;
    const auto add = [&](int column, std::int32_t change) {
      if (change == 0 || column >= width_) return;
      changes_.push_back({column, change});
      for (std::size_t i = changes_.size() - 1; i > 0 && changes_[i - 1].column > column; --i) {
        std::swap(changes_[i - 1], changes_[i]);
      }
    };
    const auto finish_row = [&] {
      if (changes_.empty() || changes_[0].column > 0) runs.push_back({0, 0.0f});
      std::int32_t sum = 0;
      for (std::size_t i = 0; i < changes_.size(); ++i) {
        sum += changes_[i].change;
        if (i + 1 < changes_.size() && changes_[i + 1].column == changes_[i].column) continue;
        runs.push_back({changes_[i].column, sum / (kOne * float(per_pixel))});
      }
      changes_.clear();
      end_row();
    };
    lines.each_span([&](int line, const Crossing& start, const Crossing& end) {
      for (; row < line / per_pixel; ++row) finish_row();
      for (const Crossing* crossing : {&start, &end}) {
        const double along = std::clamp(crossing->along + 0.5, 0.0, double(width_));
        const int place = static_cast<int>(along * kOne + 0.5), rest = place % kOne;
        const int sign = crossing == &start ? 1 : -1;
        add(place / kOne, sign * (kOne - rest));
        add(place / kOne + 1, sign * rest);
      }
    });
    for (; row < height_; ++row) finish_row();
  }

  // Blur the image, all of whose rows were added.
  void blur() {
    along_.resize(width_, height_), edge_.resize(width_, height_), band.resize(width_, height_);
    for (int row = 0; row < height_; ++row) {
      fill(row);
      if (row + 1 < height_) find_edge(row);
      along_.each(row, [&](int begin, int end) { blur_along(row, begin, end); });
    }
    for (int row = 0; row < height_; ++row) {
      band.add_row(row, along_, row);
      const int last = std::min(row + radius_, height_ - 1);
      for (int k = std::max(row - radius_, 0); k < last; ++k) band.add_row(row, edge_, k);
      band.each(row, [&](int begin, int end) { blur_across(row, begin, end); });
    }
    for (int row = 0; row < height_; ++row) {
      band.each(row, [&](int begin, int end) {
        const float* from = across_.data() + offset(row, 0);
        std::copy(from + begin, from + end, image_.data() + offset(row, begin));
        used_[row] = 1;
      });
    }
  }

  int width() const { return width_; }
  int height() const { return height_; }
  int stride() const { return stride_; }  // of the rows of the blurred image
  const float* row(int number) const { return image_.data() + offset(number, 0); }
  int end_of(int row, Index run) const { return run + 1 < first[row + 1] ? runs[run + 1].begin : width_; }

 private:
  struct Change {
    int column;
    std::int32_t change;
  };

  std::size_t offset(int row, int column) const { return std::size_t(stride_) * row + radius_ + column; }

  // Make the rows of the last image zero again.
  void clear() {
    for (int row = 0; row < height_; ++row) {
      if (used_[row]) std::fill_n(image_.data() + std::size_t(stride_) * row, stride_, 0.0f);
    }
  }

  // Write a row, and find where its values change.
  void fill(int row) {
    float* const out = image_.data() + offset(row, 0);
    for (Index i = first[row]; i < first[row + 1]; ++i) {
      if (runs[i].begin > 0) along_.add(row, runs[i].begin - radius_, runs[i].begin + radius_);
      if (runs[i].value == 0.0f) continue;
      std::fill(out + runs[i].begin, out + end_of(row, i), runs[i].value);
      used_[row] = 1;
    }
    if (!used_[row]) return;
    std::fill_n(out - radius_, radius_, out[0]);
    std::fill_n(out + width_, radius_, out[width_ - 1]);
  }

  // Find where a row differs from the next one, near enough for the blur along the rows to spread it there.
  void find_edge(int row) {
    Index one = first[row], other = first[row + 1];
    for (int column = 0; column < width_;) {
      const int end_of_one = end_of(row, one), end_of_other = end_of(row + 1, other);
      const int end = std::min(end_of_one, end_of_other);
      if (runs[one].value != runs[other].value) edge_.add(row, column - radius_, end + radius_);
      one += end_of_one == end, other += end_of_other == end;
      column = end;
    }
  }

  void blur_along(int row, int begin, int end) {
    float* const out = image_.data() + offset(row, 0);
    part_.assign(out + begin - radius_, out + end + radius_);
    const float* const from = part_.data() + radius_;
    for (int i = 0; i < end - begin; ++i) out[begin + i] = taps_[0] * from[i];
    for (int k = 1; k <= radius_; ++k) {
      const float tap = taps_[k];
      for (int i = 0; i < end - begin; ++i) out[begin + i] += tap * (from[i - k] + from[i + k]);
    }
  }

  void blur_across(int row, int begin, int end) {
    float* const out = across_.data() + offset(row, 0);
    const auto at = [&](int number) { return image_.data() + offset(std::clamp(number, 0, height_ - 1), 0); };
    const float* const middle = at(row);
    for (int i = begin; i < end; ++i) out[i] = taps_[0] * middle[i];
    for (int k = 1; k <= radius_; ++k) {
      const float tap = taps_[k], *above = at(row - k), *below = at(row + k);
      for (int i = begin; i < end; ++i) out[i] += tap * (above[i] + below[i]);
    }
  }

  int width_ = 0, height_ = 0, radius_ = 0, stride_ = 0;
  std::vector<float> taps_, image_, across_, part_;
  std::vector<std::uint8_t> used_;  // rows of the image that are not zero throughout
  Columns along_, edge_;            // where the blur along a row changes it; where a row then differs from the next one
  std::vector<Change> changes_;
};

}  // namespace kernel
