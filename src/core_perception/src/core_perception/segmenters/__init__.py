# SPDX-License-Identifier: BSD-3-Clause
"""Segmenters: an image and class names -> instance masks."""
