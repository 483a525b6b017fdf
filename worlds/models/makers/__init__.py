# SPDX-License-Identifier: BSD-3-Clause
"""Makers of the models and textures of the worlds, and the tools they share."""
