# SPDX-License-Identifier: BSD-3-Clause
from setuptools import setup

from catkin_pkg.python_setup import generate_distutils_setup

setup(**generate_distutils_setup(
    packages=["core_bringup", "core_bringup.evaluation", "core_bringup.quadruped", "core_bringup.ros"],
    package_dir={"": "src"},
))
