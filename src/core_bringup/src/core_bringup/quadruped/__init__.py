# SPDX-License-Identifier: BSD-3-Clause
"""A force-controlled quadruped in plain numpy: its body, its gait and its controller."""
