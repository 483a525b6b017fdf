# SPDX-License-Identifier: BSD-3-Clause
"""How a run is judged, shown and repeated; nothing here needs ROS, and ros/trial_monitor_node feeds it."""
