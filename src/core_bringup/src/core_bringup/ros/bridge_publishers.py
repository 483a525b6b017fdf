# SPDX-License-Identifier: BSD-3-Clause
"""Everything world_bridge publishes; values in, messages out."""

from __future__ import annotations

import math

import rospy
import tf2_ros
from core_msgs.msg import LabelInfo, Tick, Violation
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import UInt8MultiArray
from tf2_msgs.msg import TFMessage

from core_bringup.backend import RobotState
from core_bringup.camera import Frame
from core_bringup.params import BridgeParams
from core_bringup.ros import conversions as to
from core_bringup.rotations import quaternion_of_rpy
from core_bringup.simulation import Simulation

QUEUE_SIZE = 10
OPTICAL_RPY_RAD = (-0.5 * math.pi, 0.0, -0.5 * math.pi)


class BridgePublishers:
    """Publishers and frame names; under lock-step all topics are latched, so that a late subscriber gets tick 1."""

    def __init__(self, simulation: Simulation, params: BridgeParams):
        """Advertise everything and send the static transforms."""
        self._simulation, self._params = simulation, params
        self._odom_frame, self._base_frame, self._camera_frame, self._optical_frame = (
            params.frame_prefix + name for name in ("odom", "base_link", "camera_link", "camera_color_optical_frame")
        )
        self._clock = self._advertise("/clock", Clock) if params.publish_clock else None
        self._tf = self._advertise("/tf", TFMessage)
        self._odom = self._advertise("odom", Odometry)
        self._joints = self._advertise("joint_states", JointState)
        self._contacts = self._advertise("foot_contacts", UInt8MultiArray)
        self._violation = self._advertise("ground_truth/violation", Violation)
        self._diagnostics = rospy.Publisher("diagnostics", DiagnosticArray, queue_size=QUEUE_SIZE)
        self._tick = self._advertise("lockstep/tick", Tick) if params.lockstep else None
        if simulation.schedule.frame_every:
            self._advertise_camera()
        self._static_tf = tf2_ros.StaticTransformBroadcaster()
        self._static_tf.sendTransform(self._static_transforms())

    def publish_clock(self, stamp_ns: int) -> None:
        """Sim time."""
        if self._clock is not None:
            self._clock.publish(Clock(to.stamp_to_msg(stamp_ns)))

    def publish_state(self, stamp_ns: int, state: RobotState) -> None:
        """Robot's tf, odom, joint_states and foot_contacts, and the ground truth of its place."""
        header = to.header_to_msg(stamp_ns, self._odom_frame)
        base = self._base_frame
        self._tf.publish(TFMessage([to.transform_to_msg(state.p_world_base, state.q_world_base, header, base)]))
        self._odom.publish(to.odometry_to_msg(state, header, base))
        self._joints.publish(to.joint_state_to_msg(state, to.header_to_msg(stamp_ns, "")))
        self._contacts.publish(to.foot_contacts_to_msg(state))
        truth = self._simulation.measure_truth(state)
        self._violation.publish(to.violation_to_msg(truth, state.fallen, header))

    def publish_frame(self, stamp_ns: int, frame: Frame) -> None:
        """Colour, depth and labels of one instant, with their infos; one stamp and frame_id for all."""
        header = to.header_to_msg(stamp_ns, self._optical_frame)
        info = to.camera_info_to_msg(self._simulation.camera, header)
        self._color_info.publish(info)
        self._depth_info.publish(info)
        self._color.publish(to.image_to_msg(frame.color, header))
        self._depth.publish(to.image_to_msg(frame.depth_m, header))
        self._labels.publish(to.image_to_msg(frame.labels, header))
        names = self._simulation.names_in(frame)
        self._label_info.publish(to.label_info_to_msg(names, self._simulation.class_names, header))

    def publish_tick(self, tick: int) -> None:
        """The tick that everything published since the last one belongs to."""
        schedule = self._simulation.schedule
        stamps = schedule.stamp_ns(tick), schedule.period_ns, schedule.frame_stamp_ns(tick)
        self._tick.publish(to.tick_to_msg(tick, *stamps))

    def publish_diagnostics(self, stamp_ns: int, rtf: float, paused: bool) -> None:
        """Real-time factor, back end and renderer."""
        params = self._params
        values = {"rtf": f"{rtf:.3f}", "backend": params.backend, "renderer": params.renderer, "task": params.task,
                  "lockstep": str(params.lockstep).lower(), "seed": str(params.seed)}  # fmt: skip
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=rospy.get_name().lstrip("/") + ": world",
            hardware_id=self._simulation.robot.name,
            message="paused" if paused else f"running at {rtf:.2f} of real time",
            values=[KeyValue(key, value) for key, value in values.items()],
        )
        self._diagnostics.publish(DiagnosticArray(to.header_to_msg(stamp_ns, ""), [status]))

    def _advertise(self, topic: str, kind: type) -> rospy.Publisher:
        return rospy.Publisher(topic, kind, latch=self._params.lockstep, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def _advertise_camera(self) -> None:
        self._color = self._advertise("camera/color/image_raw", Image)
        self._color_info = self._advertise("camera/color/camera_info", CameraInfo)
        self._depth = self._advertise("camera/depth/image_raw", Image)
        self._depth_info = self._advertise("camera/depth/camera_info", CameraInfo)
        self._labels = self._advertise("ground_truth/labels", Image)
        self._label_info = self._advertise("ground_truth/label_info", LabelInfo)

    def _static_transforms(self) -> list:
        """base_link -> camera_link -> optical frame, as in the robot's URDF."""
        mount = self._simulation.robot.camera_mount
        link_q = quaternion_of_rpy(mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
        place_m = (mount.x_m, mount.y_m, mount.z_m)
        base, link = (to.header_to_msg(0, frame) for frame in (self._base_frame, self._camera_frame))
        return [
            to.transform_to_msg(place_m, link_q, base, self._camera_frame),
            to.transform_to_msg((0.0, 0.0, 0.0), quaternion_of_rpy(*OPTICAL_RPY_RAD), link, self._optical_frame),
        ]
