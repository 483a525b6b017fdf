# SPDX-License-Identifier: BSD-3-Clause
"""Makes recordings (frame_recording) by walking the camera of a robot through a shipped world.

The walk is scripted, so that a scene gives the same bytes again: the heading is turned towards the next place at the
robot's own largest rate, the speed falls with the angle that is left, and the trunk sways as a trot makes it.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Iterable, Iterator, List, Optional, Sequence, Tuple

import numpy as np

import core_bringup
from core_bringup.backend import RobotState
from core_bringup.camera_noise import add_camera_noise
from core_bringup.evaluation.frame_recording import RecordingHeader, RecordingWriter, depth_to_mm
from core_bringup.evaluation.results import atomic_path
from core_bringup.exceptions import BringupError, ConfigError
from core_bringup.motion import WorldMotion
from core_bringup.params import find_robot_file
from core_bringup.pybullet_renderer import PybulletRenderer
from core_bringup.robot import RobotConfig
from core_bringup.rotations import quaternion_of_rpy
from core_bringup.world import find_worlds_dir, load_world
from core_bringup.world_types import World
from core_perception.predicates import Predicate, canonical_class_name, parse_predicate

FIRST_STAMP_S = 1.0  # the map refuses stamp 0
# Modules that a picture depends on.
DRAWING = ("backend", "camera*", "drawn_mesh", "face_painter", "flat_faces", "motion", "polygons", "pybullet_render*",
           "pybullet_scene", "robot", "rotations", "world*")  # fmt: skip
REACHED_M = 0.15
# stamp [s], T_map_camera (4, 4), p_map_base (2,) [m], depth [mm] and labels (h, w) uint16.
Frame = Tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
SWAY_RAD, SWAY_M = (0.012, 0.010), 0.006  # amplitudes of roll and pitch, and of the height


@dataclass(frozen=True)
class RecordingScene:
    """A walk through the world of a task.

    Attributes:
        world: name of a shipped world, or path of a world file.
        task: one of its tasks; start pose, objects and predicates are its.
        waypoints_m: (n, 2) places walked to in order, world frame; empty: the task's own.
        noise_seed: of the camera noise the world declares; 0: exact depth.
        timid: the predicates of a timid reasoner are added to those of the oracle.
        speed_mps: on straight lines.
    """

    world: str
    task: str
    waypoints_m: Tuple[Tuple[float, float], ...] = ()
    noise_seed: int = 1
    timid: bool = False
    speed_mps: float = 0.5

    @property
    def name(self) -> str:
        """Name for files and tables."""
        return f"{Path(self.world).stem}_{self.task}"


# A person and cones between racks, then the way back; a corridor with a sign and a corner; sidewalk, curb and lawn.
BENCH_SCENES = (
    RecordingScene("warehouse", "two_hazards", ((2.0, 0.71), (4.6, 0.71), (-3.0, 0.4)), timid=True),
    RecordingScene("hospital", "wet_floor", ((2.4, 0.6), (6.2, 0.6), (7.3, -0.3), (7.3, -4.6))),
    RecordingScene("residential", "grass_shortcut", ((4.8, 5.1), (9.3, 10.4), (9.3, 13.0))),
)


@dataclass(frozen=True)
class WalkPose:
    """base_link in the world frame at one instant."""

    time_s: float
    x_m: float
    y_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    lift_m: float


def walk(
    start_pose: Sequence[float], waypoints_m: Sequence[Sequence[float]], speed_mps: float, robot: RobotConfig
) -> Iterator[WalkPose]:
    """Yield the poses of a walk at the rate of the robot's camera, without end: at the last place it stays.

    Args:
        start_pose: (3,) x [m], y [m], yaw [rad].
        waypoints_m: (n, 2) places in order.
        speed_mps: on straight lines.
        robot: gives rate, gait cycle and largest yaw rate.
    """
    period_s, cycle_s = 1.0 / robot.camera.rate_hz, robot.quadruped.gait.cycle_s
    (x, y, yaw), places, k = map(float, start_pose), [tuple(place) for place in waypoints_m], 0
    while True:
        time_s = k * period_s
        # A trot rolls once and nods twice a cycle; the third factor keeps the sampling from freezing the phase.
        phase = 2.0 * math.pi * 1.07 * time_s / cycle_s
        roll, pitch = SWAY_RAD[0] * math.sin(phase), SWAY_RAD[1] * math.sin(2.0 * phase + 0.7)
        yield WalkPose(time_s, x, y, roll, pitch, yaw, SWAY_M * math.cos(2.0 * phase))
        while places and math.hypot(places[0][0] - x, places[0][1] - y) < REACHED_M:
            places.pop(0)
        if places:
            error = math.remainder(math.atan2(places[0][1] - y, places[0][0] - x) - yaw, 2.0 * math.pi)
            most_rad = robot.limits.yaw_radps * period_s
            yaw += min(max(error, -most_rad), most_rad)
            step_m = speed_mps * period_s * max(math.cos(error), 0.0) ** 2
            x, y = x + step_m * math.cos(yaw), y + step_m * math.sin(yaw)
        k += 1


def record(scene: RecordingScene, n_frames: int, path: Path, predicates: Optional[Sequence[Predicate]] = None) -> None:
    """Render a scene into a file; it takes its name when it is complete.

    Args:
        scene: RecordingScene.
        n_frames: >= 1, at the rate of the robot's camera.
        path: file to write.
        predicates: in place of the task's.

    Raises:
        ConfigError: no such world or task, or n_frames < 1.
        BringupError: the renderer failed.
    """
    if n_frames < 1:
        raise ConfigError(scene.name, "frames", f"got {n_frames}", ">= 1")
    robot = RobotConfig.load(find_robot_file())
    world = load_world(scene.world).for_task(scene.task)
    task = world.task(scene.task)
    header = make_header(scene, world, robot, predicates)
    poses = walk(task.start_pose, scene.waypoints_m or task.waypoints_m, scene.speed_mps, robot)
    with atomic_path(Path(path)) as temporary, RecordingWriter(temporary, header, n_frames) as writer:
        for frame in render_frames(world, robot, scene.noise_seed, itertools.islice(poses, n_frames)):
            writer.add(*frame)


def make_header(
    scene: RecordingScene, world: World, robot: RobotConfig, predicates: Optional[Sequence[Predicate]] = None
) -> RecordingHeader:
    """Header of a recording of a scene; predicates in place of the task's."""
    task = world.task(scene.task)
    if predicates is None:
        texts = task.oracle_predicates + (task.over_cautious if scene.timid else ())
        predicates = [parse_predicate(text) for text in texts]
    classes = {label: canonical_class_name(name) for label, name in world.class_of_label().items()}
    return RecordingHeader(robot.camera.model, classes, tuple(predicates))


def render_frames(world: World, robot: RobotConfig, noise_seed: int, poses: Iterable[WalkPose]) -> Iterator[Frame]:
    """Yield a frame for every pose, in the order of the arguments of RecordingWriter.add.

    Args:
        world: of one task.
        robot: its camera and how it is mounted.
        noise_seed: of the camera noise the world declares; 0: exact depth.
        poses: of base_link.

    Raises:
        BringupError: the renderer failed.
    """
    noise, motion = replace(world.camera_noise, seed=noise_seed), WorldMotion(world.objects)
    R_base_optical, p_base_optical = robot.camera_mount.compute_optical_pose()
    renderer = PybulletRenderer(world, robot)
    try:
        for pose in poses:
            state = _state(world, robot, pose, motion)
            frame = renderer.render(state)
            stamp_s = FIRST_STAMP_S + pose.time_s
            _, depth_m = add_camera_noise(frame.color, frame.depth_m, noise, round(1e9 * stamp_s))
            T_map_camera = np.eye(4)
            R_map_base = _rotation(state.q_world_base)
            T_map_camera[:3, :3] = R_map_base @ R_base_optical
            T_map_camera[:3, 3] = state.p_world_base + R_map_base @ p_base_optical
            yield stamp_s, T_map_camera, state.p_world_base[:2], depth_to_mm(depth_m), frame.labels
    finally:
        renderer.close()


def _state(world: World, robot: RobotConfig, pose: WalkPose, motion: WorldMotion) -> RobotState:
    z_m = world.surface_height_m(pose.x_m, pose.y_m) + robot.quadruped.gait.body_height_m + pose.lift_m
    return RobotState(
        pose.time_s,
        np.array([pose.x_m, pose.y_m, z_m]),
        np.array(quaternion_of_rpy(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)),
        np.zeros(3),
        np.zeros(3),
        object_poses=motion.advance(pose.time_s, (pose.x_m, pose.y_m)),
    )


def _rotation(q_xyzw: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of a unit quaternion."""
    (x, y, z), w = q_xyzw[:3], q_xyzw[3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def find_recording(scene: RecordingScene, n_frames: int, folder: Path) -> Path:
    """File of a scene in a folder, rendered now if it is not there: its name carries a hash of all it is made from."""
    digest = hashlib.sha256(f"{scene}{n_frames}".encode())
    for path in _source_files():
        digest.update(f"{path.name}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    path = Path(folder) / f"{scene.name}_{n_frames}_{digest.hexdigest()[:12]}.frames"
    if not path.is_file():
        for outdated in Path(folder).glob(f"{scene.name}_{n_frames}_*.frames"):
            outdated.unlink()
        record(scene, n_frames, path)
    return path


def _source_files() -> List[Path]:
    """Worlds, models, the robot, and the modules that draw."""
    # In devel space the first entry of __path__ is a relay that names the checkout's place.
    modules = Path(core_bringup.__path__[-1])
    worlds = [path for path in find_worlds_dir().rglob("*") if path.suffix in (".yaml", ".obj", ".mtl", ".png")]
    own = [modules / "evaluation" / name for name in ("frame_recorder.py", "frame_recording.py")]
    drawing = [path for pattern in DRAWING for path in modules.glob(f"{pattern}.py")]
    return sorted([*worlds, find_robot_file(), *drawing, *own])


def main() -> int:
    """Record one scene: the world and the task by name, into a file."""
    parser = argparse.ArgumentParser(prog="frame_recorder", description=main.__doc__)
    parser.add_argument("world")
    parser.add_argument("task")
    parser.add_argument("file", type=Path)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--noise-seed", type=int, default=1, help="0: exact depth")
    options = parser.parse_args()
    try:
        record(RecordingScene(options.world, options.task, (), options.noise_seed), options.frames, options.file)
    except BringupError as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
