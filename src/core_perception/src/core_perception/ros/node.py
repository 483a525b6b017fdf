# SPDX-License-Identifier: BSD-3-Clause
"""What every Python node of the package does at its start."""

from __future__ import annotations

import sys
from pathlib import Path

import rospkg
import rospy

from core_perception.exceptions import PerceptionError

BAD_INPUT_EXIT_STATUS = 2


def config_dir() -> Path:
    """Folder of the configuration files that the package ships, in source, devel and install space alike."""
    return Path(rospkg.RosPack().get_path("core_perception")) / "config"


def run_node(name: str, params_class, node_class) -> int:
    """Start a node, spin, and return the exit status.

    The node gets its checked parameters before it publishes anything. A parameter or file that is wrong gives one line
    on stderr and status 2.
    """
    rospy.init_node(name)
    try:
        node = node_class(params_class.from_dict(rospy.get_param("~", {})))
    except PerceptionError as error:
        # One write: print() would write the end of the line apart, and other nodes' lines come in between.
        sys.stderr.write(f"{rospy.get_name().lstrip('/')}: {error}\n")
        return BAD_INPUT_EXIT_STATUS
    rospy.spin()
    del node
    return 0
