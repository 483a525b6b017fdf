#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Takes what cbf_filter takes and answers zero at its rate: what is left of a latency when nothing is decided."""

import time

import rospy
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rospy.numpy_msg import numpy_msg

PERIOD_S = 0.05


def main():
    rospy.init_node("null_filter")
    for topic, kind in (("cmd_vel_nominal", Twist), ("odom", Odometry), ("safety_grid", numpy_msg(SafetyGrid))):
        rospy.Subscriber(topic, kind, lambda message: None, queue_size=1, buff_size=2**24, tcp_nodelay=True)
    command = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
    state = rospy.Publisher("cbf_filter/state", FilterState, queue_size=10, tcp_nodelay=True)
    due_s = time.monotonic()
    while not rospy.is_shutdown():
        message = FilterState()
        message.header.stamp = rospy.Time.now()
        command.publish(Twist())
        state.publish(message)
        due_s = max(due_s + PERIOD_S, time.monotonic())
        time.sleep(max(0.0, due_s - time.monotonic()))


if __name__ == "__main__":
    main()
