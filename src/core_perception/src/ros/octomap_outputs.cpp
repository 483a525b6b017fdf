// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ros/octomap_outputs.h"

#include <algorithm>
#include <cctype>
#include <stdexcept>

#include "core_perception/ros/conversions.h"
#include "core_perception/ros/map_folder.h"
#include "core_perception/semantic_octree_io.h"

namespace core_perception {
namespace {

bool hasEnding(const std::string& text, const std::string& ending) {
  return text.size() > ending.size() &&
         text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

/// Any program on the network can call the service: it must not choose where on the disk to write.
bool isPlainName(const std::string& file) {
  constexpr size_t kLongest = 100;
  const auto isAllowed = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '.' || c == '_' || c == '-';
  };
  return file.size() <= kLongest && !file.empty() && file[0] != '.' && file[0] != '-' &&
         std::all_of(file.begin(), file.end(), isAllowed) &&
         (hasEnding(file, ".ot") || hasEnding(file, ".bt"));
}

/// For a message of one line.
std::string quote(std::string text) {
  text = text.substr(0, 100);
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return std::isprint(c) == 0; }, '?');
  return "'" + text + "'";
}

}  // namespace

OctomapOutputs::OctomapOutputs(const NodeParams& params, const TakeSnapshot& takeSnapshot,
                               const CountChanges& countChanges)
    : params_(params),
      takeSnapshot_(takeSnapshot),
      countChanges_(countChanges),
      spinner_(1, &queue_) {
  nh_.setCallbackQueue(&queue_);
  using Format = std::pair<WireFormat, const char*>;
  for (const Format& format :
       {Format(WireFormat::kFull, "octomap_full"), Format(WireFormat::kBinary, "octomap_binary"),
        Format(WireFormat::kColor, "octomap_color"),
        Format(WireFormat::kSemantic, "semantic_octomap")}) {
    const WireFormat f = format.first;
    const auto make = [f](const MapSnapshot& map) {
      return octomapToMessage(f, map.header, map.tree);
    };
    advertise<octomap_msgs::Octomap>(format.second, make);
    if (f != WireFormat::kFull && f != WireFormat::kBinary) continue;
    using Request = octomap_msgs::GetOctomap::Request;
    using Response = octomap_msgs::GetOctomap::Response;
    const boost::function<bool(Request&, Response&)> answer = [this, make](Request&, Response& r) {
      r.map = make(takeSnapshot_());
      return true;
    };
    services_.push_back(nh_.advertiseService(format.second, answer));
  }
  advertise<sensor_msgs::PointCloud2>("octomap_point_cloud_centers", [](const MapSnapshot& map) {
    return centersToMessage(map.header, map.tree);
  });
  advertise<nav_msgs::OccupancyGrid>("projected_map", [this](const MapSnapshot& map) {
    return groundPlanToMessage(projectToGround(map.tree, map.band, params_.map.vote, map.regions),
                               map.header);
  });
  using Save = core_msgs::SaveMap;
  const boost::function<bool(Save::Request&, Save::Response&)> save =
      [this](Save::Request& request, Save::Response& r) { return onSave(request.file, &r); };
  services_.push_back(nh_.advertiseService("semantic_map/save", save));
  timer_ = nh_.createWallTimer(ros::WallDuration(params_.octomap_period_s),
                               &OctomapOutputs::publish, this);
  spinner_.start();
}

OctomapOutputs::~OctomapOutputs() { spinner_.stop(); }

template <typename Message, typename MakeMessage>
void OctomapOutputs::advertise(const std::string& topic, MakeMessage makeMessage) {
  const auto send = [makeMessage](const MapSnapshot& map, ros::Publisher* publisher) {
    publisher->publish(makeMessage(map));
  };
  topics_.push_back(Topic{nh_.advertise<Message>(topic, 1, true), send, 0});
}

void OctomapOutputs::publish(const ros::WallTimerEvent&) {
  const uint64_t n_changes = countChanges_();
  const auto isDue = [n_changes](const Topic& topic) {
    return topic.publisher.getNumSubscribers() > 0 && topic.n_changes != n_changes;
  };
  if (std::none_of(topics_.begin(), topics_.end(), isDue)) return;
  const MapSnapshot map = takeSnapshot_();
  for (Topic& topic : topics_) {
    if (!isDue(topic)) continue;
    topic.n_changes = n_changes;
    try {
      topic.send(map, &topic.publisher);
    } catch (const std::length_error& error) {
      ROS_ERROR_THROTTLE(60.0, "semantic_map: %s: %s", topic.publisher.getTopic().c_str(),
                         error.what());
    }
  }
}

bool OctomapOutputs::onSave(const std::string& file, core_msgs::SaveMap::Response* response) {
  response->success = 0;
  if (!isPlainName(file)) {
    response->message =
        "file: got " + quote(file) +
        ", allowed a name of letters, digits, '.', '_' and '-' that ends in .ot or .bt";
    return true;
  }
  const MapSnapshot map = takeSnapshot_();
  if (map.tree.nodes.empty()) {
    response->message = "the map is empty";
    return true;
  }
  const std::string path = findMapFolder(params_.map_dir) + "/" + file;
  try {
    const WireFormat format = hasEnding(file, ".bt") ? WireFormat::kBinary : WireFormat::kSemantic;
    writeFileAtomically(path, formatFile(format, map.tree));
    response->success = 1;
    response->message =
        path + ": " + std::to_string(map.tree.nodes.size() / TreeSnapshot::kNodeSize) + " nodes";
  } catch (const TreeError& error) {
    response->message = error.what();
  }
  return true;
}

}  // namespace core_perception
