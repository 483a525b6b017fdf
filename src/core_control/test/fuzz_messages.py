# SPDX-License-Identifier: BSD-3-Clause
"""Messages for the filter that were sound and had a few fields corrupted, and which of them no motion may follow."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import numpy as np
import rospy
from control_support import make_grid
from core_msgs.msg import SafetyGrid, UnsafeCause
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from core_control.ros.conversions import odometry_to_msg, twist_to_msg
from core_control.types import CellState

NAN, INF = math.nan, math.inf
NOT_FINITE = (NAN, INF, -INF)
HUGE = (1e308, -1e308, 1.7e308, 1e200, -1e154, 1e38, 1e18, -1e9, 1e4, 5e-324, -1e-308, 1e-30, -0.0)
WILD = (*NOT_FINITE, *HUGE)
LIMITS_S = {"nominal": 0.3, "odometry": 0.3, "grid": 0.5, "constraints": 15.0}
FUTURE_S = 0.2
NAMES = ("nominal", "odometry", "grid")
STAMPS = (rospy.Time(0), rospy.Time(0, 1), rospy.Time(1), rospy.Time(2**32 - 1, 999_999_999), rospy.Time(2**31, 5))


@dataclass
class Tick:
    """What the filter receives before one tick. Corruptions change it; grid is shared with other ticks, so copied."""

    now_s: float
    nominal: Twist
    odometry: Odometry
    grid: SafetyGrid
    receipt_age_s: dict = field(default_factory=lambda: {"nominal": 0.01, "odometry": 0.01, "grid": 0.03})
    missing: set = field(default_factory=set)

    def own_grid(self) -> SafetyGrid:
        """A copy of the grid that may be changed; arrays are replaced, never written into."""
        self.grid = copy.copy(self.grid)
        self.grid.header = copy.deepcopy(self.grid.header)
        return self.grid


def choose(rng, values):
    return values[int(rng.integers(len(values)))]


def draw_grid(rng) -> SafetyGrid:
    """Rectangles, speckle, some of it unknown; the arrays are those of rospy.numpy_msg."""
    ny, nx = (int(n) for n in rng.integers(8, 41, 2))
    unsafe = rng.random((ny, nx)) < choose(rng, (0.0, 0.01, 0.05))
    for _ in range(int(rng.integers(1, 4))):
        iy, ix = rng.integers(0, (ny, nx))
        unsafe[iy : iy + rng.integers(1, 8), ix : ix + rng.integers(1, 8)] = True
    grid = make_grid(unsafe, resolution_m=float(choose(rng, (0.1, 0.2, 0.25))))
    grid.state[rng.random((ny, nx)) < choose(rng, (0.0, 0.02))] = CellState.UNKNOWN
    message = SafetyGrid(
        resolution_m=grid.resolution_m, width=nx, height=ny, unknown_is_unsafe=bool(rng.random() < 0.8)
    )
    message.header.frame_id = "odom"
    message.origin_x_m, message.origin_y_m = (float(value) for value in grid.origin_m)
    message.state, message.cause = grid.state.ravel(), grid.cause.ravel()
    message.h_m = (rng.uniform(0.05, 2.0, ny * nx) * grid.h_m.ravel()).astype(np.float32)
    message.causes = [UnsafeCause(rule="BETWEEN(traffic_cone)", class_name="traffic_cone", instance_id=3)]
    return message


def make_tick(now_s, pose, twist, u_nominal, grid) -> Tick:
    """A sound tick: every check of freshness and content holds."""
    now = rospy.Time.from_sec(now_s)
    odometry = odometry_to_msg(pose, twist)
    odometry.header.stamp = now
    tick = Tick(now_s, twist_to_msg(u_nominal), odometry, grid)
    tick.own_grid().header.stamp = tick.grid.constraints_stamp = now
    tick.grid.history_start = rospy.Time(5)
    return tick


# Corruptions: each takes (rng, tick) and changes one thing.


def corrupt_nominal(rng, tick):
    part = choose(rng, (tick.nominal.linear, tick.nominal.angular))
    setattr(part, choose(rng, "xyz"), choose(rng, WILD))


def enlarge_nominal(rng, tick):
    setattr(tick.nominal.linear, choose(rng, "xy"), choose(rng, HUGE))
    if rng.random() < 0.5:
        tick.nominal.angular.z = choose(rng, HUGE)


def corrupt_odometry(rng, tick):
    pose, twist = tick.odometry.pose.pose, tick.odometry.twist.twist
    part = choose(rng, (pose.position, pose.orientation, pose.orientation, twist.linear, twist.angular))
    setattr(part, choose(rng, "xyz"), choose(rng, WILD))


def enlarge_odometry(rng, tick):
    pose, twist = tick.odometry.pose.pose, tick.odometry.twist.twist
    part = choose(rng, (pose.position, twist.linear, twist.angular))
    setattr(part, choose(rng, "xy" if part is not twist.angular else "z"), choose(rng, HUGE))


def corrupt_orientation(rng, tick):
    q = tick.odometry.pose.pose.orientation
    q.x, q.y, q.z, q.w = (choose(rng, (0.0, 0.0, 1.0, *WILD)) for _ in range(4))


def corrupt_frame(rng, tick):
    header = choose(rng, (tick.odometry.header, tick.own_grid().header))
    header.frame_id = choose(rng, ("", "map", "odom ", "/odom", "o" * 5000, "\u00f6dom"))


def corrupt_stamp(rng, tick):
    past_or_future = rospy.Time.from_sec(tick.now_s + choose(rng, (-1e3, -16.0, -1.0, 0.15, 0.5, 60.0)))
    stamp = choose(rng, (*STAMPS, past_or_future, past_or_future))
    which = rng.integers(4)
    if which == 0:
        tick.odometry.header.stamp = stamp
    elif which == 1:
        tick.own_grid().header.stamp = stamp
    elif which == 2:
        tick.own_grid().constraints_stamp = stamp
    else:
        tick.own_grid().history_start = stamp


def corrupt_receipt(rng, tick):
    name = choose(rng, NAMES)
    if rng.random() < 0.3:
        tick.missing.add(name)
    else:
        tick.receipt_age_s[name] = choose(rng, (0.6, 5.0, 1e9, -1.0, -1e9, *NOT_FINITE))


def corrupt_size(rng, tick):
    grid = tick.own_grid()
    if rng.random() < 0.4:
        sizes = (0, 1, 2, grid.height, grid.width, 2**16, 2**31, 2**32 - 1)
        setattr(grid, choose(rng, ("width", "height")), choose(rng, sizes))
        return
    name = choose(rng, ("h_m", "state", "cause", "speed_cap_mps"))
    values = getattr(grid, name)
    shapes = (values[:0], values[:-1], np.append(values, values[:1]).astype(np.asarray(values).dtype), values[::2])
    setattr(grid, name, choose(rng, shapes))


def corrupt_geometry(rng, tick):
    grid = tick.own_grid()
    name = choose(rng, ("resolution_m", "origin_x_m", "origin_y_m"))
    setattr(grid, name, choose(rng, (*WILD, 0.0, -0.1, 1e-9)))


def corrupt_field(rng, tick):
    """Some values of h."""
    grid = tick.own_grid()
    h_m = np.array(grid.h_m, dtype=np.float32)
    if h_m.size:
        with np.errstate(over="ignore"):
            h_m[rng.integers(0, h_m.size, int(rng.integers(1, 6)))] = choose(rng, WILD)
    grid.h_m = h_m


def corrupt_state(rng, tick):
    """Unknown values, or as bytes, or everything of one kind."""
    grid = tick.own_grid()
    state = np.array(np.frombuffer(grid.state, np.uint8) if isinstance(grid.state, bytes) else grid.state)
    kind = rng.integers(4)
    if kind == 0 and state.size:
        state[rng.integers(0, state.size)] = rng.integers(0, 256)
    elif kind == 1:
        state[:] = rng.integers(0, 3)
    elif kind == 2:
        state = rng.integers(0, 3, state.size).astype(np.uint8)
    grid.state = state.tobytes() if kind == 3 else state


def corrupt_causes(rng, tick):
    grid = tick.own_grid()
    if rng.random() < 0.5:
        grid.causes = choose(
            rng, ([], [UnsafeCause(rule="x" * 3000, class_name="", instance_id=2**32 - 1, motion=255)])
        )
    else:
        grid.cause = rng.integers(0, 2**16, np.size(grid.cause)).astype(np.uint16)


def corrupt_speed_cap(rng, tick):
    grid = tick.own_grid()
    with np.errstate(over="ignore"):
        grid.speed_cap_mps = rng.choice([*WILD, 0.0, 0.2, 1.0], np.size(grid.state)).astype(np.float32)


def flip_unknown(rng, tick):
    grid = tick.own_grid()
    grid.unknown_is_unsafe = not grid.unknown_is_unsafe


# What leaves most ticks fit for the program and the verifier, and everything.
DEEP = (enlarge_nominal, enlarge_odometry, corrupt_geometry, corrupt_state, corrupt_causes, corrupt_field, flip_unknown)
ANY = (*DEEP, corrupt_nominal, corrupt_odometry, corrupt_orientation, corrupt_frame, corrupt_stamp, corrupt_receipt,
       corrupt_size, corrupt_speed_cap)  # fmt: skip


def corrupt(rng, tick) -> int:
    """Corrupt up to four fields; how many (0: the tick stays sound)."""
    kinds = DEEP if rng.random() < 0.5 else ANY
    count = int(choose(rng, (0, 1, 1, 1, 2, 2, 3, 4)))
    for _ in range(count):
        choose(rng, kinds)(rng, tick)
    return count


# The judge: written from the README's promises and the messages alone, without the filter's code.


def must_stop(tick: Tick) -> bool:
    """Whether no motion may follow this tick. Ages within 1 ms of a limit do not occur."""
    return bool(tick.missing) or _nominal_is_bad(tick) or _odometry_is_bad(tick) or _grid_is_bad(tick)


def _nominal_is_bad(tick):
    linear, angular = tick.nominal.linear, tick.nominal.angular
    six = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    outside_plane = linear.z != 0.0 or angular.x != 0.0 or angular.y != 0.0
    return not np.isfinite(six).all() or outside_plane or not tick.receipt_age_s["nominal"] <= LIMITS_S["nominal"]


def _odometry_is_bad(tick):
    pose, twist = tick.odometry.pose.pose, tick.odometry.twist.twist
    q, p = pose.orientation, pose.position
    used = (p.x, p.y, q.x, q.y, q.z, q.w, twist.linear.x, twist.linear.y, twist.angular.z)
    no_direction = not np.any([q.x, q.y, q.z, q.w])
    return not np.isfinite(used).all() or no_direction or _is_old(tick, "odometry", tick.odometry.header.stamp)


def _is_old(tick, name, stamp):
    since_stamp_s = 0.0 if stamp.is_zero() else tick.now_s - stamp.to_sec()
    oldest_s = max(tick.receipt_age_s[name], since_stamp_s) if not math.isnan(tick.receipt_age_s[name]) else NAN
    return not (since_stamp_s >= -FUTURE_S and oldest_s <= LIMITS_S[name])


def _grid_is_bad(tick):
    grid, cells = tick.grid, int(tick.grid.width) * int(tick.grid.height)
    wrong_size = cells == 0 or any(len(getattr(grid, name)) != cells for name in ("h_m", "state", "cause"))
    if wrong_size or _is_old(tick, "grid", grid.header.stamp):
        return True
    geometry = (grid.resolution_m, grid.origin_x_m, grid.origin_y_m)
    if not np.isfinite(geometry).all() or not grid.resolution_m > 0.0 or np.isnan(grid.h_m).any():
        return True
    if max(bytes(bytearray(grid.state))) > CellState.UNKNOWN or grid.header.frame_id != tick.odometry.header.frame_id:
        return True
    constraints_age_s = tick.now_s - grid.constraints_stamp.to_sec()
    stamped = not grid.constraints_stamp.is_zero()
    return not (stamped and -FUTURE_S <= constraints_age_s <= LIMITS_S["constraints"])
