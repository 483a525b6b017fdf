# SPDX-License-Identifier: BSD-3-Clause
"""Simulated worlds, a walking quadruped, and the evaluation of CORE in them."""
