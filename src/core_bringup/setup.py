# SPDX-License-Identifier: BSD-3-Clause
from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=["core_bringup", "core_bringup.evaluation", "core_bringup.quadruped", "core_bringup.ros"],
        package_dir={"": "src"},
    )
)
