# SPDX-License-Identifier: BSD-3-Clause
"""One trial from its first sample to its files: joins the streams, judges the ticks, draws and writes the result."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from core_bringup.camera_mount import CameraMount
from core_bringup.evaluation.attribution import SUCCESS
from core_bringup.evaluation.frame_pictures import draw_key_frame
from core_bringup.evaluation.grid_history import GridHistory, GridSnapshot
from core_bringup.evaluation.grid_log import RunLog
from core_bringup.evaluation.key_frames import ColorImage, KeyFrameKeeper
from core_bringup.evaluation.metrics import finite_or_none, goal_distance_m
from core_bringup.evaluation.monitor_params import MonitorParams
from core_bringup.evaluation.pictures import TopDownScene, draw_topdown
from core_bringup.evaluation.preflight import find_package_folder, find_robot_file
from core_bringup.evaluation.records import FilterSample, LostRecordError, OdometrySample, TickJoiner, TruthSample
from core_bringup.evaluation.results import RESULT_KEYS, atomic_path, read_versions, write_json, write_trajectory
from core_bringup.evaluation.trial import TrialRecorder, TrialRules
from core_bringup.evaluation.trial_figures import compute_trial_figures
from core_bringup.evaluation.trial_story import TrialStory
from core_bringup.evaluation.truth_scene import TruthScene
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world, vary_world
from core_perception.ontology import Ontology
from core_perception.params import PROMPT_REASONERS
from core_perception.predicates import Predicate


class TrialSession:
    """Everything trial_monitor does, without ROS.

    Args:
        params: what the run is.

    Raises:
        ConfigError: world, task or robot are wrong.
    """

    def __init__(self, params: MonitorParams):
        """Load world, task and robot."""
        world = load_world(params.world)
        self._world, _ = vary_world(world, params.task, params.seed)
        self.task = self._world.task(params.task)
        self._robot = RobotConfig.load(find_robot_file(params.robot))
        self._ontology = Ontology.load(find_package_folder("core_perception") / "config" / "ontology.yaml")
        self._params = params
        self._joiner = TickJoiner(params.lockstep)
        self._recorder = TrialRecorder(self.task, TrialRules(awaits_model=params.reasoner not in PROMPT_REASONERS))
        self._frames = KeyFrameKeeper()
        self._grids = GridHistory()
        self._log = RunLog()
        self._predicates: List[str] = []
        self._predicates_source = ""

    @property
    def over(self) -> bool:
        """The trial has been decided."""
        return self._recorder.end is not None

    @property
    def camera_mount(self) -> CameraMount:
        """Where the camera sits on the robot."""
        return self._robot.camera_mount

    @property
    def ticks(self) -> int:
        """Number of ticks judged so far."""
        return len(self._recorder.records)

    def add_odometry(self, sample: OdometrySample) -> None:
        """Feed one robot sample."""
        self._joiner.add_odometry(sample)
        self._advance()

    def add_filter(self, sample: FilterSample) -> None:
        """Feed one filter state."""
        self._joiner.add_filter(sample)
        self._advance()

    def add_truth(self, sample: TruthSample) -> None:
        """Feed one ground truth sample."""
        self._joiner.add_truth(sample)
        self._advance()

    def add_grid(self, grid: GridSnapshot) -> None:
        """Feed one safety grid."""
        self._grids.add(grid)
        self._log.add_grid(grid)
        self._frames.add_grid(grid)

    def add_image(self, image: ColorImage) -> None:
        """Feed one colour image."""
        self._frames.add_image(image)

    def add_depth(self, stamp_ns: int, depth_m: np.ndarray) -> None:
        """Feed one depth image [m]."""
        self._frames.add_depth(stamp_ns, depth_m)

    def add_predicates(self, stamp_ns: int, predicates: Tuple[Predicate, ...], source: str) -> None:
        """Feed the predicates in force from stamp_ns on; the newest that are not empty are written into the result."""
        self._frames.add_predicates(stamp_ns, predicates)
        self._log.add_predicates(stamp_ns, predicates)
        if predicates:
            self._predicates, self._predicates_source = [str(p) for p in predicates], source

    def add_latency(self, image_stamp_ns: int, latency_s: float) -> None:
        """Feed the time from an image to the answer about it [s]."""
        self._log.add_latency(image_stamp_ns, latency_s)

    def abort(self, reason: str) -> None:
        """End the trial as an error."""
        self._recorder.abort(reason)

    def _advance(self) -> None:
        try:
            for record in self._joiner.take():
                if not self.over:
                    self._recorder.add(record)
                    self._frames.add_record(record)
        except LostRecordError as error:
            self.abort(str(error))

    def progress(self) -> Dict[str, object]:
        """The newest tick in a few figures; empty values before the first one."""
        content: Dict[str, object] = {
            "sim_time_s": round(self._recorder.elapsed_s, 3),
            "time_limit_s": self.task.time_limit_s,
        }
        if self._recorder.records:
            record = self._recorder.records[-1]
            content["goal_distance_m"] = round(goal_distance_m(record, self.task), 3)
            content["h_m"] = finite_or_none(round(record.filter.h_m, 3))
            content["mode"] = record.filter.mode
            content["rule"] = record.filter.binding_rule
            content["reason"] = record.filter.reason
        return content

    def finish(self, wall_time_s: float, write_bag: Optional[Callable[[Path], None]] = None) -> Dict[str, object]:
        """Write the files and return the content of result.json, which is written last.

        A picture or bag that cannot be written does not lose the result: the error is named in it.

        Args:
            wall_time_s: wall time from the first tick to the end [s].
            write_bag: writes trial.bag to a path; called when the parameters ask for the bag.
        """
        scene = TruthScene(self._world, self.task, self._recorder.records, self._footprint_m, self._ontology)
        result = self._result(wall_time_s, scene)
        folder, success = Path(self._params.results), bool(result["success"])
        try:
            if self._params.keeps("pictures", success):
                self._draw(folder, result, scene)
        except Exception as error:  # of OpenCV, matplotlib, the disk
            result["picture_error"] = " ".join(str(error).split())
        try:
            if write_bag is not None and self._params.keeps("bag", success):
                with atomic_path(folder / "trial.bag") as path:
                    write_bag(path)
        except Exception as error:  # of rosbag, genpy, the disk
            result["bag_error"] = " ".join(str(error).split())
        write_trajectory(folder / "trajectory.csv", self._recorder.records)
        write_json(folder / "result.json", result)
        return result

    @property
    def _footprint_m(self) -> Tuple[float, float]:
        return self._robot.footprint.length_m, self._robot.footprint.width_m

    def _result(self, wall_time_s: float, scene: TruthScene) -> Dict[str, object]:
        figures = self._recorder.figures()
        content = {name: getattr(self._params, name) for name in ("task", "method", "profile", "seed")}
        content.update(figures)
        content["rtf"] = round(figures["sim_time_s"] / wall_time_s, 4) if wall_time_s > 0 else None
        ordered = {key: content.pop(key) for key in RESULT_KEYS}
        ordered.update(content)
        ordered.update(self._judge(figures, scene))
        for name in ("reasoner", "backend", "lockstep"):
            ordered[name] = getattr(self._params, name)
        ordered["world"] = self._world.name
        for name in ("expectation", "category", "number", "split", "variant_of", "time_limit_s"):
            ordered[name] = getattr(self.task, name)
        ordered["wall_time_s"] = round(wall_time_s, 3)
        ordered["predicates"] = self._predicates
        ordered["predicates_source"] = self._predicates_source
        ordered["launch"] = self._params.launch_words()
        ordered["versions"] = read_versions()
        return ordered

    def _judge(self, figures: Dict[str, object], scene: TruthScene) -> Dict[str, object]:
        """Success, why not, and what only the true world tells."""
        story, outcome = TrialStory(scene, self._log, self._grids), str(figures["outcome"])
        cause = story.attribute(outcome, self._params.method, str(figures["entered_region"]))
        return {
            "success": outcome == SUCCESS[self.task.expectation],
            "attribution": None if cause is None else cause.kind,
            "attribution_detail": "" if cause is None else cause.detail,
            **compute_trial_figures(self._recorder.records, self.task, self._log.latencies_s),
            **story.figures(),
        }

    def _draw(self, folder: Path, result: Dict[str, object], scene: TruthScene) -> None:
        if not self._recorder.records:
            return
        last = len(self._recorder.records) - 1
        picture = TopDownScene(
            self._world,
            self.task,
            self._recorder.records,
            self._grids,
            self._footprint_m,
            str(result["outcome"]),
            _title_lines(result),
            scene.poses(last),
            scene.paths_m(),
        )
        draw_topdown(folder / "topdown.png", picture)
        for i, frame in enumerate(self._frames.close(), start=1):
            draw_key_frame(folder / f"frame_{i}.png", frame, self._robot.camera)


def _title_lines(result: Dict[str, object]) -> Sequence[str]:
    def metres(key: str) -> Optional[str]:
        return None if result[key] is None else f"{result[key]:.2f} m"

    # Without the filter the profile changes the map, not the walk.
    names = [
        name
        for name in ("task", "method", "profile", "seed", "backend")
        if name != "profile" or result["method"] != "none"
    ]
    what = " · ".join(f"{name} {result[name]}" for name in names)
    figures = [
        ("stop gap", metres("stop_gap_m")),
        ("smallest clearance", metres("min_clearance_m")),
        ("goal distance", metres("goal_distance_m")),
    ]
    parts = [f"{name} {value}" for name, value in figures if value is not None]
    parts += [
        f"interventions {result['interventions']}",
        f"false stops {result['false_stops']}",
        f"{result['sim_time_s']:.1f} s",
    ]
    return what, " · ".join(parts)
