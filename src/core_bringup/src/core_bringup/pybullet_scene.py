# SPDX-License-Identifier: BSD-3-Clause
"""Builds a world and a robot inside one PyBullet client, for the physics and for the renderer alike."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import numpy as np
import pybullet

from core_bringup.exceptions import BringupError
from core_bringup.quadruped.kinematics import JOINT_NAMES
from core_bringup.robot import RobotConfig
from core_bringup.world_types import Surface, World, WorldObject

_PATCH_DEPTH_M = 0.05
_COPLANAR_LIFT_M = 0.001  # a patch as high as the floor is put this far above it, or the two would flicker
_HULL_MARGIN_M = 0.001  # Bullet grows a convex hull by this much
_FRICTION = 1.0


class PybulletScene:
    """The bodies of a world and of the robot, and which label each body carries.

    The floor (first surface) collides as an endless plane at its height, so nothing falls off the world; it is drawn as
    its polygon. Other surfaces collide as prisms. Objects are static; one that is not solid is only drawn.
    """

    def __init__(self, client_id: int, world: World, robot_urdf_path: Path, visual: bool = True):
        """Build everything.

        Args:
            client_id: PyBullet client, empty.
            world: World.
            robot_urdf_path: file with the URDF of the robot.
            visual: also build what is drawn (textures, meshes); physics alone does without.
        """
        self._client, self._visual = client_id, visual
        self._labels, self._bodies, self._items = {}, {}, {}
        try:
            self.robot = pybullet.loadURDF(
                str(robot_urdf_path), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client_id
            )
        except pybullet.error as error:
            raise BringupError(f"PyBullet cannot load the robot {robot_urdf_path}: {error}") from error
        # Small before large and the floor last: the software renderer draws in this order and skips what is hidden.
        for item in sorted(world.objects, key=lambda item: float(np.prod(item.size_m))):
            self.add_object(item)
        self.floor_bodies = tuple(self._add_surface(world, index) for index in reversed(range(len(world.surfaces))))
        self.joint_ids, self.link_ids = self._index_robot()
        self._joint_of = dict(zip(JOINT_NAMES, self.joint_ids))
        dynamics = pybullet.getDynamicsInfo(self.robot, -1, physicsClientId=client_id)
        self._inertial, self._inertial_inverse = dynamics[3:5], pybullet.invertTransform(*dynamics[3:5])

    @property
    def label_of_body(self) -> Dict[int, int]:
        """Dict of PyBullet body id to label id of the world; the robot has none."""
        return dict(self._labels)

    @property
    def objects(self) -> Tuple[WorldObject, ...]:
        """WorldObjects of the scene as they stand now."""
        return tuple(self._items.values())

    def add_object(self, item: WorldObject) -> None:
        """Put a WorldObject into the scene.

        Raises:
            BringupError: its id is taken or its mesh cannot be loaded.
        """
        if item.id in self._labels.values():
            raise BringupError(f"object id {item.id} ({item.name}): taken; allowed: a free id")
        half_height = 0.5 * float(item.size_m[2])
        collision = self._create_collision(item, half_height) if item.solid else -1
        visual = self._create_visual(item, half_height) if self._visual else -1
        body = pybullet.createMultiBody(
            0.0, collision, visual, *_object_pose(item.position_m, item.yaw_rad), physicsClientId=self._client
        )
        pybullet.changeDynamics(body, -1, lateralFriction=_FRICTION, physicsClientId=self._client)
        self._labels[body], self._bodies[item.id], self._items[item.id] = item.id, body, item

    def move_object(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Put the bottom centre of an object to position_m (3,) with heading yaw_rad."""
        pybullet.resetBasePositionAndOrientation(
            self._body(label_id), *_object_pose(position_m, yaw_rad), physicsClientId=self._client
        )
        item = self._items[label_id]
        self._items[label_id] = replace(item, position_m=np.array(position_m, dtype=float), yaw_rad=float(yaw_rad))

    def remove_object(self, label_id: int) -> None:
        """Take an object out of the scene."""
        body = self._body(label_id)
        pybullet.removeBody(body, physicsClientId=self._client)
        del self._labels[body], self._bodies[label_id], self._items[label_id]

    def set_robot(
        self,
        p_world_base: Sequence[float],
        q_world_base: Sequence[float],
        joint_positions_rad: Sequence[float],
        joint_names: Sequence[str] = JOINT_NAMES,
    ) -> None:
        """Put the robot at rest into a pose: base_link (3,) [m], quaternion x, y, z, w, and joint angles by name."""
        pose = pybullet.multiplyTransforms(_floats(p_world_base), _floats(q_world_base), *self._inertial)
        pybullet.resetBasePositionAndOrientation(self.robot, *pose, physicsClientId=self._client)
        pybullet.resetBaseVelocity(self.robot, (0, 0, 0), (0, 0, 0), physicsClientId=self._client)
        for name, angle in zip(joint_names, joint_positions_rad):
            pybullet.resetJointState(self.robot, self._joint_of[name], float(angle), physicsClientId=self._client)

    def get_base(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Pose and velocity of base_link, the link frame, not the inertial frame PyBullet reports.

            p_link = p_inertial (+) T_inertial^-1,   v_link = v_inertial + w x (p_link - p_inertial)

        Returns:
            Position (3,) [m], quaternion (4,), linear (3,) [m/s] and angular velocity (3,) [rad/s], all world axes.
        """
        p_com, q_com = pybullet.getBasePositionAndOrientation(self.robot, physicsClientId=self._client)
        p, q = pybullet.multiplyTransforms(p_com, q_com, *self._inertial_inverse)
        v, w = (np.array(x) for x in pybullet.getBaseVelocity(self.robot, physicsClientId=self._client))
        p = np.array(p)
        r = p - p_com
        v += np.array([w[1] * r[2] - w[2] * r[1], w[2] * r[0] - w[0] * r[2], w[0] * r[1] - w[1] * r[0]])
        return p, np.array(q), v, w

    def _body(self, label_id: int) -> int:
        if label_id not in self._bodies:
            raise BringupError(f"object id {label_id}: unknown; allowed: {sorted(self._bodies)}")
        return self._bodies[label_id]

    def _index_robot(self) -> Tuple[List[int], Dict[str, int]]:
        """Joint indices in the order of JOINT_NAMES, and link indices by link name (-1 is base_link)."""
        joints, links = {}, {"base_link": -1}
        for index in range(pybullet.getNumJoints(self.robot, physicsClientId=self._client)):
            info = pybullet.getJointInfo(self.robot, index, physicsClientId=self._client)
            joints[info[1].decode()], links[info[12].decode()] = index, index
        return [joints[name] for name in JOINT_NAMES], links

    def _add_surface(self, world: World, index: int) -> int:
        surface = world.surfaces[index]
        lift_m = _COPLANAR_LIFT_M * index if surface.z_m == world.surfaces[0].z_m else 0.0
        collision = self._create_surface_collision(surface, index == 0)
        visual = self._create_surface_visual(surface) if self._visual else -1
        place = (0.0, 0.0, float(surface.z_m) + lift_m)
        body = pybullet.createMultiBody(0.0, collision, visual, place, physicsClientId=self._client)
        pybullet.changeDynamics(body, -1, lateralFriction=_FRICTION, physicsClientId=self._client)
        if self._visual and surface.texture is not None:
            self._paint(body, surface.texture)
        self._labels[body] = surface.id
        return body

    def _create_surface_collision(self, surface: Surface, is_floor: bool) -> int:
        if is_floor:
            return pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        heights = (-_PATCH_DEPTH_M, -_HULL_MARGIN_M)
        layers = [np.column_stack([surface.polygon_m, np.full(len(surface.polygon_m), z)]) for z in heights]
        return pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=np.concatenate(layers).tolist(), physicsClientId=self._client
        )

    def _create_surface_visual(self, surface: Surface) -> int:
        """The polygon as an OBJ file, because EGL crashes on meshes handed over as lists."""
        color = (1.0, 1.0, 1.0, 1.0) if surface.texture is not None else _floats(surface.color_rgba)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "surface.obj"
            path.write_text(build_surface_obj(surface), encoding="ascii")
            return pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(path),
                rgbaColor=color,
                specularColor=(0.0, 0.0, 0.0),
                physicsClientId=self._client,
            )

    def _paint(self, body: int, path: Path) -> None:
        texture = pybullet.loadTexture(str(path), physicsClientId=self._client)
        if texture < 0:
            raise BringupError(f"PyBullet cannot read the texture {path}")
        pybullet.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=self._client)

    def _create_collision(self, item: WorldObject, half_height: float) -> int:
        place = {"collisionFramePosition": (0.0, 0.0, half_height), "physicsClientId": self._client}
        if item.collision == "cylinder":
            return pybullet.createCollisionShape(
                pybullet.GEOM_CYLINDER, radius=0.5 * float(item.size_m[0]), height=2.0 * half_height, **place
            )
        return pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=_floats(0.5 * item.size_m), **place)

    def _create_visual(self, item: WorldObject, half_height: float) -> int:
        place = {
            "visualFramePosition": (0.0, 0.0, half_height),
            "rgbaColor": _floats(item.color_rgba),
            "specularColor": (0.0, 0.0, 0.0),
            "physicsClientId": self._client,
        }
        if item.shape == "mesh":
            return self._load_mesh(item)
        if item.shape == "cylinder":
            return pybullet.createVisualShape(
                pybullet.GEOM_CYLINDER, radius=0.5 * float(item.size_m[0]), length=2.0 * half_height, **place
            )
        return pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=_floats(0.5 * item.size_m), **place)

    def _load_mesh(self, item: WorldObject) -> int:
        if not item.mesh.is_file():  # PyBullet would draw nothing and say so only on its own console
            raise BringupError(f"object {item.name}: no file {item.mesh}; allowed: an OBJ file")
        return pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            fileName=str(item.mesh),
            rgbaColor=(1.0, 1.0, 1.0, 1.0),
            meshScale=_floats(item.mesh_scale),
            physicsClientId=self._client,
        )


def build_surface_obj(surface: Surface) -> str:
    """OBJ text of a Surface at z = 0: triangles seen from above; uv counts texture tiles from the lower corner."""
    polygon = np.asarray(surface.polygon_m, dtype=float)
    tiles = (polygon - polygon.min(axis=0)) / surface.texture_tile_m
    lines = [f"v {x:.9g} {y:.9g} 0" for x, y in polygon]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in tiles]
    lines.append("vn 0 0 1")
    corners = [f"{k}/{k}/1" for k in range(1, len(polygon) + 1)]
    lines += [f"f {corners[0]} {corners[k]} {corners[k + 1]}" for k in range(1, len(polygon) - 1)]
    return "\n".join(lines) + "\n"


def _object_pose(position_m: Sequence[float], yaw_rad: float) -> Tuple[List[float], Tuple[float, ...]]:
    return _floats(position_m), (0.0, 0.0, float(np.sin(0.5 * yaw_rad)), float(np.cos(0.5 * yaw_rad)))


def _floats(values: Sequence[float]) -> List[float]:
    return [float(value) for value in values]


def write_urdf(robot: RobotConfig) -> Path:
    """Write the URDF of a RobotConfig to a temporary file and return its path; the caller deletes it."""
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", delete=False) as file:
        file.write(robot.physics_urdf_text())
    return Path(file.name)
