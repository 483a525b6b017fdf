# SPDX-License-Identifier: BSD-3-Clause
"""ROS shells of this package: the only place that imports rospy and messages."""
