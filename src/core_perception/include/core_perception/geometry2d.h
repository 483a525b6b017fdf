// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

namespace core_perception {

/// A point on the ground [m], in the fixed frame of the map.
struct Point2 {
  double x = 0.0;
  double y = 0.0;
};

/// Corners of a convex polygon, counter-clockwise, first corner not repeated.
/// One corner is a point, two are a segment; both are legal everywhere below.
using Polygon = std::vector<Point2>;

struct Box2 {
  double min_x, min_y, max_x, max_y;
};

/// Convex hull, counter-clockwise, without collinear corners. Andrew's monotone chain, O(n log n).
/// @param points any number; non-finite ones are the caller's fault.
Polygon computeConvexHull(std::vector<Point2> points);

/// Drops the corner that spans the smallest triangle with its neighbours until at most max_corners
/// are left.
Polygon simplifyHull(Polygon hull, size_t max_corners);

/// Smallest axis-aligned box; the polygon must not be empty.
Box2 computeBounds(const Polygon& polygon);

/// Mean of the corners (not of the area); the polygon must not be empty.
Point2 computeCentre(const Polygon& polygon);

/// Largest distance between two corners [m].
double computeDiameter(const Polygon& polygon);

/// Smallest width over all directions [m]: min over edges of the max distance of a corner to the
/// edge's line. A point and a segment have width 0.
double computeWidth(const Polygon& polygon);

/// Whether the point lies in the polygon or on its border.
bool contains(const Polygon& polygon, const Point2& point);

/// Distance from a point to a polygon [m]; 0 inside.
double computeDistance(const Point2& point, const Polygon& polygon);

/// Distance from a point to a box [m]; 0 inside.
double computeDistance(const Point2& point, const Box2& box);

/// Distance between two convex polygons [m]; 0 when they touch or overlap.
double computeDistance(const Polygon& a, const Polygon& b);

/// Whether the gap between two boxes is at most max_m along both axes: where it is not, what they
/// hold is farther apart than that.
bool areWithin(const Box2& a, const Box2& b, double max_m);

/// Whether the distance of two polygons is at most max_m; cheap for polygons that are far apart.
bool areWithin(const Polygon& a, const Polygon& b, double max_m);

/// Corners of the square of side edge_m around a centre, counter-clockwise.
Polygon makeSquare(const Point2& centre, double edge_m);

}  // namespace core_perception
