# SPDX-License-Identifier: BSD-3-Clause
"""Node decompress_image: ``image/compressed`` (also compressedDepth) -> ``image``, while somebody reads it."""

from __future__ import annotations

import threading

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage, Image

from core_perception.compressed_image import decode_image
from core_perception.exceptions import EvidenceError
from core_perception.ros.conversions import array_to_image
from core_perception.ros.diagnostics import Diagnostics, make_status

IMAGE_BUFFER_BYTES = 2**24
QUEUE_SIZE = 5


class DecompressImageNode:
    """Hands every image on with its header; one that cannot be decoded is told and left out."""

    def __init__(self):
        """Connect the topics."""
        self._lock = threading.Lock()
        self._counts = {"decoded": 0, "refused": 0}
        self._failure = ""  # of the last second
        self._publisher = rospy.Publisher("image", Image, queue_size=QUEUE_SIZE)
        Diagnostics(self._tell).start()
        rospy.Subscriber(
            "image/compressed",
            CompressedImage,
            self._on_image,
            queue_size=QUEUE_SIZE,
            buff_size=IMAGE_BUFFER_BYTES,
            tcp_nodelay=True,
        )

    def _on_image(self, msg):
        if self._publisher.get_num_connections() == 0:
            return
        try:
            pixels, encoding = decode_image(msg.data, msg.format)
        except EvidenceError as error:
            with self._lock:
                self._counts["refused"] += 1
                self._failure = str(error)
            rospy.logerr_throttle(10.0, f"image not decoded: {error}")
            return
        with self._lock:
            self._counts["decoded"] += 1
        self._publisher.publish(array_to_image(pixels, encoding, msg.header))

    def _tell(self):
        with self._lock:
            failure, self._failure = self._failure, ""
            counts = dict(self._counts)
        level = DiagnosticStatus.ERROR if failure else DiagnosticStatus.OK
        none_yet = f"no image of {rospy.resolve_name('image/compressed')} was wanted and came yet"
        words = failure or ("decoding" if counts["decoded"] else none_yet)
        return [make_status("images", level, words, {name: str(count) for name, count in counts.items()})]


def main() -> int:
    """Run the node; it has no parameters."""
    rospy.init_node("decompress_image")
    node = DecompressImageNode()
    rospy.spin()
    del node
    return 0
