#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""self_check.launch in front of the simulator's camera: whole, and with one fault at a time in between."""

import contextlib
import os
import re
import subprocess
import sys
import unittest

import numpy as np
import rospy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

OPTICAL, LIFTED = "camera_color_optical_frame", "lifted_optical_frame"
TOPICS = {
    "color": ("camera/color/image_raw", Image),
    "depth": ("camera/depth/image_raw", Image),
    "camera_info": ("camera/color/camera_info", CameraInfo),
    "labels": ("segmentation/labels", Image),
}
PARTS = ["depth values", "floor", "frames", "intrinsics", "registration of depth and colour"]
PARTS += ["registration of depth and labels", "stamps", "tf"]
SHIFT_PX = 6
TIME_LIMIT_S = 90.0


def edited(image, change):
    """A copy of an image message; change maps its pixels."""
    dtype = {"32FC1": np.float32, "mono16": np.uint16}[image.encoding]
    pixels = np.frombuffer(image.data, dtype).reshape(image.height, image.width)
    copy = Image(image.header, image.height, image.width, image.encoding, image.is_bigendian, image.step, b"")
    copy.data = np.ascontiguousarray(change(pixels)).tobytes()
    return copy


def in_frame(message, frame_id):
    message.header.frame_id = frame_id
    return message


def of_another_size(info):
    return CameraInfo(header=info.header, width=640, height=480, K=[525.0, 0, 319.5, 0, 525.0, 239.5, 0, 0, 1])


# What is done to which stream; which check must tell it, in which words.
FAULTS = {
    "depth_in_millimetres": (
        {"depth": lambda m: edited(m, lambda z: z * np.float32(1000.0))},
        "look like millimetres",
    ),
    "mirrored_labels": (
        {"labels": lambda m: edited(m, lambda ids: ids[:, ::-1])},
        "The label images are turned left to right against depth",
    ),
    "camera_lower_than_tf_says": (
        {name: lambda m: in_frame(m, LIFTED) for name in TOPICS},  # 0.2 m along a camera that looks down by 15 degrees
        "The floor lies 0.19 m above where tf says",
    ),
    "camera_info_of_another_size": (
        {"camera_info": of_another_size},
        "The depth images are 500 x 320, camera_info is for 640 x 480",
    ),
    "depth_beside_colour": (
        {"depth": lambda m: edited(m, lambda z: np.roll(z, SHIFT_PX, axis=1))},
        f"Edges in the colour images lie {SHIFT_PX} px to the left of those in depth",
    ),
}


class Relay:
    """Hands streams on under a name of their own, changed."""

    def __init__(self, name, changes):
        self.arguments, self._ends = [], []
        for stream, (topic, kind) in TOPICS.items():
            if stream not in changes:
                continue
            out = rospy.Publisher(f"/{name}/{topic}", kind, queue_size=5)
            into = rospy.Subscriber(topic, kind, self._hand_on, (out, changes[stream]), queue_size=5)
            self._ends += [into, out]
            self.arguments.append(f"{stream}:=/{name}/{topic}")

    @staticmethod
    def _hand_on(message, how):
        out, change = how
        with contextlib.suppress(rospy.ROSException):  # one that comes while the relay is closed
            out.publish(change(message))

    def close(self):
        for end in self._ends:
            end.unregister()


def run_check(arguments):
    """Exit status is roslaunch's own; return the sentences by level, without the node's name and stamps."""
    command = ["roslaunch", "core_bringup", "self_check.launch", *arguments]
    done = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIME_LIMIT_S,
        check=False,
        env={**os.environ, "ROS_NAMESPACE": "/checked"},
    )
    found = re.findall(r"\[ *(INFO|WARN|ERROR) *\] .*?: self_check: (.*)", re.sub(r"\x1b\[\d*m", "", done.stdout))
    return [words for level, words in found if level == "INFO"], [words for level, words in found if level != "INFO"]


class SelfCheckFaults(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        pose = Transform(Vector3(0.0, -0.2, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))  # up, in an optical frame
        cls.static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        cls.static.publish(TFMessage([TransformStamped(Header(frame_id=OPTICAL), LIFTED, pose)]))
        for topic, kind in TOPICS.values():
            rospy.wait_for_message(topic, kind, 60.0)

    def test_a_whole_camera_is_found_whole_in_every_part(self):
        notes, wrong = run_check([f"{stream}:=/{topic}" for stream, (topic, _) in TOPICS.items()])
        self.assertEqual(wrong, [])
        self.assertEqual(notes[-1], "nothing wrong found")
        self.assertEqual(sorted(note.split(": ")[0] for note in notes if note.split(": ")[0] in PARTS), sorted(PARTS))

    def tell(self, name):
        changes, words = FAULTS[name]
        relay = Relay(name, changes)
        try:
            whole = [f"{s}:=/{t}" for s, (t, _) in TOPICS.items() if s not in changes]
            _, wrong = run_check([*relay.arguments, *whole])
        finally:
            relay.close()
        self.assertTrue(any(words in sentence for sentence in wrong), wrong)
        return wrong


def add_test(name):
    setattr(SelfCheckFaults, f"test_{name}_is_told", lambda self: self.tell(name))


for fault in FAULTS:
    add_test(fault)

if __name__ == "__main__":
    import rostest

    rospy.init_node("self_check_faults_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "self_check_faults", SelfCheckFaults, sys.argv)
