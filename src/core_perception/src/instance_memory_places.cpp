// SPDX-License-Identifier: BSD-3-Clause
// Which objects an InstanceMemory holds at hand: by class, by distance, by place.
#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

#include "core_perception/instance_memory.h"

namespace core_perception {

void InstanceMemory::hideClasses(const std::function<bool(const std::string&)>& is_surface) {
  std::vector<HeldInstance> all;
  all.swap(instances_);
  std::move(hidden_.begin(), hidden_.end(), std::back_inserter(all));
  hidden_.clear();
  for (HeldInstance& held : all)
    (is_surface(held.class_name) ? hidden_ : instances_).push_back(std::move(held));
}

void InstanceMemory::keepAround(const Point2& place, double return_m, double leave_m, bool forget) {
  const auto returns = [&](AsideCluster& cluster) {
    if (computeDistance(place, cluster.bounds) > return_m) return false;
    std::move(cluster.members.begin(), cluster.members.end(), std::back_inserter(instances_));
    return true;
  };
  aside_.erase(std::remove_if(aside_.begin(), aside_.end(), returns), aside_.end());

  // By cluster: a hull between its members may hold ground far from each of them.
  std::map<uint32_t, AsideCluster> leaving;
  for (const std::vector<HeldInstance>* all : {&instances_, &hidden_}) {
    for (const HeldInstance& held : *all) {
      const Box2 own = computeBounds(held.footprint);
      Box2& bounds = leaving.emplace(held.cluster, AsideCluster{own, {}}).first->second.bounds;
      bounds = {std::min(bounds.min_x, own.min_x), std::min(bounds.min_y, own.min_y),
                std::max(bounds.max_x, own.max_x), std::max(bounds.max_y, own.max_y)};
    }
  }
  for (auto it = leaving.begin(); it != leaving.end();)
    it = computeDistance(place, it->second.bounds) <= leave_m ? leaving.erase(it) : std::next(it);
  for (std::vector<HeldInstance>* all : {&instances_, &hidden_}) {
    const auto stays = [&](const HeldInstance& held) { return leaving.count(held.cluster) == 0; };
    const auto end = std::stable_partition(all->begin(), all->end(), stays);
    for (auto it = end; it != all->end(); ++it) {
      it->footprint.shrink_to_fit();
      it->cells.shrink_to_fit();
      leaving[it->cluster].members.push_back(std::move(*it));
    }
    all->erase(end, all->end());
  }
  if (forget) return;
  for (auto& cluster : leaving) aside_.push_back(std::move(cluster.second));
}

int InstanceMemory::clearBox(const Eigen::Vector3d& min_m, const Eigen::Vector3d& max_m) {
  const Polygon box{{min_m.x(), min_m.y()},
                    {max_m.x(), min_m.y()},
                    {max_m.x(), max_m.y()},
                    {min_m.x(), max_m.y()}};
  const auto is_inside = [&](const HeldInstance& held) {
    const bool level = held.z_min_m <= max_m.z() && held.z_max_m >= min_m.z();
    return level && areWithin(held.footprint, box, 0.0);
  };
  std::vector<std::vector<HeldInstance>*> lists{&instances_, &hidden_};
  for (AsideCluster& cluster : aside_) lists.push_back(&cluster.members);
  int n = 0;
  for (std::vector<HeldInstance>* all : lists) {
    const auto kept = std::remove_if(all->begin(), all->end(), is_inside);
    n += static_cast<int>(all->end() - kept);
    all->erase(kept, all->end());
  }
  return n;
}

}  // namespace core_perception
