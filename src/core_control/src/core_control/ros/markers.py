# SPDX-License-Identifier: BSD-3-Clause
"""Markers of the filter's state: footprint, binding point, gradient, wanted and sent velocity."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np
from core_msgs.msg import FilterState
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from core_control.dynamics import compute_rotation, place_discs
from core_control.params import MarkerParams

MODE_COLORS = {
    FilterState.NOMINAL: (0.1, 0.8, 0.2),
    FilterState.FILTERED: (1.0, 0.6, 0.0),
    FilterState.HOLD: (0.9, 0.1, 0.1),
    FilterState.STOPPED: (0.5, 0.0, 0.5),
    FilterState.DISABLED: (0.5, 0.5, 0.5),
    FilterState.ESCAPE: (0.9, 0.5, 0.1),
    FilterState.OVERRIDE: (0.1, 0.7, 0.9),
}
CIRCLE_POINTS = 24
LINE_M = 0.03


def make_markers(state: FilterState, pose: np.ndarray, params: MarkerParams) -> MarkerArray:
    """Every marker of one state, always the same ids, so that each replaces its predecessor.

    Args:
        state: newest state.
        pose: (3,) x [m], y [m], yaw [rad] of base_link in the frame of the state.
        params: scale of the arrows, height and footprint.
    """
    color = MODE_COLORS[state.mode]
    arrows = [
        _make_velocity(state, 1, "u_nominal", _arrow(state.u_nominal, pose, params), (0.2, 0.4, 1.0)),
        _make_velocity(state, 2, "u_safe", _arrow(state.u_safe, pose, params), color),
        _make_velocity(state, 3, "gradient", (pose[:2], pose[:2] + 0.5 * np.array(state.gradient)), (0.0, 0.8, 0.8)),
    ]
    markers = [_make_footprint(state, pose, params, color), *arrows, _make_binding(state), _make_text(state, pose)]
    for marker in markers:
        marker.pose.position.z += params.height_m
    return MarkerArray(markers)


def _make(state: FilterState, number: int, name: str, kind: int, color: Tuple[float, float, float]) -> Marker:
    marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD, color=ColorRGBA(*color, 1.0))
    marker.header = state.header
    marker.pose.orientation.w = 1.0
    return marker


def _make_footprint(state: FilterState, pose: np.ndarray, params: MarkerParams, color) -> Marker:
    marker = _make(state, 0, "footprint", Marker.LINE_LIST, color)
    marker.scale.x = LINE_M
    discs = params.disc_array
    angles = np.linspace(0.0, 2.0 * math.pi, CIRCLE_POINTS + 1)
    for centre, radius_m in zip(place_discs(pose[None], discs)[0], discs[:, 2]):
        circle = centre + radius_m * np.column_stack([np.cos(angles), np.sin(angles)])
        marker.points += [_point(p) for pair in zip(circle[:-1], circle[1:]) for p in pair]
    return marker


def _arrow(u, pose: np.ndarray, params: MarkerParams) -> Tuple[np.ndarray, np.ndarray]:
    velocity = np.nan_to_num(np.array(u[:2]), posinf=0.0, neginf=0.0)
    return pose[:2], pose[:2] + params.arrow_m_per_mps * (compute_rotation(pose[2]) @ velocity)


def _make_velocity(state: FilterState, number: int, name: str, ends: Tuple[np.ndarray, np.ndarray], color) -> Marker:
    marker = _make(state, number, name, Marker.ARROW, color)
    marker.scale.x, marker.scale.y, marker.scale.z = LINE_M, 2.0 * LINE_M, 3.0 * LINE_M
    marker.points = [_point(end) for end in ends]
    if np.allclose(*ends):
        marker.action = Marker.DELETE
    return marker


def _make_binding(state: FilterState) -> Marker:
    marker = _make(state, 4, "binding_point", Marker.SPHERE, (1.0, 0.0, 0.0))
    marker.scale.x = marker.scale.y = marker.scale.z = 4.0 * LINE_M
    marker.pose.position.x, marker.pose.position.y = state.binding_point.x, state.binding_point.y
    if not state.binding_rule:
        marker.action = Marker.DELETE
    return marker


def _make_text(state: FilterState, pose: np.ndarray) -> Marker:
    marker = _make(state, 5, "reason", Marker.TEXT_VIEW_FACING, (1.0, 1.0, 1.0))
    marker.scale.z = 0.2
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = float(pose[0]), float(pose[1]), 0.8
    marker.text = state.reason or state.binding_rule
    if state.blocked_s > 0.0:
        marker.text = f"blocked by {marker.text or 'the filter'} for {state.blocked_s:.0f} s"
    if not marker.text:
        marker.action = Marker.DELETE
    return marker


def _point(xy: List[float]) -> Point:
    return Point(float(xy[0]), float(xy[1]), 0.0)
