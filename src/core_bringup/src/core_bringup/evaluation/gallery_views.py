# SPDX-License-Identifier: BSD-3-Clause
"""The pictures of the gallery: models before the robot's camera, worlds from the starts of their tasks, and above."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Iterator, List, Optional, Sequence, Tuple, TypeVar

import numpy as np
import yaml

from core_bringup.backend import RobotState
from core_bringup.camera import CameraModel
from core_bringup.camera_mount import CameraMount
from core_bringup.evaluation.contact_sheet import GAP_PX, LABEL_PX, inset_picture, label_picture
from core_bringup.pybullet_renderer import PybulletRenderer
from core_bringup.robot import RobotConfig
from core_bringup.rotations import quaternion_of_rpy
from core_bringup.task_types import Task
from core_bringup.world import find_worlds_dir, load_world
from core_bringup.world_models import CATALOGUE
from core_bringup.world_schema import check_catalogue
from core_bringup.world_types import World, WorldObject
from core_bringup.yaml_source import YamlSource

_Self = TypeVar("_Self", bound="_Painter")
_NEAR_M, _FAR_M = 3.0, 5.0  # from the camera to the nearest point of a small and of a large model
_LOW_M, _HIGH_M = 0.8, 1.6  # heights of a small and of a large model
_TURN_RAD = np.pi - 0.7  # the front (+x) and the left side (+y) are seen
_INSET_RAD, _INSET_SHARE = (_TURN_RAD - 0.7, 0.45), 0.36  # azimuth and slope of the small picture: front and right side
_BIRD_RAD = (-0.5 * np.pi, 0.95)  # from the south, so that x runs to the right
_FREE_NOSE_M, _FREE_FAR_M = 0.5, 300.0
_STAGE = {
    "schema": "core_world/1",
    "name": "gallery",
    "lighting": {"direction": [-0.6, 0.5, 1.0], "ambient": 0.62, "diffuse": 0.45},
    "surfaces": [
        {
            "id": 1,
            "name": "floor",
            "class": "floor",
            "color_rgba": [0.62, 0.62, 0.60, 1.0],
            "polygon_m": [[-400, -400], [400, -400], [400, 400], [-400, 400]],
        }
    ],
    "tasks": {
        "look": {
            "description": "Look at a model.",
            "expectation": "safe",
            "category": "traversal",
            "start_pose": [0, 0, 0],
            "waypoints_m": [[1, 0]],
            "goal_m": [1, 0],
            "time_limit_s": 10,
        }
    },
}


def catalogue_names() -> List[str]:
    """Names of the shipped models; ConfigError if their file is wrong."""
    source = YamlSource(find_worlds_dir() / CATALOGUE)
    check_catalogue(source)
    return list(source.data)


def draw_models(names: Sequence[str], robot: RobotConfig) -> Iterator[Tuple[str, np.ndarray]]:
    """Yield each model's name and labelled picture, as large as the robot's camera makes it.

    The large picture is what the robot sees with the model's nearest point 3 m (small) to 5 m (large) ahead; the small
    one shows the whole model from its other side.
    """
    stage = _build_stage(names)
    items = {item.name: item for item in stage.objects}
    stage = replace(stage, objects=())
    with _Painter(stage, robot) as front, _Painter(stage, *free_camera(robot, robot.camera.model)) as round_view:
        for name in names:
            item = _place_ahead(items[name], robot)
            front.renderer.add_object(item)
            round_view.renderer.add_object(item)
            picture = front.draw(standing_state(robot, (0.0, 0.0, 0.0), 0.0))
            centre = item.position_m + [0.0, 0.0, 0.5 * item.size_m[2]]
            corners = centre + 0.5 * np.linalg.norm(item.size_m) * np.vstack([np.eye(3), -np.eye(3)])
            small = round_view.draw(look_state(corners, _INSET_RAD, robot.camera.model))
            front.renderer.remove_object(item.id)
            round_view.renderer.remove_object(item.id)
            yield name, label_picture(inset_picture(picture, small, _INSET_SHARE), name, _model_text(item))


def draw_tasks(world: World, robot: RobotConfig) -> Iterator[Tuple[str, np.ndarray]]:
    """Yield each task's name and the labelled picture that the robot sees at its start, with the task's own objects."""
    with TaskStage(world, robot) as stage:
        for name, task in world.tasks.items():
            stage.show(name)
            picture = stage.draw(standing_state(robot, stage.ground(task.start_pose[:2]), task.start_pose[2]))
            yield name, label_picture(picture, f"{world.name}: {name}", _task_text(task))


def draw_bird_view(world: World, robot: RobotConfig) -> np.ndarray:
    """Draw the whole floor from above, labelled, as large as two by two pictures of the robot's camera with labels."""
    camera = robot.camera.model
    width_px, height_px = 2 * camera.width_px + GAP_PX, 2 * camera.height_px + LABEL_PX + GAP_PX
    bird = CameraModel(width_px, height_px, 1.2 * width_px, 1.2 * width_px, 0.5 * width_px, 0.5 * height_px)
    free_robot, bird = free_camera(robot, bird)
    with _Painter(world, free_robot, bird) as painter:
        picture = painter.draw(look_state(world.surfaces[0].corners_m, _BIRD_RAD, bird))
    text = f"{len(world.objects)} objects, {len(world.surfaces)} surfaces, {len(world.tasks)} tasks"
    return label_picture(picture, f"{world.name}, x to the right", text)


def standing_state(robot: RobotConfig, place_m: Sequence[float], yaw_rad: float) -> RobotState:
    """State of a robot that stands on a place (3,) of the ground."""
    p_world_base = np.asarray(place_m, dtype=float) + [0.0, 0.0, robot.quadruped.gait.body_height_m]
    q_world_base = np.array(quaternion_of_rpy(0.0, 0.0, float(yaw_rad)))
    return RobotState(0.0, p_world_base, q_world_base, np.zeros(3), np.zeros(3))


def free_camera(robot: RobotConfig, camera: CameraModel) -> Tuple[RobotConfig, CameraModel]:
    """A robot that looks straight ahead from its nose, unseen by itself, and a camera that sees far: for look_state."""
    mount = CameraMount(_FREE_NOSE_M, 0.0, 0.0, 0.0, 0.0, 0.0)
    return replace(robot, camera=replace(robot.camera, mount=mount)), replace(camera, far_m=_FREE_FAR_M)


def look_state(points_m: np.ndarray, from_rad: Sequence[float], camera: CameraModel) -> RobotState:
    """State in which a free camera has all points in view, as near as may be.

    Args:
        points_m: (n, 3) world frame.
        from_rad: azimuth and slope of the camera, seen from the middle of the points.
        camera: CameraModel.
    """
    azimuth_rad, slope_rad = from_rad
    yaw_rad = azimuth_rad + np.pi
    forward = np.array([np.cos(slope_rad) * np.cos(yaw_rad), np.cos(slope_rad) * np.sin(yaw_rad), -np.sin(slope_rad)])
    left = np.array([-np.sin(yaw_rad), np.cos(yaw_rad), 0.0])
    axes = np.stack([forward, left, np.cross(forward, left)], axis=1)
    middle = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
    ahead, aside, above = ((points_m - middle) @ axes).T
    # In view: |aside| <= (d + ahead) w / 2 fx and |above| <= (d + ahead) h / 2 fy.
    least = np.maximum(
        2.0 * camera.fx_px * np.abs(aside) / camera.width_px, 2.0 * camera.fy_px * np.abs(above) / camera.height_px
    )
    eye = middle - (float((least - ahead).max()) + 0.1) * forward
    q_world_base = np.array(quaternion_of_rpy(0.0, float(slope_rad), float(yaw_rad)))
    return RobotState(0.0, eye - _FREE_NOSE_M * forward, q_world_base, np.zeros(3), np.zeros(3))


def count_triangles(item: WorldObject) -> int:
    """Triangles of an object's mesh; 0 for a box or cylinder."""
    if item.mesh is None:
        return 0
    faces = [line.split() for line in item.mesh.read_text(encoding="utf-8").splitlines() if line.startswith("f ")]
    return sum(len(face) - 3 for face in faces)


def _build_stage(names: Sequence[str]) -> World:
    """A world with one object per model, so that the gallery reads models as every world does."""
    places = [
        {"id": 2 + k, "name": name, "model": name, "position_m": [20.0 + k, 0.0, 0.0]} for k, name in enumerate(names)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gallery.yaml"
        path.write_text(yaml.safe_dump({**_STAGE, "objects": places}), encoding="utf-8")
        return load_world(path)


def _place_ahead(item: WorldObject, robot: RobotConfig) -> WorldObject:
    length_m, width_m, height_m = item.size_m
    share = np.clip((max(height_m, 0.4 * length_m, 0.4 * width_m) - _LOW_M) / (_HIGH_M - _LOW_M), 0.0, 1.0)
    depth_m = abs(np.cos(_TURN_RAD)) * length_m + abs(np.sin(_TURN_RAD)) * width_m
    x_m = robot.camera_mount.x_m + _NEAR_M + share * (_FAR_M - _NEAR_M) + 0.5 * depth_m
    return replace(item, position_m=np.array([x_m, 0.0, 0.0]), yaw_rad=_TURN_RAD)


def _model_text(item: WorldObject) -> str:
    size = " x ".join(f"{size_m:.2f}" for size_m in item.size_m)
    return f"{item.class_name}, {size} m, {count_triangles(item)} triangles"


def _task_text(task: Task) -> str:
    parts = ["" if task.number is None else f"task {task.number}", task.expectation, task.category]
    parts.append("" if task.split == "main" else f"{task.split} variant of {task.variant_of}")
    return ", ".join(part for part in parts if part)


class _Painter:
    """A renderer that is closed at the end of a with block."""

    def __init__(self, world: World, robot: RobotConfig, camera: Optional[CameraModel] = None):
        self.renderer = PybulletRenderer(world, robot, camera)

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.renderer.close()

    def draw(self, state: RobotState) -> np.ndarray:
        """Colour image (h, w, 3) at a state."""
        return self.renderer.render(state).color


class TaskStage(_Painter):
    """One renderer for all tasks of a world; use it in a with block, and show a task before drawing.

    Args:
        world: World as loaded.
        robot: RobotConfig.
    """

    def __init__(self, world: World, robot: RobotConfig):
        """Start the renderer with the objects of no task."""
        super().__init__(world, robot)
        self._world = self._shown = world

    def show(self, task_name: str) -> None:
        """Put the objects of a task into the drawn world and take those of the last one out."""
        meant = self._world.for_task(task_name)
        there, wanted = ({item.id: item for item in world.objects} for world in (self._shown, meant))
        for label_id in there:
            if label_id not in wanted or wanted[label_id] is not there[label_id]:
                self.renderer.remove_object(label_id)
        for label_id, item in wanted.items():
            if label_id not in there or item is not there[label_id]:
                self.renderer.add_object(item)
        self._shown = meant

    def ground(self, place_m: Sequence[float]) -> Tuple[float, float, float]:
        """Point (3,) of the ground at a place (2,)."""
        x_m, y_m = (float(value) for value in place_m)
        return x_m, y_m, self._world.surface_height_m(x_m, y_m)
