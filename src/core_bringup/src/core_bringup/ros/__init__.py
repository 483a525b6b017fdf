# SPDX-License-Identifier: BSD-3-Clause
"""Nodes of this package: convert, call, publish."""
