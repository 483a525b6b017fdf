# SPDX-License-Identifier: BSD-3-Clause
"""Builds a world and a robot inside one PyBullet client, for the physics and for the renderer alike."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
import pybullet

from core_bringup.drawn_mesh import DrawnMesh, box_mesh, read_mesh, surface_mesh
from core_bringup.exceptions import BringupError
from core_bringup.face_painter import FacePainter
from core_bringup.quadruped.kinematics import JOINT_NAMES
from core_bringup.robot import RobotConfig
from core_bringup.touched import touched_boxes_m
from core_bringup.world_types import Surface, World, WorldObject

_PATCH_DEPTH_M = 0.05
_COPLANAR_LIFT_M = 0.001  # a patch as high as the floor is put this far above it, or the two would flicker
_WHITE = (1.0, 1.0, 1.0, 1.0)
_LONGEST_EDGE_M = 2.5  # of a drawn triangle
_LEAST_FACE_M2 = 0.25  # of an object's face for the FacePainter
_HULL_MARGIN_M = 0.001  # Bullet grows a convex hull by this much
_FRICTION = 1.0


class PybulletScene:
    """The bodies of a world and of the robot, and which label each body carries.

    The floor (first surface) collides as an endless plane at its height, so nothing falls off the world; it is drawn as
    its polygon. Other surfaces are prisms from their height to below the floor. No object is pushed by what it meets;
    one that is not solid is only drawn.
    """

    def __init__(
        self,
        client_id: int,
        world: World,
        robot_urdf_path: Path,
        visual: bool = True,
        faces: Optional[FacePainter] = None,
    ):
        """Build everything.

        Args:
            client_id: PyBullet client, empty.
            world: World.
            robot_urdf_path: file with the URDF of the robot.
            visual: also build what is drawn (textures, meshes); physics alone does without.
            faces: takes the large flat faces of what stands still, which PyBullet then does not draw. Nothing collides
                in such a scene, because PyBullet draws the collision shape of a body without any other.
        """
        self._client, self._visual, self._faces = client_id, visual, faces
        self._labels, self._bodies, self._items, self._textures = {}, {}, {}, {}
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
        """WorldObjects of the scene as they stand now; one that moves by itself at its start."""
        return tuple(self._items.values())

    def add_object(self, item: WorldObject) -> None:
        """Put a WorldObject into the scene.

        Raises:
            BringupError: its id is taken or its mesh cannot be loaded.
        """
        if item.id in self._labels.values():
            raise BringupError(f"object id {item.id} ({item.name}): taken; allowed: a free id")
        half_height = 0.5 * float(item.size_m[2])
        collision = self._create_collision(item) if item.solid and self._faces is None else -1
        visual, texture = self._create_visual(item, half_height) if self._visual else (-1, None)
        self._place_faces(item.id, item.position_m, item.yaw_rad)
        body = pybullet.createMultiBody(
            0.0, collision, visual, *_object_pose(item.position_m, item.yaw_rad), physicsClientId=self._client
        )
        pybullet.changeDynamics(body, -1, lateralFriction=_FRICTION, physicsClientId=self._client)
        if texture is not None and visual >= 0:
            self._paint(body, texture)
        self._labels[body], self._bodies[item.id], self._items[item.id] = item.id, body, item

    def move_object(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Put the bottom centre of an object to position_m (3,) with heading yaw_rad."""
        pybullet.resetBasePositionAndOrientation(
            self._body(label_id), *_object_pose(position_m, yaw_rad), physicsClientId=self._client
        )
        self._place_faces(label_id, position_m, yaw_rad)
        item = self._items[label_id]
        self._items[label_id] = replace(item, position_m=np.array(position_m, dtype=float), yaw_rad=float(yaw_rad))

    def place_object(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Put a moving object to where it is now; unlike move_object it does not change what `objects` says."""
        pose = _object_pose(position_m, yaw_rad)
        pybullet.resetBasePositionAndOrientation(self._body(label_id), *pose, physicsClientId=self._client)
        self._place_faces(label_id, position_m, yaw_rad)

    def remove_object(self, label_id: int) -> None:
        """Take an object out of the scene."""
        body = self._body(label_id)
        pybullet.removeBody(body, physicsClientId=self._client)
        if self._faces is not None:
            self._faces.remove(label_id)
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
        surface, floor_m = world.surfaces[index], world.surfaces[0].z_m
        lift_m = _COPLANAR_LIFT_M * index if surface.corner_z_m is None and surface.z_m == floor_m else 0.0
        if self._faces is not None:
            collision = -1
        elif index == 0:
            collision = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        else:
            collision = self._create_prism(surface, floor_m)
        visual = self._create_surface_visual(surface, floor_m) if self._visual else -1
        place = (0.0, 0.0, float(surface.z_m) + lift_m)
        self._place_faces(surface.id, place, 0.0)
        body = pybullet.createMultiBody(0.0, collision, visual, place, physicsClientId=self._client)
        pybullet.changeDynamics(body, -1, lateralFriction=_FRICTION, physicsClientId=self._client)
        if visual >= 0 and surface.texture is not None:
            self._paint(body, surface.texture)
        self._labels[body] = surface.id
        return body

    def _create_prism(self, surface: Surface, floor_m: float) -> int:
        """Convex hull from the surface down to below the floor, in axes whose origin lies at surface.z_m."""
        top = surface.corners_m - [0.0, 0.0, surface.z_m + _HULL_MARGIN_M]
        bottom = top.copy()
        bottom[:, 2] = min(floor_m - surface.z_m, 0.0) - _PATCH_DEPTH_M
        vertices = np.concatenate([bottom, top]).tolist()
        return pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=vertices, physicsClientId=self._client)

    def _create_surface_visual(self, surface: Surface, floor_m: float) -> int:
        color = _WHITE if surface.texture is not None else _floats(surface.color_rgba)
        mesh = replace(surface_mesh(surface, floor_m), texture=surface.texture)
        if self._faces is not None:
            mesh = self._faces.take(surface.id, mesh, color)
        return self._draw(mesh.divide(_LONGEST_EDGE_M), color)

    def _without_faces(
        self, item: WorldObject, mesh: DrawnMesh, color_rgba: Sequence[float], scale: Sequence[float] = (1.0, 1.0, 1.0)
    ) -> DrawnMesh:
        """What is left of an object's mesh for PyBullet to draw; all of it if the object moves by itself."""
        if self._faces is None or item.motion is not None:
            return mesh
        return self._faces.take(item.id, mesh, color_rgba, _LEAST_FACE_M2, scale)

    def _place_faces(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        if self._faces is not None:
            self._faces.place(label_id, position_m, yaw_rad)

    def _draw(self, mesh: DrawnMesh, color_rgba: Sequence[float]) -> int:
        """Visual shape of a mesh, by way of an OBJ file, because EGL crashes on meshes handed over as lists.

        -1 of a mesh without triangles.
        """
        if not len(mesh.corners):
            return -1
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{Path(folder).name}.obj"  # PyBullet remembers meshes by name
            path.write_text(mesh.obj_text(), encoding="utf-8")
            return pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(path),
                rgbaColor=color_rgba,
                specularColor=(0.0, 0.0, 0.0),
                physicsClientId=self._client,
            )

    def _paint(self, body: int, path: Path) -> None:
        if path not in self._textures:
            self._textures[path] = pybullet.loadTexture(str(path), physicsClientId=self._client)
        if self._textures[path] < 0:
            raise BringupError(f"PyBullet cannot read the texture {path}")
        pybullet.changeVisualShape(
            body, -1, textureUniqueId=self._textures[path], rgbaColor=_WHITE, physicsClientId=self._client
        )

    def _create_collision(self, item: WorldObject) -> int:
        client = {"physicsClientId": self._client}
        if item.collision == "cylinder":
            radius, _, height = _floats(item.collision_size_m * [0.5, 0.5, 1.0])
            place = (0.0, 0.0, 0.5 * height)
            shape = {"radius": radius, "height": height, "collisionFramePosition": place}
            return pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, **shape, **client)
        low_m, high_m = np.hsplit(touched_boxes_m(item), 2)
        half_m, middle_m = (0.5 * (high_m - low_m)).tolist(), (0.5 * (low_m + high_m)).tolist()
        kinds = [pybullet.GEOM_BOX] * len(half_m)
        return pybullet.createCollisionShapeArray(kinds, halfExtents=half_m, collisionFramePositions=middle_m, **client)

    def _create_visual(self, item: WorldObject, half_height: float) -> Tuple[int, Optional[Path]]:
        """Visual shape, and the texture that is still to be put on its body."""
        if item.shape == "mesh":
            return self._load_mesh(item)
        if item.shape == "box" and item.size_m.max() > _LONGEST_EDGE_M:
            color = _floats(item.color_rgba)
            mesh = self._without_faces(item, box_mesh(item.size_m), color)
            return self._draw(mesh.divide(_LONGEST_EDGE_M), color), None
        place = {
            "visualFramePosition": (0.0, 0.0, half_height),
            "rgbaColor": _floats(item.color_rgba),
            "specularColor": (0.0, 0.0, 0.0),
            "physicsClientId": self._client,
        }
        if item.shape == "cylinder":
            radius = 0.5 * float(item.size_m[0])
            shape = {"radius": radius, "length": 2.0 * half_height}
            return pybullet.createVisualShape(pybullet.GEOM_CYLINDER, **shape, **place), None
        return pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=_floats(0.5 * item.size_m), **place), None

    def _load_mesh(self, item: WorldObject) -> Tuple[int, Optional[Path]]:
        if not item.mesh.is_file():  # PyBullet would draw nothing and say so only on its own console
            raise BringupError(f"object {item.name}: no file {item.mesh}; allowed: an OBJ file")
        scale, mesh = _floats(item.mesh_scale), read_mesh(item.mesh)
        if mesh is not None:
            rest = self._without_faces(item, mesh, _WHITE, scale)
            divided = rest.divide(_LONGEST_EDGE_M, scale)
            if rest is not mesh or len(divided.corners) > len(mesh.corners):
                return self._draw(divided.scaled(scale), _WHITE), mesh.texture
        shape = {"fileName": str(item.mesh), "rgbaColor": _WHITE, "meshScale": scale}
        return pybullet.createVisualShape(pybullet.GEOM_MESH, **shape, physicsClientId=self._client), None


def _object_pose(position_m: Sequence[float], yaw_rad: float) -> Tuple[List[float], Tuple[float, ...]]:
    return _floats(position_m), (0.0, 0.0, float(np.sin(0.5 * yaw_rad)), float(np.cos(0.5 * yaw_rad)))


def _floats(values: Sequence[float]) -> List[float]:
    return [float(value) for value in values]


def write_urdf(robot: RobotConfig) -> Path:
    """Write the URDF of a RobotConfig to a temporary file and return its path; the caller deletes it."""
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", delete=False) as file:
        file.write(robot.physics_urdf_text())
    return Path(file.name)
