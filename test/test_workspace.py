# SPDX-License-Identifier: BSD-3-Clause
"""What is shipped loads: launch files, message definitions, the help of core.sh."""

import os
import subprocess
from pathlib import Path

import pytest
import roslaunch.config
import roslaunch.xmlloader
from octomap_msgs.msg import Octomap, OctomapWithPose
from octomap_msgs.srv import BoundingBoxQuery, GetOctomap

ROOT = Path(__file__).resolve().parent.parent
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch"))


def run_core(*arguments, **environment):
    return subprocess.run(
        ["bash", str(ROOT / "core.sh"), *arguments],
        capture_output=True,
        text=True,
        env=dict(os.environ, **environment),
        check=False,
    )


# Sums of the released octomap_msgs (0.3): bags and nodes built against it understand ours.
@pytest.mark.parametrize(
    ("definition", "md5"),
    [
        (Octomap, "9a45536b45c5e409cd49f04bb2d9999f"),
        (OctomapWithPose, "20b380aca6a508a657e95526cddaf618"),
        (GetOctomap, "be9d2869d24fe40d6bc21ac21f6bb2c5"),
        (BoundingBoxQuery, "93aa3d73b866f04880927745f4aab303"),
    ],
)
def test_octomap_definitions_match_the_released_package(definition, md5):
    assert definition._md5sum == md5


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_loads(path):
    config = roslaunch.config.ROSLaunchConfig()
    roslaunch.xmlloader.XmlLoader().load(str(path), config, verbose=False)
    assert config.nodes


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_every_launch_argument_is_documented(path):
    arguments = [line for line in path.read_text().splitlines() if "<arg " in line and "default=" in line]
    assert all('doc="' in line for line in arguments)


def test_core_sh_prints_its_help_without_arguments():
    result = run_core()
    assert result.returncode == 0
    assert "./core.sh demo" in result.stdout


def test_core_sh_refuses_an_unknown_command_with_code_2():
    result = run_core("dance")
    assert result.returncode == 2
    assert "unknown command 'dance'" in result.stderr
