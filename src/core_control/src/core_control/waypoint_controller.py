# SPDX-License-Identifier: BSD-3-Clause
"""The nominal controller: a PID follower of waypoints that knows nothing of safety."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from core_control.dynamics import wrap_angle
from core_control.params import WaypointParams

# A step of time longer than this [s], or one backwards, restarts integrals and ramps.
LONGEST_STEP_S = 1.0
# Heading error [rad] beyond which a robot that cannot turn in place drives no slower: cos = 0.54.
ARC_ERROR_RAD = 1.0


@dataclass(frozen=True)
class WaypointCommand:
    """What the follower wants.

    Attributes:
        u: (3,) vx [m/s], vy = 0, yaw rate [rad/s] in base_link.
        distance_to_goal_m: along the waypoints still ahead; NaN without waypoints.
        goal_reached: the last waypoint has been reached; stays true until new waypoints are given.
    """

    u: np.ndarray
    distance_to_goal_m: float
    goal_reached: bool


class Pid:
    """u = kp e + ki integral(e) + kd de/dt, the integral kept within what the output may be.

    Args:
        kp, ki, kd: gains, >= 0.
        limit: largest magnitude of the output.
    """

    def __init__(self, kp: float, ki: float, kd: float, limit: float):
        """Start with an empty integral."""
        self._kp, self._ki, self._kd, self._limit = kp, ki, kd, limit
        self.reset()

    def reset(self) -> None:
        """Empty the integral and forget the last error."""
        self._integral = 0.0
        self._last: Optional[float] = None

    def step(self, error: float, dt_s: float) -> float:
        """Output for one error; dt_s > 0."""
        bound = self._limit / self._ki if self._ki > 0.0 else 0.0
        self._integral = min(max(self._integral + error * dt_s, -bound), bound)
        slope = 0.0 if self._last is None else (error - self._last) / dt_s
        self._last = error
        output = self._kp * error + self._ki * self._integral + self._kd * slope
        return min(max(output, -self._limit), self._limit)


def is_inside_turn(distance_m: float, bearing_rad: float, radius_m: float) -> bool:
    """Whether a point lies inside the tightest circle that can be driven towards its side.

        d^2 < 2 R d |sin(bearing)|

    Args:
        distance_m: d, to the point.
        bearing_rad: angle from the heading to the point.
        radius_m: R, of the circle.
    """
    return distance_m < 2.0 * radius_m * abs(math.sin(bearing_rad))


class WaypointController:
    """Walks from waypoint to waypoint and stops at the last.

    It turns in place while the heading error is larger than turn_in_place_rad, else it walks at
    v = PID(distance) cos(heading error), never faster than it can still brake from, v <= sqrt(2 a distance). Speeds
    grow and shrink at bounded rates, except that the goal stops it at once.

    With min_turning_radius_m = R > 0 (Ackermann steering) it never turns in place: it drives an arc, |w| <= v / R, no
    slower than a heading error of 1 rad asks for. A waypoint inside the circle of that arc cannot be steered to, so it
    drives straight ahead until the waypoint lies outside.

    Args:
        params: checked parameters.

    Source: [CORE] implementation details (waypoint follower with a PID controller); gains are ours.
    """

    def __init__(self, params: WaypointParams):
        """Take the waypoints of the parameters."""
        p = self._params = params
        self._heading = Pid(p.heading_kp_per_s, p.heading_ki_per_s2, p.heading_kd, p.max_yaw_rate_radps)
        self._distance = Pid(p.distance_kp_per_s, p.distance_ki_per_s2, p.distance_kd, p.max_speed_mps)
        self.set_waypoints(params.waypoints)

    def set_waypoints(self, waypoints_m: Sequence[Sequence[float]]) -> None:
        """Start over with new waypoints, (n, 2) [m] in odom; none means stand still.

        Raises:
            ValueError: an entry is not finite or has not two numbers.
        """
        waypoints = np.array(waypoints_m, dtype=float) if len(waypoints_m) else np.zeros((0, 2))
        if waypoints.shape != (len(waypoints_m), 2) or not np.isfinite(waypoints).all():
            raise ValueError("waypoints must be finite pairs x, y")
        self._waypoints = waypoints
        self._reached = False
        self.restart()

    def restart(self) -> None:
        """Begin again at the first waypoint and at rest, as after a reset of the world."""
        self._index = 0
        self._reached = False
        self._rest()

    def _rest(self) -> None:
        self._speed = np.zeros(2)
        self._stamp_s: Optional[float] = None
        self._heading.reset()
        self._distance.reset()

    def step(self, pose: np.ndarray, stamp_s: float) -> WaypointCommand:
        """Command for one odometry message.

        Args:
            pose: (3,) x [m], y [m], yaw [rad] of base_link in odom; not finite gives zero.
            stamp_s: stamp of the message; the time since the last one drives integrals and ramps.
        """
        if not len(self._waypoints) or not np.isfinite(pose).all():
            return WaypointCommand(np.zeros(3), math.nan, False)
        dt_s = 0.0 if self._stamp_s is None else stamp_s - self._stamp_s
        if dt_s < 0.0 or dt_s > LONGEST_STEP_S:
            self._rest()
            dt_s = 0.0
        self._stamp_s = stamp_s
        self._advance(pose)
        remaining_m = self._compute_remaining(pose)
        wanted = (0.0, 0.0) if self._reached else self._want(pose, remaining_m, dt_s)
        self._ramp(wanted, dt_s)
        return WaypointCommand(np.array([self._speed[0], 0.0, self._speed[1]]), remaining_m, self._reached)

    def _advance(self, pose: np.ndarray) -> None:
        last = len(self._waypoints) - 1
        while self._index < last and self._distance_to(pose, self._index) <= self._params.waypoint_tolerance_m:
            self._index += 1
        if self._index == last and self._distance_to(pose, last) <= self._params.goal_tolerance_m:
            self._reached = True

    def _distance_to(self, pose: np.ndarray, index: int) -> float:
        return float(np.linalg.norm(self._waypoints[index] - pose[:2]))

    def _compute_remaining(self, pose: np.ndarray) -> float:
        ahead = np.diff(self._waypoints[self._index :], axis=0)
        return self._distance_to(pose, self._index) + float(np.linalg.norm(ahead, axis=1).sum())

    def _want(self, pose: np.ndarray, remaining_m: float, dt_s: float) -> Tuple[float, float]:
        to_waypoint = self._waypoints[self._index] - pose[:2]
        error_rad = wrap_angle(math.atan2(to_waypoint[1], to_waypoint[0]) - pose[2])
        if dt_s <= 0.0:
            return 0.0, 0.0
        radius_m = self._params.min_turning_radius_m
        if radius_m > 0.0 and is_inside_turn(float(np.linalg.norm(to_waypoint)), error_rad, radius_m):
            error_rad = 0.0
        yaw_rate_radps = self._heading.step(error_rad, dt_s)
        if radius_m > 0.0:
            error_rad = min(abs(error_rad), ARC_ERROR_RAD)
        elif abs(error_rad) > self._params.turn_in_place_rad:
            self._distance.reset()
            return 0.0, yaw_rate_radps
        braking_mps = math.sqrt(2.0 * self._params.max_acceleration_mps2 * remaining_m)
        speed_mps = min(max(self._distance.step(remaining_m, dt_s), 0.0), braking_mps)
        return speed_mps * math.cos(error_rad), yaw_rate_radps

    def _ramp(self, wanted: Tuple[float, float], dt_s: float) -> None:
        if self._reached:
            self._speed = np.zeros(2)
            return
        step = dt_s * np.array([self._params.max_acceleration_mps2, self._params.max_yaw_acceleration_radps2])
        self._speed = np.clip(np.array(wanted), self._speed - step, self._speed + step)
        if self._params.min_turning_radius_m > 0.0:
            most_radps = abs(self._speed[0]) / self._params.min_turning_radius_m
            self._speed[1] = min(max(self._speed[1], -most_radps), most_radps)
