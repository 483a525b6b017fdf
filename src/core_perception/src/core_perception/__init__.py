# SPDX-License-Identifier: BSD-3-Clause
"""Perception of CORE in Python: predicates, ontology, arrangements, reasoners, segmenters, overlay; ROS in ``ros``."""
