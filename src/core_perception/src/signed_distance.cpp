// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/signed_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace core_perception {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Lower envelope of the parabolas (q - p)^2 + f(p) over samples p; infinite samples carry none.
class Envelope {
 public:
  explicit Envelope(size_t n) : vertices_(n), borders_(n + 1) {}

  void build(const std::vector<double>& f) {
    count_ = 0;
    for (int q = 0; q < static_cast<int>(f.size()); ++q) {
      if (f[q] != kInfinity) push(f, q);
    }
  }

  /// values[i] = min_p (queries_first + i * step - p)^2 + f(p).
  void sample(const std::vector<double>& f, int first, int step, int n, double* values) const {
    size_t k = 0;
    for (int i = 0; i < n; ++i) {
      if (count_ == 0) {
        values[i] = kInfinity;
        continue;
      }
      const int q = first + i * step;
      while (k + 1 < count_ && borders_[k + 1] < q) ++k;
      const double d = q - vertices_[k];
      values[i] = d * d + f[vertices_[k]];
    }
  }

 private:
  void push(const std::vector<double>& f, int q) {
    double border = -kInfinity;
    while (count_ > 0) {
      const int p = vertices_[count_ - 1];
      border = ((f[q] + static_cast<double>(q) * q) - (f[p] + static_cast<double>(p) * p)) /
               (2.0 * (q - p));
      if (border > borders_[count_ - 1]) break;
      --count_;
      border = -kInfinity;
    }
    vertices_[count_] = q;
    borders_[count_] = border;
    ++count_;
  }

  std::vector<int> vertices_;
  std::vector<double> borders_;
  size_t count_ = 0;
};

/// Steps to the nearest cell of this value in the same column; infinite where there is none.
std::vector<double> scanColumns(const Mask& mask, uint8_t target) {
  const size_t w = mask.width, n = mask.unsafe.size();
  std::vector<double> steps(n);
  for (size_t i = 0; i < n; ++i) {
    steps[i] = mask.unsafe[i] == target ? 0.0 : i < w ? kInfinity : steps[i - w] + 1.0;
  }
  for (size_t i = n; i-- > 0;) {
    if (i + w < n) steps[i] = std::min(steps[i], steps[i + w] + 1.0);
  }
  return steps;
}

/// Squared distance in cells from every centre to the nearest square or centre of a cell of this
/// value.
std::vector<double> transform(const Mask& mask, uint8_t target, DistanceConvention convention) {
  const bool border = convention == DistanceConvention::kBorder;
  const int w = mask.width;
  std::vector<double> cost = scanColumns(mask, target);
  for (double& c : cost) {
    const double reach = border ? std::max(0.0, c - 0.5) : c;
    c = reach * reach;
  }
  // In kBorder samples lie half a cell apart: edge, centre, edge, ... ; an edge belongs to both
  // cells it separates.
  const int n_samples = border ? 2 * w + 1 : w;
  const double unit2 = border ? 4.0 : 1.0;  // squared samples in a cell
  std::vector<double> f(n_samples), row(w);
  Envelope envelope(n_samples);
  for (int y = 0; y < mask.height; ++y) {
    double* c = &cost[static_cast<size_t>(y) * w];
    for (int k = 0; k < n_samples; ++k) {
      if (!border) {
        f[k] = c[k];
      } else if (k % 2 == 1) {
        f[k] = unit2 * c[k / 2];
      } else {
        f[k] = unit2 * std::min(k > 0 ? c[k / 2 - 1] : kInfinity, k < 2 * w ? c[k / 2] : kInfinity);
      }
    }
    envelope.build(f);
    envelope.sample(f, border ? 1 : 0, border ? 2 : 1, w, row.data());
    for (int x = 0; x < w; ++x) c[x] = row[x] / unit2;
  }
  return cost;
}

/// Distance in cells from a centre to what lies beyond the grid.
double measureToOutside(const Mask& mask, int x, int y, DistanceConvention convention) {
  const int nearest = std::min(std::min(x, mask.width - 1 - x), std::min(y, mask.height - 1 - y));
  return nearest + (convention == DistanceConvention::kBorder ? 0.5 : 1.0);
}

}  // namespace

std::vector<float> computeSignedDistance(const Mask& mask, double resolution_m,
                                         DistanceConvention convention) {
  const std::vector<double> to_unsafe = transform(mask, 1, convention);
  const std::vector<double> to_safe = transform(mask, 0, convention);
  const double diagonal = std::hypot(mask.width, mask.height);
  std::vector<float> h(mask.unsafe.size());
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      const size_t i = static_cast<size_t>(y) * mask.width + x;
      const bool unsafe = mask.unsafe[i] != 0;
      double cells = std::min(diagonal, std::sqrt(unsafe ? to_safe[i] : to_unsafe[i]));
      if (!unsafe && mask.outside_unsafe)
        cells = std::min(cells, measureToOutside(mask, x, y, convention));
      h[i] = static_cast<float>((unsafe ? -cells : cells) * resolution_m);
    }
  }
  return h;
}

}  // namespace core_perception
