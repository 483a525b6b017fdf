# SPDX-License-Identifier: BSD-3-Clause
from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=[
            "core_perception",
            "core_perception.checks",
            "core_perception.reasoners",
            "core_perception.ros",
            "core_perception.segmenters",
        ],
        package_dir={"": "src"},
    )
)
