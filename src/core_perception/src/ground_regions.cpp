// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ground_regions.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace core_perception {
namespace {

Region makeRegion(const Predicate& predicate, uint32_t instance_id, bool mobile) {
  Region region;
  region.cause = Cause{formatRule(predicate), predicate.class_name, instance_id, mobile};
  region.slow = predicate.severity == Severity::kSlow;
  return region;
}

double chooseRadius(const Predicate& predicate, const InstanceParams& params) {
  if (predicate.radius_m > 0.0) return predicate.radius_m;
  const auto it = params.class_radius_m.find(predicate.class_name);
  return it != params.class_radius_m.end() ? it->second : params.default_radius_m;
}

std::vector<Polygon> makeParts(const HeldInstance& held, bool extended, double resolution_m) {
  if (!extended) return {held.footprint};
  std::vector<Polygon> parts;
  for (const CellIndex& cell : held.cells) {
    parts.push_back(
        makeSquare({(cell.x + 0.5) * resolution_m, (cell.y + 0.5) * resolution_m}, resolution_m));
  }
  return parts;
}

void addAround(const Predicate& predicate, const HeldInstance& held, const InstanceParams& params,
               double resolution_m, std::vector<Region>* regions) {
  const bool extended = held.isExtended(params.max_footprint_m);
  const bool around = predicate.spatial_operator == SpatialOperator::kAround;
  if (extended && !around) return;
  Region region = makeRegion(predicate, held.id, held.mobile);
  region.parts = makeParts(held, extended, resolution_m);
  region.radius_m = around ? chooseRadius(predicate, params) : 0.0;
  regions->push_back(std::move(region));
}

void addBetween(const Predicate& predicate, const std::vector<const HeldInstance*>& members,
                const InstanceParams& params, std::vector<Region>* regions) {
  std::map<uint32_t, std::vector<const HeldInstance*>> clusters;
  for (const HeldInstance* held : members) clusters[held->cluster].push_back(held);
  for (const auto& cluster : clusters) {
    if (cluster.second.size() < 2) continue;
    std::vector<Point2> corners;
    for (const HeldInstance* held : cluster.second) {
      corners.insert(corners.end(), held->footprint.begin(), held->footprint.end());
    }
    Region region = makeRegion(predicate, cluster.first, cluster.second[0]->mobile);
    region.parts = {computeConvexHull(std::move(corners))};
    region.radius_m =
        std::max(0.0, 0.5 * (params.between_min_thickness_m - computeWidth(region.parts[0])));
    regions->push_back(std::move(region));
  }
}

/// Distance from a cell's square to the polygon is at most radius; exact, with two cheap answers
/// first.
bool reaches(const Polygon& part, const Point2& centre, double resolution_m, double radius_m) {
  const double distance_m = computeDistance(centre, part);
  if (distance_m <= radius_m) return true;
  if (distance_m > radius_m + std::sqrt(0.5) * resolution_m) return false;
  return computeDistance(makeSquare(centre, resolution_m), part) <= radius_m;
}

}  // namespace

std::vector<Region> buildRegions(const std::vector<HeldInstance>& instances,
                                 const std::vector<Predicate>& predicates,
                                 const InstanceParams& params, double resolution_m) {
  std::vector<Region> regions;
  for (const Predicate& predicate : predicates) {
    const bool surface = predicate.spatial_operator == SpatialOperator::kOn;
    if (!predicate.isUnsafe() || surface || isCancelled(predicate, predicates)) continue;
    std::vector<const HeldInstance*> members;
    for (const HeldInstance& held : instances) {
      if (held.confirmed && held.class_name == predicate.class_name &&
          !isSpared(held, predicate, instances))
        members.push_back(&held);
    }
    if (predicate.spatial_operator == SpatialOperator::kBetween) {
      addBetween(predicate, members, params, &regions);
      continue;
    }
    for (const HeldInstance* held : members)
      addAround(predicate, *held, params, resolution_m, &regions);
  }
  return regions;
}

double findLargestRadius(const std::vector<Predicate>& predicates, const InstanceParams& params) {
  double largest_m = params.between_min_thickness_m;
  for (const Predicate& predicate : predicates)
    largest_m = std::max(largest_m, chooseRadius(predicate, params));
  return largest_m;
}

bool isSpared(const HeldInstance& held, const Predicate& predicate,
              const std::vector<HeldInstance>& instances) {
  const auto listed = [&predicate](const HeldInstance& one) {
    return predicate.exempt_instances.count(one.id) > 0;
  };
  if (predicate.spatial_operator == SpatialOperator::kOn || !listed(held)) return false;
  if (predicate.spatial_operator != SpatialOperator::kBetween) return true;
  return std::all_of(instances.begin(), instances.end(), [&](const HeldInstance& other) {
    return other.cluster != held.cluster || listed(other);
  });
}

bool isUnsafeInstance(const HeldInstance& held, const std::vector<Predicate>& predicates,
                      const std::vector<HeldInstance>& instances) {
  return std::any_of(predicates.begin(), predicates.end(), [&](const Predicate& predicate) {
    return predicate.class_name == held.class_name && predicate.isUnsafe() &&
           !isCancelled(predicate, predicates) && !isSpared(held, predicate, instances);
  });
}

void forEachCell(const Region& region, const GridFrame& grid,
                 const std::function<void(size_t)>& visit) {
  const double res = grid.resolution_m;
  // Clamped before it becomes an integer: a radius may reach farther than an integer can say.
  const auto find = [res](double edge_m, int origin, int size) {
    const double cell = std::floor(edge_m / res) - origin;
    return static_cast<int>(std::min(std::max(cell, -1.0), static_cast<double>(size)));
  };
  for (const Polygon& part : region.parts) {
    const Box2 box = computeBounds(part);
    const double r = region.radius_m;
    const int x0 = std::max(0, find(box.min_x - r, grid.origin.x, grid.width));
    const int y0 = std::max(0, find(box.min_y - r, grid.origin.y, grid.height));
    const int x1 = std::min(grid.width, find(box.max_x + r, grid.origin.x, grid.width) + 1);
    const int y1 = std::min(grid.height, find(box.max_y + r, grid.origin.y, grid.height) + 1);
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        const Point2 centre{(grid.origin.x + x + 0.5) * res, (grid.origin.y + y + 0.5) * res};
        if (reaches(part, centre, res, region.radius_m))
          visit(static_cast<size_t>(y) * grid.width + x);
      }
    }
  }
}

}  // namespace core_perception
