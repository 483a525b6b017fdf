# SPDX-License-Identifier: BSD-3-Clause
"""ROS shell of the Python nodes; nothing outside this folder imports ROS."""
