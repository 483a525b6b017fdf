# SPDX-License-Identifier: BSD-3-Clause
"""The body of the quadruped, from primitives only: its links, their masses, and the URDF text of it all.

Kinematics of Spot (hip places and link lengths as in Clearpath's spot_description); masses are estimates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterator, Sequence, Tuple

import numpy as np

from core_bringup.camera_mount import CameraMount
from core_bringup.quadruped.kinematics import FRONT, LEFT, LEGS, LegKinematics
from core_bringup.quadruped.params import LegParams, QuadrupedParams, TrunkParams

BASE_FRAME = "base_link"
TRUNK_FRAME = "trunk"
CAMERA_FRAME = "camera_link"
OPTICAL_FRAME = "camera_color_optical_frame"
OPTICAL_RPY_RAD = (-np.pi / 2.0, 0.0, -np.pi / 2.0)
_YELLOW, _GREY, _DARK, _BLACK = "0.95 0.76 0.10 1", "0.45 0.46 0.48 1", "0.16 0.16 0.18 1", "0.05 0.05 0.05 1"


@dataclass(frozen=True)
class Shape:
    """A box (size: x, y, z) or a sphere (size: radius) fixed to a link."""

    size_m: Tuple[float, ...]
    xyz_m: Tuple[float, float, float]
    rgba: str
    collides: bool = True


@dataclass(frozen=True)
class Link:
    """A link and the joint that carries it; joint is None for the root, axis None for a fixed joint."""

    name: str
    mass_kg: float
    com_m: Tuple[float, float, float]
    inertia_kgm2: Tuple[float, float, float]
    shapes: Tuple[Shape, ...]
    joint: str = ""
    parent: str = ""
    origin_m: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: str = ""
    joint_index: int = 0


def compute_box_inertia(mass_kg: float, size_m: Sequence[float]) -> Tuple[float, ...]:
    """Principal moments m/12 (b^2 + c^2) [kg m^2] of a solid box with edges size_m (3,)."""
    x, y, z = (edge * edge for edge in size_m)
    return tuple(mass_kg / 12.0 * total for total in (y + z, x + z, x + y))


def build_links(params: QuadrupedParams, camera_mount: CameraMount) -> Tuple[Link, ...]:
    """All links of the robot, parents first.

    Args:
        params: QuadrupedParams.
        camera_mount: pose of camera_link in base_link.

    Returns:
        Tuple of Link.
    """
    links = [_trunk_link(params.trunk)]
    for index, leg in enumerate(LEGS):
        links.extend(_leg_links(params.leg, leg, FRONT[index], LEFT[index]))
    mount = camera_mount
    body = Shape((0.03, 0.10, 0.03), (-0.016, 0.0, 0.0), _BLACK, collides=False)
    links.append(
        Link(
            CAMERA_FRAME,
            0.05,
            (0.0, 0.0, 0.0),
            (1e-4,) * 3,
            (body,),
            "camera_joint",
            BASE_FRAME,
            (mount.x_m, mount.y_m, mount.z_m),
            (mount.roll_rad, mount.pitch_rad, mount.yaw_rad),
        )
    )
    links.append(
        Link(
            OPTICAL_FRAME,
            0.001,
            (0.0, 0.0, 0.0),
            (1e-6,) * 3,
            (),
            "camera_optical_joint",
            CAMERA_FRAME,
            rpy_rad=OPTICAL_RPY_RAD,
        )
    )
    return tuple(links)


def _trunk_link(trunk: TrunkParams) -> Link:
    length, width, height = trunk.size_m
    head_x = 0.5 * (length + trunk.head_size_m[0])
    head_z = 0.045
    shapes = (
        Shape(trunk.size_m, (0.0, 0.0, 0.0), _YELLOW),
        Shape(trunk.head_size_m, (head_x, 0.0, head_z), _GREY),
        Shape((0.5 * length, 0.8 * width, 0.02), (0.0, 0.0, 0.5 * height + 0.01), _GREY, collides=False),
    )
    return Link(BASE_FRAME, trunk.mass_kg, (0.0, 0.0, 0.0), compute_box_inertia(trunk.mass_kg, trunk.size_m), shapes)


def _leg_links(leg: LegParams, name: str, front: float, left: float) -> Tuple[Link, ...]:
    """Hip, thigh, shank and foot of one leg; thigh and shank weigh where their motors sit, near the upper end."""
    hip_kg, thigh_kg, shank_kg, foot_kg = leg.link_mass_kg
    hip_box, thigh_box, shank_box = (0.14, 0.09, 0.12), (0.075, 0.05, leg.thigh_m), (0.035, 0.03, leg.shank_m)
    hip_com = (0.0, 0.5 * left * leg.hip_to_thigh_m, 0.0)
    radius = leg.foot_radius_m
    return (
        Link(
            f"{name}_hip",
            hip_kg,
            hip_com,
            compute_box_inertia(hip_kg, hip_box),
            (Shape(hip_box, hip_com, _DARK, collides=False),),
            f"{name}_hip_x",
            BASE_FRAME,
            (front * leg.hip_x_m, left * leg.hip_y_m, 0.0),
            axis="1 0 0",
            joint_index=0,
        ),
        Link(
            f"{name}_thigh",
            thigh_kg,
            (0.0, 0.0, -0.3 * leg.thigh_m),
            compute_box_inertia(thigh_kg, thigh_box),
            (Shape(thigh_box, (0.0, 0.0, -0.5 * leg.thigh_m), _DARK),),
            f"{name}_hip_y",
            f"{name}_hip",
            (0.0, left * leg.hip_to_thigh_m, 0.0),
            axis="0 1 0",
            joint_index=1,
        ),
        Link(
            f"{name}_shank",
            shank_kg,
            (0.0, 0.0, -0.4 * leg.shank_m),
            compute_box_inertia(shank_kg, shank_box),
            (Shape(shank_box, (0.0, 0.0, -0.5 * leg.shank_m), _DARK),),
            f"{name}_knee",
            f"{name}_thigh",
            (0.0, 0.0, -leg.thigh_m),
            axis="0 1 0",
            joint_index=2,
        ),
        Link(
            f"{name}_foot",
            foot_kg,
            (0.0, 0.0, 0.0),
            (0.4 * foot_kg * radius**2,) * 3,
            (Shape((radius,), (0.0, 0.0, 0.0), _BLACK),),
            f"{name}_ankle",
            f"{name}_shank",
            (0.0, 0.0, -leg.shank_m),
        ),
    )


def compute_stand_joints(params: QuadrupedParams) -> np.ndarray:
    """Joint angles (4, 3) [rad] of the level stand with every foot below its hip y axis."""
    kinematics = LegKinematics(params.leg)
    feet = kinematics.p_base_thigh.copy()
    feet[:, 2] -= params.gait.body_height_m - params.leg.foot_radius_m
    return kinematics.compute_joints(feet)


@dataclass(frozen=True)
class MassProperties:
    """Whole robot as one rigid body: mass [kg], centre (3,) [m] in base_link, inertia (3, 3) [kg m^2] about it."""

    mass_kg: float
    com_m: np.ndarray
    inertia_kgm2: np.ndarray


def compute_mass_properties(params: QuadrupedParams, camera_mount: CameraMount, q_rad: np.ndarray) -> MassProperties:
    """Mass, centre and inertia of the robot with its joints held at q_rad (4, 3).

        c = sum m_i c_i / m,   I = sum R_i I_i R_i^T + m_i (|r_i|^2 1 - r_i r_i^T),   r_i = c_i - c

    Args:
        params: QuadrupedParams.
        camera_mount: CameraMount.
        q_rad: (4, 3) joint angles.

    Returns:
        MassProperties.
    """
    poses, parts = {}, []
    for link in build_links(params, camera_mount):
        rotation, position = poses.get(link.parent, (np.eye(3), np.zeros(3)))
        position = position + rotation @ np.array(link.origin_m)
        if link.axis:
            angle = q_rad[LEGS.index(link.name[:2]), link.joint_index]
            rotation = rotation @ _axis_rotation(link.axis, angle)
        poses[link.name] = (rotation, position)
        inertia = rotation @ np.diag(link.inertia_kgm2) @ rotation.T
        parts.append((link.mass_kg, position + rotation @ np.array(link.com_m), inertia))
    mass = sum(part[0] for part in parts)
    com = sum(part[0] * part[1] for part in parts) / mass
    total = np.zeros((3, 3))
    for part_kg, centre, inertia in parts:
        r = centre - com
        total += inertia + part_kg * (r @ r * np.eye(3) - np.outer(r, r))
    return MassProperties(mass, com, total)


def _axis_rotation(axis: str, angle_rad: float) -> np.ndarray:
    s, c = np.sin(angle_rad), np.cos(angle_rad)
    if axis == "1 0 0":
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def build_urdf(name: str, params: QuadrupedParams, camera_mount: CameraMount, separate_trunk: bool = False) -> str:
    """URDF text of the robot.

    Args:
        name: name of the robot element.
        params: QuadrupedParams.
        camera_mount: CameraMount.
        separate_trunk: make base_link an empty frame with the trunk fixed to it, because KDL (robot_state_publisher)
            wants a root without inertia; PyBullet would nail such a root to the world.

    Returns:
        The XML text; every geometry is a primitive, so it needs no file beside it.
    """
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">']
    links = build_links(params, camera_mount)
    if separate_trunk:
        lines.append(f'  <link name="{BASE_FRAME}"/>')
        links = (replace(links[0], name=TRUNK_FRAME, joint="trunk_joint", parent=BASE_FRAME), *links[1:])
    for link in links:
        lines.extend(_link_xml(link))
        if link.joint:
            lines.extend(_joint_xml(link, params.leg))
    lines.append("</robot>")
    return "\n".join(lines) + "\n"


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _link_xml(link: Link) -> Iterator[str]:
    ixx, iyy, izz = link.inertia_kgm2
    yield f'  <link name="{link.name}">'
    yield f'    <inertial><origin xyz="{_numbers(link.com_m)}"/><mass value="{link.mass_kg:.9g}"/>'
    yield f'      <inertia ixx="{ixx:.9g}" ixy="0" ixz="0" iyy="{iyy:.9g}" iyz="0" izz="{izz:.9g}"/></inertial>'
    for number, shape in enumerate(link.shapes):
        box = len(shape.size_m) == 3
        size = f'<box size="{_numbers(shape.size_m)}"/>' if box else f'<sphere radius="{shape.size_m[0]:.9g}"/>'
        place = f'<origin xyz="{_numbers(shape.xyz_m)}"/><geometry>{size}</geometry>'
        material = f'<material name="{link.name}_{number}"><color rgba="{shape.rgba}"/></material>'
        yield f"    <visual>{place}{material}</visual>"
        if shape.collides:
            yield f"    <collision>{place}</collision>"
    yield "  </link>"


def _joint_xml(link: Link, leg: LegParams) -> Iterator[str]:
    kind = "revolute" if link.axis else "fixed"
    yield f'  <joint name="{link.joint}" type="{kind}">'
    yield f'    <parent link="{link.parent}"/><child link="{link.name}"/>'
    yield f'    <origin xyz="{_numbers(link.origin_m)}" rpy="{_numbers(link.rpy_rad)}"/>'
    if link.axis:
        i = link.joint_index
        limits = f'lower="{leg.joint_lower_rad[i]:.9g}" upper="{leg.joint_upper_rad[i]:.9g}"'
        effort = f'effort="{leg.max_torque_nm[i]:.9g}" velocity="{leg.max_joint_speed_radps:.9g}"'
        yield f'    <axis xyz="{link.axis}"/><limit {limits} {effort}/>'
    yield "  </joint>"
