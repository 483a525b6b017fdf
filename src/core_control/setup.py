# SPDX-License-Identifier: BSD-3-Clause
"""Python packages of core_control, for catkin_python_setup."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=["core_control", "core_control.barriers", "core_control.ros"],
        package_dir={"": "src"},
    )
)
