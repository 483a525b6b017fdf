# SPDX-License-Identifier: BSD-3-Clause
"""Shards of fuzzed inputs for the shipped filter, its conversions and its program, and what must never come of them.

run_ticks    messages -> LatestInputs.read -> CbfFilter.step -> messages that can be sent
run_library  FilterInputs with fields of wrong type, shape and value -> CbfFilter.step
run_qp       rows that conflict, repeat, vanish or are no numbers -> VelocityQp.solve
"""

from __future__ import annotations

import functools
import io
import math
import warnings
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import rospy
from control_support import make_field, make_inputs, make_params, start_anew
from fuzz_messages import HUGE, NAMES, WILD, choose, corrupt, draw_grid, make_tick, must_stop

from core_control.cbf_filter import CbfFilter
from core_control.exceptions import SolverError
from core_control.qp import VelocityQp
from core_control.ros.conversions import state_to_msg, twist_to_msg
from core_control.ros.latest_inputs import LatestInputs
from core_control.types import Mode

EPISODE_TICKS = 25
PERIOD_S = 0.05
EXAMPLES = 8
# Of a row or a limit [m/s, m/s, rad/s]: ten times what the program promises, and the rounding of large rows.
ROW_TOLERANCE, ROUNDING = 1e-5, 1e-12
LAGGY = {"lag_s": 0.3, "delay_s": 0.1, "discs": [[0.2, 0.1, 0.4]], "rows_per_disc": 3}
VARIANTS = {
    "core": {},
    "core_laggy": LAGGY,
    "core_cvxpy": {"solver": "cvxpy"},
    "paper": {"profile": "paper", "alpha_per_s": 0.25, "constraints_fresh_s": 15.0},
    "paper_cvxpy": {"profile": "paper", "alpha_per_s": 0.25, "constraints_fresh_s": 15.0, "solver": "cvxpy"},
}


@dataclass
class Tally:
    """What happened to fuzzed inputs; the first five must stay zero."""

    non_finite: int = 0
    out_of_limit: int = 0
    crashes: int = 0
    moved_on_failed_check: int = 0
    broken_rows: int = 0
    inputs: int = 0
    sound_inputs: int = 0
    must_stop: int = 0
    moved: int = 0
    reached_program: int = 0
    reached_verifier: int = 0
    refused_by_program: int = 0
    internal_errors: int = 0
    reasons: Counter = field(default_factory=Counter)
    examples: list = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Take in the counts of another shard."""
        for name, value in vars(other).items():
            if name == "examples":
                self.examples = (self.examples + value)[:EXAMPLES]
            else:
                setattr(self, name, getattr(self, name) + value)

    def blame(self, name: str, what: str) -> None:
        """Count what must not happen."""
        setattr(self, name, getattr(self, name) + 1)
        if len(self.examples) < EXAMPLES:
            self.examples.append(f"{name}: {what}"[:400])


class Probe:
    """Stands in a method's place and counts its calls and those that raised."""

    def __init__(self, owner, name):
        self._inner, self.calls, self.raised = getattr(owner, name), 0, 0
        setattr(owner, name, self)

    def __call__(self, *arguments, **named):
        self.calls += 1
        try:
            return self._inner(*arguments, **named)
        except Exception:
            self.raised += 1
            raise


@functools.lru_cache(maxsize=None)
def make_filter(variant: str):
    """The shipped filter of a variant, which takes half a second to start, and probes of its program and verifier."""
    filter_ = CbfFilter(make_params(**VARIANTS[variant]))
    profile = filter_._profile
    verifier = Probe(profile._roll_out, "find_scale") if hasattr(profile, "_roll_out") else None
    return filter_, Probe(profile._qp, "solve"), verifier


@functools.lru_cache(maxsize=None)
def make_qp(kind: str) -> VelocityQp:
    """The program of a kind alone."""
    rows, boxed, solver = QP_KINDS[kind]
    return VelocityQp(rows, np.array([1.0, 1.0, 0.5]), boxed, solver)


class FuzzedFilter:
    """One shipped filter between probes, and the judgement of its answers."""

    def __init__(self, variant: str, tally: Tally):
        self.params, self.tally, self.name = make_params(**VARIANTS[variant]), tally, variant
        self.filter, self._program, self._verifier = make_filter(variant)
        start_anew(self.filter)

    def step(self, inputs, what):
        """The filter's answer, counted; None when it raised or what it said cannot be used."""
        raised_before, calls_before = self._program.raised, self._program.calls
        verified_before = self._verifier.calls if self._verifier else 0
        try:
            result = self.filter.step(inputs)
        except Exception as error:
            self.tally.blame("crashes", f"{self.name} {what()}: {type(error).__name__}: {error}")
            return None
        self.tally.reached_program += self._program.calls > calls_before
        self.tally.reached_verifier += bool(self._verifier) and self._verifier.calls > verified_before
        refused = self._program.raised > raised_before
        self.tally.refused_by_program += refused
        self._judge(result, refused, what)
        return result

    def _judge(self, result, refused, what):
        u, label = np.asarray(result.u_safe), f"{self.name} {what()}"
        if u.shape != (3,) or not np.isfinite(u).all():
            self.tally.blame("non_finite", f"{label}: {u}")
            return
        if np.any(np.abs(u) > self.params.limits + ROUNDING):
            self.tally.blame("out_of_limit", f"{label}: {u}")
        if np.any(u) and (refused or result.mode == Mode.STOPPED or result.latched):
            self.tally.blame("moved_on_failed_check", f"{label}: {u} in mode {result.mode.name} {result.reason}")
        self.tally.moved += bool(np.any(u))
        self.tally.reasons[result.reason] += 1
        self.tally.internal_errors += result.reason == "internal_error"

    def recover(self, result):
        """Now and then an operator resets what is latched, so that the next inputs reach the filter's depth."""
        if result is None or result.latched:
            start_anew(self.filter)


def run_ticks(variant: str, seed: int, count: int) -> Tally:
    """Tally of at least count corrupted ticks, in episodes of one grid and one walk."""
    tally, rng = Tally(), np.random.default_rng(seed)
    fuzzed = FuzzedFilter(variant, tally)
    while tally.inputs < count:
        _run_episode(fuzzed, rng)
    return tally


def _run_episode(fuzzed, rng):
    grid, latest = draw_grid(rng), LatestInputs()
    size_m = np.array([grid.width, grid.height]) * grid.resolution_m
    pose, twist = np.append(rng.uniform(-0.5, 0.5, 2) * size_m, rng.uniform(-3.2, 3.2)), np.zeros(3)
    start_anew(fuzzed.filter)
    u_nominal = rng.uniform(-1.2, 1.2, 3) * fuzzed.params.limits
    for i in range(EPISODE_TICKS):
        if i % 8 == 0:
            u_nominal = rng.uniform(-1.2, 1.2, 3) * fuzzed.params.limits
        tick = make_tick(1000.0 + PERIOD_S * i, pose, twist, u_nominal, grid)
        corrupted = corrupt(rng, tick)
        result = _send(fuzzed, latest, tick, corrupted)
        fuzzed.recover(result)
        if result is not None and np.isfinite(result.u_safe).all():
            twist = np.clip(result.u_safe, -1.0, 1.0)
            pose = pose + PERIOD_S * twist


def _send(fuzzed, latest, tick, corrupted):
    """Through the conversions, the filter, and out again; the result, or None."""
    tally = fuzzed.tally
    tally.inputs, tally.sound_inputs = tally.inputs + bool(corrupted), tally.sound_inputs + (not corrupted)
    stop = must_stop(tick)
    tally.must_stop += stop
    try:
        inputs = _receive(latest, tick)
    except Exception as error:
        tally.blame("crashes", f"{type(error).__name__}: {error} of {describe(tick)}")
        return None
    result = fuzzed.step(inputs, lambda: describe(tick))
    if result is None:
        return None
    if stop and np.any(result.u_safe):
        tally.blame("moved_on_failed_check", f"{result.u_safe} after {describe(tick)}")
    try:
        _send_off(result, inputs, tick.now_s)
    except Exception as error:
        tally.blame("crashes", f"{type(error).__name__}: {error} when sending the state of {describe(tick)}")
    return result


def _receive(latest, tick):
    """As the node does: every callback stores, the loop reads."""
    monotonic_s = tick.now_s - 900.0
    stamps = {"nominal": rospy.Time(), "odometry": tick.odometry.header.stamp, "grid": tick.grid.header.stamp}
    if tick.missing:
        latest = LatestInputs()
    for name in NAMES:
        if name not in tick.missing:
            stamp_s = math.nan if stamps[name].is_zero() else stamps[name].to_sec()
            latest.store(name, getattr(tick, name), monotonic_s - tick.receipt_age_s[name], stamp_s)
    return latest.read(monotonic_s, tick.now_s)


def _send_off(result, inputs, now_s):
    for message in (twist_to_msg(result.u_safe), state_to_msg(result, inputs, rospy.Time.from_sec(now_s), 7)):
        message.serialize(io.BytesIO())


def describe(tick) -> str:
    """Everything of a tick that is no array."""
    grid, odometry = tick.grid, tick.odometry
    sizes = {name: len(getattr(grid, name)) for name in ("h_m", "state", "cause", "speed_cap_mps")}
    shown = [tick.nominal, odometry.pose.pose, odometry.twist.twist, grid.width, grid.height, grid.resolution_m]
    shown += [grid.origin_x_m, grid.origin_y_m, sizes, tick.receipt_age_s, tick.missing, tick.now_s]
    shown += [odometry.header.stamp, grid.header.stamp, grid.constraints_stamp]
    return " ".join(str(part).replace("\n", " ") for part in shown)


# The library's own inputs.

SHAPES = ((), (0,), (1,), (2,), (4,), (3, 3), (1, 3))
AGES_S = (0.0, 0.4, 1.0, 20.0, -0.1, -5.0, 1e308, *WILD[:3])


def corrupt_vector(rng):
    kind = rng.integers(5)
    if kind == 0:
        return None
    if kind == 1:
        return np.full(choose(rng, SHAPES), choose(rng, (0.1, *WILD)))
    if kind == 2:
        return np.array([choose(rng, (0.1, *WILD)) for _ in range(3)])
    return np.array([choose(rng, (0.0, 0.1, -0.2, *HUGE)) for _ in range(3)])


def run_library(variant: str, seed: int, count: int) -> Tally:
    """Tally of count inputs as no node would make them: step must answer zero, and never raise."""
    tally, rng = Tally(), np.random.default_rng(seed)
    fuzzed, vectors = FuzzedFilter(variant, tally), ("u_nominal", "pose", "twist")
    ages = ("nominal_age_s", "odometry_age_s", "grid_age_s", "constraints_age_s")
    while tally.inputs < count:
        field = make_field(rng.random(rng.integers(1, 14, 2)) < rng.random(), resolution_m=0.2)
        inputs = make_inputs(rng.uniform(-0.6, 0.6, 3), field, rng.uniform(-1.0, 1.0, 3))
        for _ in range(int(rng.integers(1, 4))):
            kind = rng.integers(6)
            if kind <= 2:
                inputs = replace(inputs, **{choose(rng, vectors): corrupt_vector(rng)})
            elif kind <= 4:
                inputs = replace(inputs, **{choose(rng, ages): choose(rng, AGES_S)})
            else:
                inputs = replace(inputs, field=choose(rng, (None, object(), field.grid)))
        tally.inputs += 1
        stop = library_must_stop(inputs)
        tally.must_stop += stop
        result = fuzzed.step(inputs, lambda i=inputs: f"{i.u_nominal} {i.pose} {i.twist} {i.field}")
        if stop and result is not None and np.any(result.u_safe):
            tally.blame("moved_on_failed_check", f"{result.u_safe} after {inputs}")
        fuzzed.recover(result)
    return tally


def library_must_stop(inputs) -> bool:
    """Whether a vector is no (3,) of finite numbers, an age is beyond its limit, or there is no field."""
    vectors = (inputs.u_nominal, inputs.pose, inputs.twist)
    if any(v is None or v.shape != (3,) or not np.isfinite(v).all() for v in vectors):
        return True
    limits = {"nominal_age_s": 0.3, "odometry_age_s": 0.3, "grid_age_s": 0.5, "constraints_age_s": 15.0}
    return not (hasattr(inputs.field, "unsafe") and all(-0.2 <= getattr(inputs, k) <= v for k, v in limits.items()))


# The program alone.

QP_ROWS = 12
QP_KINDS = {
    "qp": (QP_ROWS, True, "compiled"),
    "qp_one_row": (1, False, "compiled"),
    "qp_cvxpy": (QP_ROWS, True, "cvxpy"),
}


def run_qp(kind: str, seed: int, count: int) -> Tally:
    """Tally of count corrupted programs: solve answers within every row and limit, or raises SolverError."""
    tally, rng = Tally(), np.random.default_rng(seed)
    (rows, boxed, _), qp = QP_KINDS[kind], make_qp(kind)
    while tally.inputs < count:
        program = draw_program(rng, rows)
        tally.inputs += 1
        tally.reached_program += 1
        try:
            u = qp.solve(*program)
        except SolverError:
            tally.refused_by_program += 1
            continue
        except Exception as error:
            tally.blame("crashes", f"{kind} {type(error).__name__}: {error} of {program}")
            continue
        judge_program(tally, u, program, boxed, kind)
    return tally


def draw_program(rng, rows):
    """(u_nominal, a, b, box), sound but for one to three corruptions."""
    n = int(rng.integers(0, rows + 1))
    u_nominal, a, b = rng.uniform(-1, 1, 3), rng.normal(size=(n, 3)), -rng.uniform(0.0, 0.2, n)
    box = [-rng.uniform(0.1, 1, 3), rng.uniform(0.1, 1, 3)]
    for _ in range(int(rng.integers(1, 4))):
        _corrupt_program(rng, u_nominal, a, b, box)
    return u_nominal, a, b, tuple(box)


def _corrupt_program(rng, u_nominal, a, b, box):
    kind, n = int(rng.integers(9)), len(b)
    i, j = (rng.integers(0, n, 2)) if n else (0, 0)
    if kind == 0:
        u_nominal[rng.integers(3)] = choose(rng, WILD)
    elif kind == 1:
        box[rng.integers(2)][rng.integers(3)] = choose(rng, (0.0, *WILD))
    elif not n:
        return
    elif kind == 2:
        a[i, rng.integers(3)] = choose(rng, WILD)
    elif kind == 3:
        b[i] = choose(rng, (0.1, *WILD))
    elif kind == 4:  # two rows that exclude each other, by much or by next to nothing
        a[j], b[i], b[j] = -a[i], 0.1, -0.1 + 10.0 ** rng.uniform(-12, 0)
    elif kind == 5:  # the same row twice, or almost
        a[j], b[j] = a[i] * (1.0 + choose(rng, (0.0, 1e-15, 1e-9))), b[i]
    elif kind == 6:
        a[i], b[i] = 0.0, choose(rng, (0.0, -1.0, 1e-9, 0.1))
    elif kind == 7:
        a[i] *= 10.0 ** rng.uniform(-200, 200)
    else:
        b[:] = rng.uniform(-0.1, 0.5, n)


def judge_program(tally, u, program, boxed, kind):
    """An answer must be finite, within the box, and within every row."""
    _, a, b, (lower, upper) = program
    if np.shape(u) != (3,) or not np.isfinite(u).all():
        tally.blame("non_finite", f"{kind} {u} of {program}")
        return
    if boxed and not (np.all(u >= lower) and np.all(u <= upper)):
        tally.blame("out_of_limit", f"{kind} {u} of {program}")
    tally.moved += bool(np.any(u))
    products = np.asarray(a, dtype=np.longdouble) * u
    slack = products.sum(axis=1) - b
    allowed = ROW_TOLERANCE + ROUNDING * np.abs(products).sum(axis=1)
    if not np.all(slack >= -allowed):
        tally.blame("broken_rows", f"{kind} {u} by {float(-slack.min()):.3g} of {program}")


# Name -> (how to run it, share of all inputs). cvxpy takes a hundred times as long as the compiled program.
CASES = {
    "core": (run_ticks, 0.4),
    "core_laggy": (run_ticks, 0.14),
    "paper": (run_ticks, 0.2),
    "core_cvxpy": (run_ticks, 0.004),
    "paper_cvxpy": (run_ticks, 0.004),
    "library:core": (run_library, 0.04),
    "library:paper": (run_library, 0.02),
    "qp": (run_qp, 0.16),
    "qp_one_row": (run_qp, 0.03),
    "qp_cvxpy": (run_qp, 0.002),
}


def run_case(job) -> Tally:
    """Tally of one shard, (case, seed, count)."""
    case, seed, count = job
    # A product that overflows, or an answer that cvxpy calls inaccurate, is what is asked for here.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return CASES[case][0](case.split(":")[-1], seed, count)
