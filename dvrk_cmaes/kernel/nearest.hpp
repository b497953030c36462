// Distances from single pixels of a mask to the nearest pixel of the other kind.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace kernel {

// Finds, from single pixels of a mask (H, W), the nearest pixels outside it, or inside for those outside.
class NearestOther {
 public:
  // Along each row, the distance to the nearest pixel of the other kind is found once.
  NearestOther(const bool* mask, std::int64_t width, std::int64_t height)
      : mask_(mask), width_(width), height_(height), along_(width * height) {
    for (std::int64_t row = 0; row < height; ++row) {
      const bool* kinds = mask + width * row;
      std::int32_t *out = along_.data() + width * row, since = kNone;
      for (std::int64_t i = 0; i < width; ++i) {
        since = i > 0 && kinds[i] != kinds[i - 1] ? 1 : std::min(since + 1, kNone);
        out[i] = since;
      }
      since = kNone;
      for (std::int64_t i = width - 1; i >= 0; --i) {
        since = i + 1 < width && kinds[i] != kinds[i + 1] ? 1 : std::min(since + 1, kNone);
        out[i] = std::min(out[i], since);
      }
    }
  }

  // The squared distance of a pixel, px^2; `most` if there is no nearer one.
  std::int64_t square(std::int64_t pixel, std::int64_t most) const {
    const std::int64_t row = pixel / width_, column = pixel % width_;
    std::int64_t best = most;
    for (std::int64_t off = 0; off * off < best && (off <= row || off < height_ - row); ++off) {
      for (const std::int64_t other : {row - off, row + off}) {
        if (other < 0 || other >= height_) continue;
        const std::int64_t at = width_ * other + column;
        const std::int64_t along = mask_[at] == mask_[pixel] ? along_[at] : 0;
        best = std::min(best, off * off + along * along);
      }
    }
    return best;
  }

 private:
  static constexpr std::int32_t kNone = 1 << 20;  // px; there is none in the row

  const bool* mask_;
  std::int64_t width_, height_;
  std::vector<std::int32_t> along_;
};

}  // namespace kernel
