# SPDX-License-Identifier: BSD-3-Clause
"""The library knows nothing of ROS: checked by making rospy and every message package unimportable."""

import pkgutil
import subprocess
import sys
from pathlib import Path

import core_control

BLOCKED = ("rospy", "genpy", "tf2_ros", "core_msgs", "geometry_msgs", "nav_msgs", "std_msgs", "std_srvs")
PROBE = """
import importlib, sys
class Wall:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {blocked!r}:
            raise ImportError(name + " is not for the library")
sys.meta_path.insert(0, Wall())
sys.path.insert(0, {source!r})
for name in {modules!r}:
    importlib.import_module(name)
"""


def find_modules():
    found = pkgutil.walk_packages(core_control.__path__, "core_control.")
    return [module.name for module in found]


def run_probe(modules):
    source = str(Path(core_control.__file__).resolve().parents[1])
    code = PROBE.format(blocked=BLOCKED, source=source, modules=modules)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_library_modules_import_without_ros():
    library = [name for name in find_modules() if not name.startswith("core_control.ros")]
    assert len(library) >= 15
    result = run_probe(library)
    assert result.returncode == 0, result.stderr


def test_the_probe_would_notice_ros():
    assert run_probe(["core_control.ros.conversions"]).returncode != 0
