# SPDX-License-Identifier: BSD-3-Clause
"""Statistics of bench grounding, what it tells the measuring program, and the plain numpy pipeline it compares with."""

import cv2
import numpy as np
import pytest

from core_bringup.camera import CameraModel
from core_bringup.evaluation.frame_recording import RecordingHeader
from core_bringup.evaluation.grounding_figures import Measurement, build_programs, compare, format_params, summarise
from core_bringup.evaluation.plain_grounding import PlainGrounding, draw_safe_mask
from core_bringup.exceptions import BringupError
from core_perception.predicates import parse_predicate

OUTPUT = """value observations 7
series whole_cpu_ms 0 1.0 2.0 3.0 4.0
series whole_cpu_ms 1 9.0 2.0 3.0 4.0
series whole_cpu_ms 2 1.5 2.0 3.0 8.0
series stage_points_cpu_ms 0 0.1 9.0 0.3 9.0
series stage_voxels_cpu_ms 0 0.1 9.0 0.1 9.0
series insert_point_cloud_cpu_ms 0 12.0 18.0
series insert_discretized_cpu_ms 0 3.0 3.0
series opencv_cpu_ms 0 20.0 20.0 20.0 20.0
"""


def measured(*outputs):
    measurement = Measurement()
    for output in outputs:
        measurement.add(output)
    return measurement


def test_a_frame_counts_with_the_median_of_its_passes():
    assert measured(OUTPUT).per_frame("whole_cpu_ms").tolist() == [1.5, 2.0, 3.0, 4.0]


def test_recordings_follow_each_other_and_their_values_add_up():
    both = measured(OUTPUT, OUTPUT)
    assert both.per_frame("whole_cpu_ms", 3).tolist() == [1.5, 4.0, 1.5, 4.0]
    assert both.values == {"observations": 14}


def test_others_are_compared_on_the_same_frames():
    figures = compare(measured(OUTPUT), np.array([30.0, 33.0]), insert_every=2, numpy_every=3)
    assert figures == {
        "opencv_ms": 20.0,
        "numpy_ms": 31.5,
        "insert_point_cloud_ms": 15.0,
        "insert_discretized_ms": 3.0,
        "map_vs_insert_point_cloud": 50.0,  # 15 over the mean of 0.2 and 0.4
        "map_vs_insert_discretized": 10.0,
        "whole_vs_opencv": 7.6,  # 20 over 2.625
        "whole_vs_numpy": 11.5,  # 31.5 over the mean of 1.5 and 4
    }


@pytest.mark.parametrize("line", ["times whole 0 1.0", "series whole_cpu_ms 0 1.0 2.0\nseries whole_cpu_ms 1 1.0"])
def test_output_that_is_not_understood_is_refused(line):
    with pytest.raises(ValueError, match="measuring program"):
        measured(line)


def test_percentiles_are_frames_that_were_measured():
    assert summarise(np.arange(200, 0, -1.0)) == {"mean_ms": 100.5, "p95_ms": 190.0, "p99_ms": 198.0, "max_ms": 200.0}
    assert summarise(np.array([3.0])) == {"mean_ms": 3.0, "p95_ms": 3.0, "p99_ms": 3.0, "max_ms": 3.0}


def test_parameters_are_written_a_line_each():
    values = {"a": True, "b": 3, "c": 0.1, "d": "x", "e": "", "f": ["u", "v"], "g": {"person": 1.2}, "h": {}}
    assert format_params(values).splitlines() == [
        "a bool 1", "b int 3", "c double 0.1", "d string x", "e string", "f list u v", "g map person 1.2", "h map",
    ]  # fmt: skip


@pytest.mark.parametrize("value", ["two words", ["a b"], [""], None, "line\nbreak"])
def test_a_value_that_the_text_cannot_hold_is_refused(value):
    with pytest.raises(ValueError, match="key: got"):
        format_params({"key": value})


def test_a_build_that_fails_says_why(tmp_path):
    (tmp_path / "CMakeLists.txt").write_text('message(FATAL_ERROR "no compiler of mine")\n')
    with pytest.raises(BringupError, match="no compiler of mine"):
        build_programs(tmp_path, tmp_path / "build", "native")


CAMERA = CameraModel(60, 40, 30.0, 30.0, 30.0, 20.0)
CLASSES = {1: "floor", 2: "cone", 3: "cone", 4: "box"}
KERNEL = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


def test_masks_follow_the_operators():
    labels = np.ones((40, 60), np.uint16)
    labels[10, 10], labels[10, 30], labels[30, 50] = 2, 3, 4
    statements = map(parse_predicate, ("ON(floor)=safe", "BETWEEN(cone)=unsafe", "AROUND(box)=unsafe"))
    safe = draw_safe_mask(labels, CLASSES, tuple(statements), KERNEL)
    due = np.full((40, 60), 255, np.uint8)
    due[10, 10:31] = 0
    due[28:33, 48:53][KERNEL > 0] = 0
    np.testing.assert_array_equal(safe, due)


def test_the_plain_pipeline_finds_a_wall_ahead():
    params = {
        "resolution_m": 0.2, "window_m": 8.0, "kernel_px": 5, "tau": 0.5, "unknown_is_unsafe": False,
        "range_min_m": 0.3, "range_max_m": 7.0,
    }  # fmt: skip
    header = RecordingHeader(CAMERA, {1: "wall"}, (parse_predicate("NEAR(wall)=unsafe"),))
    frame = np.zeros((), header.frame_type)
    frame["depth_mm"], frame["labels"] = 2100, 1
    frame["T_map_camera"] = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]]
    h_m = PlainGrounding(header, params).update(frame)
    # Window of 40 cells, the robot in cell 20: the wall stands in column 30, so x = 0.1 is 2.0 m away.
    assert h_m[20, 20] == pytest.approx(2.0, abs=1e-5)
    assert h_m[20, 30] < 0.0
