# SPDX-License-Identifier: BSD-3-Clause
"""The layers, checked: library modules live without ROS, and the arrows between packages point one way."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("core_bringup", "core_control", "core_perception")
MAY_IMPORT = {"core_bringup": {"core_control", "core_perception"}, "core_control": set(), "core_perception": set()}
PYBULLET_FILES = {"pybullet_backend.py", "pybullet_render_worker.py", "pybullet_renderer.py", "pybullet_scene.py"}
ROS_MODULES = (
    "rospy",
    "rosgraph",
    "roslib",
    "tf2_ros",
    "tf",
    "cv_bridge",
    "std_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "nav_msgs",
    "core_msgs",
    "octomap_msgs",
    "std_srvs",
    "genpy",
    "diagnostic_msgs",
    "visualization_msgs",
)


def modules(package):
    root = ROOT / "src" / package / "src"
    return [path for path in sorted((root / package).rglob("*.py")) if path.name != "__init__.py"]


def library_modules(package):
    return [
        path
        for path in modules(package)
        if "ros" not in path.relative_to(ROOT / "src" / package / "src" / package).parts[:-1]
    ]


def imported_roots(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def import_behind_the_wall(names):
    """Import modules in a Python of their own, in which no ROS and no PyBullet can be imported."""
    blocked = ROS_MODULES + ("pybullet",)
    program = (
        "import sys, importlib\n"
        "class Wall:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in %r: raise ImportError('blocked: ' + name)\n"
        "sys.meta_path.insert(0, Wall())\n"
        "sys.path[:0] = %r\n"
        "for name in %r: importlib.import_module(name)\n"
        % (blocked, [str(ROOT / "src" / other / "src") for other in PACKAGES], names)
    )
    return subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, check=False, text=True)


@pytest.mark.parametrize("package", PACKAGES)
def test_library_imports_without_ros_and_pybullet(package):
    names = [
        ".".join(path.relative_to(ROOT / "src" / package / "src").with_suffix("").parts)
        for path in library_modules(package)
        if path.name not in PYBULLET_FILES
    ]
    assert len(names) >= 15
    result = import_behind_the_wall(names)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("module", ["core_control.ros.conversions", "core_bringup.pybullet_backend"])
def test_the_wall_would_notice_ros_and_pybullet(module):
    assert "blocked: " in import_behind_the_wall([module]).stderr


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_between_packages_point_one_way(package):
    others = set(PACKAGES) - {package}
    wrong = {
        str(path): root
        for path in modules(package)
        for root in imported_roots(path)
        if root in others - MAY_IMPORT[package]
    }
    assert not wrong


def test_only_the_pybullet_files_import_pybullet():
    importers = {
        path.name for package in PACKAGES for path in modules(package) if "pybullet" in set(imported_roots(path))
    }
    assert importers
    assert importers <= PYBULLET_FILES


def test_library_sources_of_the_map_include_no_ros():
    package = ROOT / "src" / "core_perception"
    sources = [*(package / "include" / "core_perception").glob("*.h"), *(package / "src").glob("*.cpp")]
    assert sources
    ros_include = re.compile(r"#include\s*[<\"](ros/|tf2|\w*_msgs/|core_perception/ros/)")
    assert not [path.name for path in sources if ros_include.search(path.read_text())]


def test_ground_truth_is_named_in_one_module_that_the_segmenter_node_alone_imports():
    readers = {
        path.name
        for package in ("core_perception", "core_control")
        for path in modules(package)
        if "ground_truth" in path.read_text()
    }
    assert readers == {"truth_topics.py"}
    importers = {path.name for path in modules("core_perception") if "truth_topics" in path.read_text()}
    assert importers == {"segmenter_node.py"}
