// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <vector>

#include "core_perception/causes.h"
#include "core_perception/instance_memory.h"
#include "core_perception/predicates.h"

namespace core_perception {

/// Ground within radius_m of any of the parts.
struct Region {
  Cause cause;
  bool slow = false;  ///< a speed cap instead of a barrier
  std::vector<Polygon> parts;
  double radius_m = 0.0;
};

/// Cells of a square grid: centre of (x, y) = origin + (index + 1/2) * resolution.
struct GridFrame {
  CellIndex origin{0, 0};  ///< index of cell (0, 0) in the fixed frame
  int width = 0, height = 0;
  double resolution_m = 0.0;
};

/// Regions that the unsafe predicates in force make around confirmed objects:
///
///     NEAR(c)     the footprint (an extended object has its own voxels instead)
///     AROUND(c)   ground within the radius of the predicate, else of the class, else the default,
///     of the footprint
///                 (of the touched cells, for an extended object)
///     BETWEEN(c)  hull of each cluster of two or more, widened to the minimum thickness; a safe
///     BETWEEN(c) cancels it
///
/// ON(c) makes none: it speaks of surfaces, which are votes. Objects that a predicate spares make
/// none of its regions. Source: DESIGN section 4, rows 2 to 4 and 12.
/// Differs from [CORE]: metres on the ground instead of pixels, over remembered objects instead of
/// those in the image.
std::vector<Region> buildRegions(const std::vector<HeldInstance>& instances,
                                 const std::vector<Predicate>& predicates,
                                 const InstanceParams& params, double resolution_m);

/// Largest distance from an object at which one of these predicates makes a region [m].
double findLargestRadius(const std::vector<Predicate>& predicates, const InstanceParams& params);

/// Whether the predicate's exempt_instances spare an object of its class: NEAR and AROUND spare
/// those listed, BETWEEN those of a cluster whose members are all listed, ON none.
bool isSpared(const HeldInstance& held, const Predicate& predicate,
              const std::vector<HeldInstance>& instances);

/// Whether some unsafe predicate speaks of the class of an object and does not spare it.
bool isUnsafeInstance(const HeldInstance& held, const std::vector<Predicate>& predicates,
                      const std::vector<HeldInstance>& instances);

/// Calls visit(index) for each cell whose square reaches into the region: the union of the visited
/// squares covers it. A cell is visited once for each part it touches.
void forEachCell(const Region& region, const GridFrame& grid,
                 const std::function<void(size_t)>& visit);

}  // namespace core_perception
