// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/ros/semantic_map_node.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <tf2_eigen/tf2_eigen.h>

#include <algorithm>

#include "core_perception/exceptions.h"
#include "core_perception/ros/map_folder.h"
#include "core_perception/saved_map.h"

namespace core_perception {
namespace {

constexpr double kTfCache_s = 60.0;  // a segmenter may need seconds for its labels
constexpr double kClockSetBack_s = 1.0;

SemanticMapParams withTileFolder(const NodeParams& params) {
  SemanticMapParams map = params.map;
  if (map.window.keep_radius_m > 0.0 && map.window.outside == "disk")
    map.window.tile_dir = findMapFolder(params.map_dir);
  return map;
}

}  // namespace

SemanticMapNode::SemanticMapNode(const NodeParams& params)
    : params_(params),
      map_(withTileFolder(params)),
      queue_(params.lockstep, params.slop_s, params.queue_size),
      tf_(ros::Duration(kTfCache_s)) {
  tf_.setUsingDedicatedThread(true);  // look-ups below never wait
  if (!params.map_file.empty()) {
    map_.load(*readSavedMap(params.map_file, params.map.resolution_m));
    ++n_changes_;
  }
  outputs_ = std::make_unique<OctomapOutputs>(
      params, [this] { return takeSnapshot(); }, [this] { return countChanges(); });
  advertise();
  subscribe();
}

void SemanticMapNode::advertise() {
  const bool latch = params_.lockstep;
  grid_pub_ = nh_.advertise<core_msgs::SafetyGrid>("safety_grid", 10, latch);
  instances_pub_ = nh_.advertise<core_msgs::InstanceArray>("semantic_map/instances", 10, latch);
  const auto makeGridPublisher = [&](const char* topic) {
    return std::make_unique<GridPublisher>(&nh_, topic, latch, params_.grid_period_s);
  };
  probability_pub_ = makeGridPublisher("semantic_map/probability");
  unsafe_pub_ = makeGridPublisher("semantic_map/unsafe");
  diagnostics_pub_ = nh_.advertise<diagnostic_msgs::DiagnosticArray>("diagnostics", 10);
  services_.push_back(nh_.advertiseService("semantic_map/reset", &SemanticMapNode::onReset, this));
  services_.push_back(
      nh_.advertiseService("semantic_map/clear_bbx", &SemanticMapNode::onClearBox, this));
  timers_.push_back(
      nh_.createWallTimer(ros::WallDuration(1.0), &SemanticMapNode::publishDiagnostics, this));
}

void SemanticMapNode::subscribe() {
  const auto hints = ros::TransportHints().tcpNoDelay();
  const auto size = static_cast<uint32_t>(params_.queue_size);
  const auto listen = [&](const std::string& topic, auto callback, auto message) {
    using Message = decltype(message);
    const boost::function<void(const boost::shared_ptr<Message const>&)> function = callback;
    subscribers_.push_back(
        nh_.subscribe<Message>(topic, size, function, ros::VoidConstPtr(), hints));
  };
  // Transforms are taken here rather than by a TransformListener, so that a frame is tried again
  // when one arrives.
  listen("/tf", [this](const auto& m) { onTf(*m, false); }, tf2_msgs::TFMessage());
  listen("/tf_static", [this](const auto& m) { onTf(*m, true); }, tf2_msgs::TFMessage());
  listen("camera/depth/image_raw", [this](const auto& m) { onDepth(m); }, sensor_msgs::Image());
  const auto enqueue = [this](const auto& message, const char* what) {
    if (!hasStamp(*message, what)) return;
    queue_.add(message);
    processQueue();
  };
  listen(
      "camera/color/camera_info", [enqueue](const auto& m) { enqueue(m, "camera_info"); },
      sensor_msgs::CameraInfo());
  listen(
      "segmentation/label_info", [enqueue](const auto& m) { enqueue(m, "label_info"); },
      core_msgs::LabelInfo());
  listen(
      "safety/constraints", [enqueue](const auto& m) { enqueue(m, "constraints"); },
      core_msgs::SafetyConstraints());
  const auto on_labels = [this](const auto& message) {
    if (!hasStamp(*message, "labels")) return;
    queue_.add(message, false);
    processQueue();
  };
  listen("segmentation/labels", on_labels, sensor_msgs::Image());
}

template <typename Message>
bool SemanticMapNode::hasStamp(const Message& message, const char* what) {
  if (isUsable(message.header.stamp)) return true;
  reject("stamp_invalid",
         std::string(what) + " has a stamp that is 0, beyond 2^31 s or not normalised");
  return false;
}

void SemanticMapNode::onDepth(const sensor_msgs::ImageConstPtr& depth) {
  if (!hasStamp(*depth, "depth")) return;
  const ros::Time& stamp = depth->header.stamp;
  const double back_s = (last_depth_ - stamp).toSec();
  if (back_s > longestStepBack()) flush(stamp);
  last_depth_ = stamp;
  queue_.add(depth, true);
  processQueue();
}

double SemanticMapNode::longestStepBack() const { return params_.lockstep ? 0.0 : kClockSetBack_s; }

void SemanticMapNode::onTf(const tf2_msgs::TFMessage& message, bool is_static) {
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    if (!is_static && !isUsable(transform.header.stamp)) {  // tf2's arithmetic would throw
      ROS_WARN_THROTTLE(5.0, "semantic_map: a transform to '%s' has an unusable stamp",
                        toPrintable(transform.child_frame_id).c_str());
      continue;
    }
    if (!is_static) {
      const double back_s = (tf_stamps_[transform.child_frame_id] - transform.header.stamp).toSec();
      // After the clock was set back the buffer would refuse transforms as too old. Static ones
      // survive clear().
      if (back_s > longestStepBack()) {
        tf_.clear();
        tf_stamps_.clear();
      }
      tf_stamps_[transform.child_frame_id] = transform.header.stamp;
    }
    tf_.setTransform(transform, "tf", is_static);
  }
  processQueue();
}

void SemanticMapNode::processQueue() {
  for (const FrameMessages& messages : queue_.findComplete(ros::Time::now())) {
    const ros::Time stamp = messages.depth->header.stamp;
    if (stamp > last_frame_) {
      if (!process(messages)) {
        if (params_.lockstep) return;
        continue;  // a later one may have its pose already; this one is dropped then
      }
      last_frame_ = stamp;
    }
    n_dropped_ += static_cast<uint64_t>(std::max(0, queue_.dropUpTo(stamp)));
  }
}

bool SemanticMapNode::process(const FrameMessages& messages) {
  const ros::WallTime start = ros::WallTime::now();
  try {
    Frame frame = frameFromMessages(messages, params_.ignore_distortion,
                                    params_.rectify ? &rectifier_ : nullptr);
    const Constraints constraints = constraintsFromMessage(messages.constraints);
    if (!lookUpPose(messages.depth->header, &frame)) return false;
    std_msgs::Header header = messages.depth->header;
    header.frame_id = params_.map_frame;
    {
      const std::lock_guard<std::mutex> lock(map_mutex_);
      map_.update(frame, constraints);
      map_stamp_ = header.stamp;
      ++n_changes_;
    }
    const bool heeded = params_.map.semantics && messages.constraints != nullptr;
    publish(header, heeded ? messages.constraints->image_stamp : ros::Time());
    ++n_frames_;
  } catch (const FrameError& error) {
    reject(error.reason(), error.what());
  }
  update_ms_ = (ros::WallTime::now() - start).toSec() * 1e3;
  slowest_update_ms_ = std::max(slowest_update_ms_, update_ms_);
  return true;
}

bool SemanticMapNode::lookUpPose(const std_msgs::Header& header, Frame* frame) {
  try {
    frame->T_map_camera = tf2::transformToEigen(
        tf_.lookupTransform(params_.map_frame, stripSlash(header.frame_id), header.stamp));
    const Eigen::Isometry3d base = tf2::transformToEigen(
        tf_.lookupTransform(params_.map_frame, params_.base_frame, header.stamp));
    frame->p_map_base = Point2{base.translation().x(), base.translation().y()};
    tf_wait_.clear();
    return true;
  } catch (const tf2::TransformException& error) {
    tf_wait_ = error.what();
    return false;
  }
}

void SemanticMapNode::publish(const std_msgs::Header& header, const ros::Time& constraints_stamp) {
  const SafetyGrid& grid = map_.grid();
  if (history_start_.isZero()) history_start_ = header.stamp;
  core_msgs::SafetyGrid message = safetyGridToMessage(grid, header, constraints_stamp);
  message.history_start = history_start_;
  grid_pub_.publish(message);
  core_msgs::InstanceArray instances =
      instancesToMessage(map_.instances(), map_.predicates(), header);
  instances.history_start = history_start_;
  instances_pub_.publish(instances);
  if (probability_pub_->isWanted()) probability_pub_->publish(probabilityToMessage(grid, header));
  if (unsafe_pub_->isWanted()) unsafe_pub_->publish(decisionToMessage(grid, header));
}

MapSnapshot SemanticMapNode::takeSnapshot() {
  MapSnapshot snapshot;
  const std::lock_guard<std::mutex> lock(map_mutex_);
  const ros::WallTime start = ros::WallTime::now();
  const SemanticMapParams& params = params_.map;
  snapshot.header.stamp = map_stamp_;
  snapshot.header.frame_id = params_.map_frame;
  snapshot.tree = taker_.take(&map_.votes().tree());
  snapshot.band = HeightBand{map_.votes().bandMin(), map_.votes().bandMax()};
  if (!params.usesImageOperators()) {
    snapshot.regions =
        buildRegions(map_.instances(), map_.predicates(), params.instance, params.resolution_m);
  }
  snapshot_ms_ = std::max(snapshot_ms_, (ros::WallTime::now() - start).toSec() * 1e3);
  return snapshot;
}

uint64_t SemanticMapNode::countChanges() {
  const std::lock_guard<std::mutex> lock(map_mutex_);
  return n_changes_;
}

void SemanticMapNode::reject(const std::string& reason, const std::string& detail) {
  ++n_rejected_;
  last_rejection_ = "rejected: " + detail;
  ROS_ERROR_THROTTLE(5.0, "semantic_map: frame rejected (%s): %s", reason.c_str(), detail.c_str());
}

void SemanticMapNode::flush(const ros::Time& stamp) {
  ROS_WARN("semantic_map: the stamp went back to %.3f s: the map is flushed", stamp.toSec());
  forget();
  queue_.dropAfter(stamp);
  last_frame_ = ros::Time();
}

bool SemanticMapNode::onReset(std_srvs::Empty::Request&, std_srvs::Empty::Response&) {
  forget();
  return true;
}

bool SemanticMapNode::onClearBox(octomap_msgs::BoundingBoxQuery::Request& request,
                                 octomap_msgs::BoundingBoxQuery::Response&) {
  const Eigen::Vector3d lowest(request.min.x, request.min.y, request.min.z);
  const Eigen::Vector3d highest(request.max.x, request.max.y, request.max.z);
  if (!(lowest.array() <= highest.array()).all()) {  // false for NaN
    ROS_ERROR("semantic_map: clear_bbx: allowed min <= max, and numbers");
    return false;
  }
  const std::lock_guard<std::mutex> lock(map_mutex_);
  if (!map_.clearBox(lowest, highest)) return true;
  history_start_ = ros::Time();  // a new one begins with the next frame
  ++n_changes_;
  ROS_WARN("semantic_map: a part of the map was cleared; the filter waits for cbf_filter/reset");
  return true;
}

void SemanticMapNode::forget() {
  const std::lock_guard<std::mutex> lock(map_mutex_);
  map_.clear();
  map_stamp_ = history_start_ = ros::Time();
  ++n_changes_;
}

}  // namespace core_perception
