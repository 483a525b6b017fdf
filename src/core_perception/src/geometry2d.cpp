// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/geometry2d.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace core_perception {
namespace {

/// z of (b - a) x (c - a): > 0 when c lies to the left of a -> b.
double cross(const Point2& a, const Point2& b, const Point2& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

double squaredDistance(const Point2& a, const Point2& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y);
}

double squaredDistanceToSegment(const Point2& p, const Point2& a, const Point2& b) {
  const double dx = b.x - a.x, dy = b.y - a.y;
  const double length2 = dx * dx + dy * dy;
  double t = length2 > 0.0 ? ((p.x - a.x) * dx + (p.y - a.y) * dy) / length2 : 0.0;
  t = std::min(1.0, std::max(0.0, t));
  return squaredDistance(p, {a.x + t * dx, a.y + t * dy});
}

bool segmentsCross(const Point2& a, const Point2& b, const Point2& c, const Point2& d) {
  return cross(a, b, c) * cross(a, b, d) < 0.0 && cross(c, d, a) * cross(c, d, b) < 0.0;
}

bool borderReached(const Polygon& a, const Polygon& b) {
  for (size_t i = 0; i < a.size(); ++i) {
    for (size_t j = 0; j < b.size(); ++j) {
      if (segmentsCross(a[i], a[(i + 1) % a.size()], b[j], b[(j + 1) % b.size()])) return true;
    }
  }
  return false;
}

double cornersToPolygon(const Polygon& corners, const Polygon& polygon) {
  double best = std::numeric_limits<double>::infinity();
  for (const Point2& corner : corners) best = std::min(best, computeDistance(corner, polygon));
  return best;
}

}  // namespace

Polygon computeConvexHull(std::vector<Point2> points) {
  const auto less = [](const Point2& a, const Point2& b) {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
  };
  const auto same = [](const Point2& a, const Point2& b) { return a.x == b.x && a.y == b.y; };
  std::sort(points.begin(), points.end(), less);
  points.erase(std::unique(points.begin(), points.end(), same), points.end());
  if (points.size() < 3) return points;
  Polygon hull(2 * points.size());
  size_t n = 0;
  const auto add = [&](const Point2& p, size_t floor) {
    while (n >= floor + 2 && cross(hull[n - 2], hull[n - 1], p) <= 0.0) --n;
    hull[n++] = p;
  };
  for (const Point2& p : points) add(p, 0);
  const size_t lower = n - 1;
  for (auto p = points.rbegin() + 1; p != points.rend(); ++p) add(*p, lower);
  hull.resize(n - 1);
  return hull;
}

Polygon simplifyHull(Polygon hull, size_t max_corners) {
  while (hull.size() > std::max<size_t>(max_corners, 3)) {
    const size_t n = hull.size();
    size_t flattest = 0;
    double smallest = std::numeric_limits<double>::infinity();
    for (size_t i = 0; i < n; ++i) {
      const double area = cross(hull[(i + n - 1) % n], hull[i], hull[(i + 1) % n]);
      if (area < smallest) {
        smallest = area;
        flattest = i;
      }
    }
    hull.erase(hull.begin() + static_cast<std::ptrdiff_t>(flattest));
  }
  return hull;
}

Box2 computeBounds(const Polygon& polygon) {
  Box2 box{polygon[0].x, polygon[0].y, polygon[0].x, polygon[0].y};
  for (const Point2& p : polygon) {
    box.min_x = std::min(box.min_x, p.x);
    box.min_y = std::min(box.min_y, p.y);
    box.max_x = std::max(box.max_x, p.x);
    box.max_y = std::max(box.max_y, p.y);
  }
  return box;
}

Point2 computeCentre(const Polygon& polygon) {
  Point2 sum;
  for (const Point2& p : polygon) {
    sum.x += p.x;
    sum.y += p.y;
  }
  return {sum.x / polygon.size(), sum.y / polygon.size()};
}

double computeDiameter(const Polygon& polygon) {
  double best = 0.0;
  for (size_t i = 0; i < polygon.size(); ++i) {
    for (size_t j = i + 1; j < polygon.size(); ++j) {
      best = std::max(best, squaredDistance(polygon[i], polygon[j]));
    }
  }
  return std::sqrt(best);
}

double computeWidth(const Polygon& polygon) {
  if (polygon.size() < 3) return 0.0;
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Point2& a = polygon[i];
    const Point2& b = polygon[(i + 1) % polygon.size()];
    double farthest = 0.0;
    for (const Point2& p : polygon) farthest = std::max(farthest, cross(a, b, p));
    best = std::min(best, farthest / std::hypot(b.x - a.x, b.y - a.y));
  }
  return best;
}

bool contains(const Polygon& polygon, const Point2& point) {
  if (polygon.size() < 3) return false;
  for (size_t i = 0; i < polygon.size(); ++i) {
    if (cross(polygon[i], polygon[(i + 1) % polygon.size()], point) < 0.0) return false;
  }
  return true;
}

double computeDistance(const Point2& point, const Polygon& polygon) {
  if (contains(polygon, point)) return 0.0;
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < polygon.size(); ++i) {
    best = std::min(best,
                    squaredDistanceToSegment(point, polygon[i], polygon[(i + 1) % polygon.size()]));
  }
  return std::sqrt(best);
}

double computeDistance(const Point2& point, const Box2& box) {
  const double dx = std::max({box.min_x - point.x, point.x - box.max_x, 0.0});
  const double dy = std::max({box.min_y - point.y, point.y - box.max_y, 0.0});
  return std::hypot(dx, dy);
}

double computeDistance(const Polygon& a, const Polygon& b) {
  const double corners = std::min(cornersToPolygon(a, b), cornersToPolygon(b, a));
  return corners > 0.0 && borderReached(a, b) ? 0.0 : corners;
}

bool areWithin(const Box2& a, const Box2& b, double max_m) {
  const double gap_x = std::max(a.min_x - b.max_x, b.min_x - a.max_x);
  const double gap_y = std::max(a.min_y - b.max_y, b.min_y - a.max_y);
  return std::max(gap_x, gap_y) <= max_m;
}

bool areWithin(const Polygon& a, const Polygon& b, double max_m) {
  if (!areWithin(computeBounds(a), computeBounds(b), max_m)) return false;
  const auto isNear = [max_m](const Polygon& corners, const Polygon& polygon) {
    return std::any_of(corners.begin(), corners.end(), [&](const Point2& corner) {
      return computeDistance(corner, polygon) <= max_m;
    });
  };
  return isNear(a, b) || isNear(b, a) || (max_m >= 0.0 && borderReached(a, b));
}

Polygon makeSquare(const Point2& centre, double edge_m) {
  const double half = 0.5 * edge_m;
  return {{centre.x - half, centre.y - half},
          {centre.x + half, centre.y - half},
          {centre.x + half, centre.y + half},
          {centre.x - half, centre.y + half}};
}

}  // namespace core_perception
