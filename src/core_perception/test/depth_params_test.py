# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of depth_completion and self_check: a wrong one is refused in one line, a right one has its effect."""

import pytest

from core_perception.depth_params import DepthCompletionParams, SelfCheckParams
from core_perception.exceptions import ParameterError

BAD = [
    (DepthCompletionParams, {"backend": "magic"}, "backend"),
    (DepthCompletionParams, {"kind": "depth"}, "kind"),
    (DepthCompletionParams, {"lockstep": 1}, "lockstep"),
    (DepthCompletionParams, {"server_url": 3.5}, "server_url"),
    (DepthCompletionParams, {"deadline_s": 0.0}, "deadline_s"),
    (DepthCompletionParams, {"fit_min_m": 0.0}, "fit_min_m"),
    (DepthCompletionParams, {"fit_min_m": 9.0}, "fit_max_m"),
    (DepthCompletionParams, {"fit_max_m": 0.3}, "fit_max_m"),
    (DepthCompletionParams, {"min_returns": 9}, "min_returns"),
    (DepthCompletionParams, {"min_cells": 17}, "min_cells"),
    (DepthCompletionParams, {"min_inlier_ratio": 0.4}, "min_inlier_ratio"),
    (DepthCompletionParams, {"max_mad": float("nan")}, "max_mad"),
    (DepthCompletionParams, {"scale_jump": 0.0}, "scale_jump"),
    (DepthCompletionParams, {"scale_window": 2}, "scale_window"),
    (DepthCompletionParams, {"support_radius": 0.6}, "support_radius"),
    (DepthCompletionParams, {"support_ratio": 0.49}, "support_ratio"),
    (DepthCompletionParams, {"back_end": "none"}, "back_end"),
    (SelfCheckParams, {"map_frame": ""}, "map_frame"),
    (SelfCheckParams, {"frames": 2}, "frames"),
    (SelfCheckParams, {"images": 0}, "images"),
    (SelfCheckParams, {"timeout_s": "20"}, "timeout_s"),
    (SelfCheckParams, {"floor_z_m": float("inf")}, "floor_z_m"),
    (SelfCheckParams, {"floor_tilt_deg": 0.0}, "floor_tilt_deg"),
    (SelfCheckParams, {"repeat_s": -1.0}, "repeat_s"),
    (SelfCheckParams, {"exit_when_done": "yes"}, "exit_when_done"),
    (SelfCheckParams, None, "~"),
]


@pytest.mark.parametrize(("params_class", "values", "key"), BAD)
def test_a_wrong_parameter_is_refused_by_name_value_and_what_is_allowed(params_class, values, key):
    with pytest.raises(ParameterError, match="allowed") as error:
        params_class.from_dict(values)
    assert error.value.key == key
    assert "\n" not in str(error.value)


def test_every_number_reaches_the_limit_of_its_name():
    changed = {"fit_max_m": 5.0, "min_returns": 77, "gate": 0.2, "scale_jump": 0.5, "keep_scale_s": 3.0}
    changed.update({"support_radius": 0.1, "support_ratio": 0.9, "edge_step": 0.3, "max_mad": 0.2, "rounds": 1})
    limits = DepthCompletionParams.from_dict(changed).limits
    for name, value in changed.items():
        assert getattr(limits.fit if hasattr(limits.fit, name) else limits, name) == value
    limits = SelfCheckParams.from_dict(
        {"floor_z_m": 0.3, "floor_height_m": 0.2, "floor_tilt_deg": 5, "largest_shift_px": 4, "slop_s": 0.1}
    ).limits
    assert (limits.floor.floor_z_m, limits.floor.height_m, limits.floor.tilt_deg) == (0.3, 0.2, 5.0)
    assert (limits.largest_shift_px, limits.slop_s) == (4.0, 0.1)


def test_defaults_of_parameters_and_of_the_library_are_the_same():
    from core_perception.depth_completion import CompletionLimits
    from core_perception.self_check import CheckLimits

    assert DepthCompletionParams().limits == CompletionLimits()
    assert SelfCheckParams().limits == CheckLimits()
