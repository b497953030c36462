// Small dense systems of equations, and chains of them that are coupled to their neighbours.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

namespace kernel {

// Solve A X = B for a matrix (D, D), which is overwritten, by elimination with pivots; X replaces B (D, K).
inline void solve(double* a, double* b, std::size_t D, std::size_t K) {
  for (std::size_t k = 0; k < D; ++k) {
    std::size_t pivot = k;
    for (std::size_t i = k + 1; i < D; ++i) pivot = std::abs(a[D * i + k]) > std::abs(a[D * pivot + k]) ? i : pivot;
    if (pivot != k) {
      std::swap_ranges(a + D * k, a + D * (k + 1), a + D * pivot);
      std::swap_ranges(b + K * k, b + K * (k + 1), b + K * pivot);
    }
    for (std::size_t i = k + 1; i < D; ++i) {
      const double factor = a[D * i + k] / a[D * k + k];
      if (factor == 0.0) continue;
      for (std::size_t j = k; j < D; ++j) a[D * i + j] -= factor * a[D * k + j];
      for (std::size_t j = 0; j < K; ++j) b[K * i + j] -= factor * b[K * k + j];
    }
  }
  for (std::size_t k = D; k-- > 0;) {
    for (std::size_t i = k + 1; i < D; ++i) {
      for (std::size_t j = 0; j < K; ++j) b[K * k + j] -= a[D * k + i] * b[K * i + j];
    }
    for (std::size_t j = 0; j < K; ++j) b[K * k + j] /= a[D * k + k];
  }
}

// Add the product of matrices (I, K) and (K, J) times a factor.
inline void add_product(const double* a, const double* b, double factor, double* out, std::size_t I, std::size_t K,
                        std::size_t J) {
  for (std::size_t i = 0; i < I; ++i) {
    for (std::size_t k = 0; k < K; ++k) {
      const double by = factor * a[K * i + k];
      for (std::size_t j = 0; j < J; ++j) out[J * i + j] += by * b[J * k + j];
    }
  }
}

// Eliminate the unknowns (M,) of N frames one after the other from a block-tridiagonal symmetric system. Writes the inverses
// (N, M, M) of what is left of the diagonal, and replaces the right sides (N, M, K) by what is left of them. `beside`
// (N - 1, M, M) are the blocks between a frame and the next one.
inline void eliminate_chain(const double* diagonal, const double* beside, double* inverses, double* right, std::size_t N,
                            std::size_t M, std::size_t K) {
  std::vector<double> block(M * M), gain(M * M), turned(M * M);
  for (std::size_t n = 0; n < N; ++n) {
    std::copy_n(diagonal + M * M * n, M * M, block.data());
    if (n > 0) {
      const double* before = beside + M * M * (n - 1);
      for (std::size_t i = 0; i < M; ++i) {
        for (std::size_t j = 0; j < M; ++j) turned[M * i + j] = before[M * j + i];
      }
      std::fill(gain.begin(), gain.end(), 0.0);
      add_product(turned.data(), inverses - M * M, 1.0, gain.data(), M, M, M);
      add_product(gain.data(), before, -1.0, block.data(), M, M, M);
      add_product(gain.data(), right - M * K, -1.0, right, M, M, K);
    }
    std::fill_n(inverses, M * M, 0.0);
    for (std::size_t i = 0; i < M; ++i) inverses[(M + 1) * i] = 1.0;
    solve(block.data(), inverses, M, M);
    inverses += M * M, right += M * K;
  }
}

// Eliminate the last M of D + M unknowns of a quadratic term, of which `known` (M, M) is known beforehand, about zero.
// Writes information (D, D) and slope (D,) of the others.
inline void eliminate_last(const double* information, const double* slope, const double* known, std::size_t D, std::size_t M,
                           double* left, double* left_slope) {
  const std::size_t all = D + M;
  std::vector<double> block(M * M), right(M * (D + 1));
  for (std::size_t i = 0; i < M; ++i) {
    const double* row = information + all * (D + i);
    for (std::size_t j = 0; j < M; ++j) block[M * i + j] = row[D + j] + known[M * i + j];
    std::copy_n(row, D, right.data() + (D + 1) * i);
    right[(D + 1) * i + D] = slope[D + i];
  }
  solve(block.data(), right.data(), M, D + 1);
  for (std::size_t i = 0; i < D; ++i) {
    std::copy_n(information + all * i, D, left + D * i);
    left_slope[i] = slope[i];
    for (std::size_t k = 0; k < M; ++k) {
      const double by = information[all * i + D + k];
      for (std::size_t j = 0; j < D; ++j) left[D * i + j] -= by * right[(D + 1) * k + j];
      left_slope[i] -= by * right[(D + 1) * k + D];
    }
  }
}

}  // namespace kernel
