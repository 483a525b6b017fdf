# SPDX-License-Identifier: BSD-3-Clause
"""Reasoners: evidence of one frame -> safety constraints."""
