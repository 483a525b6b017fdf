# SPDX-License-Identifier: BSD-3-Clause
"""Contextual safety enforcement: a control-barrier-function velocity filter on the safety grid. No ROS outside ros/."""
