# SPDX-License-Identifier: BSD-3-Clause
"""check_bag on made-up sessions: good ones hold, and each violation put into one is found under its own name."""

import ast
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rosbag
import rospy
from control_support import make_grid
from core_msgs.msg import FilterState
from geometry_msgs.msg import Twist, TwistStamped
from ros_support import grid_to_msg

from core_control.bag_invariant import Bounds, check
from core_control.ros.bag_check import TOPICS, main, read_recording, resolve
from core_control.ros.conversions import odometry_to_msg, twist_to_msg

PACKAGE = Path(__file__).resolve().parents[1]
START_S, PERIOD_S, TICKS = 1000.0, 0.05, 120
AHEAD = (0.3, 0.0, 0.1)
LATE_S = START_S + 3.0
GRID = make_grid(np.zeros((6, 6), bool))
NAMES = {role: resolve("/", name) for role, name in TOPICS.items()}


def to_time(seconds):
    return rospy.Time.from_sec(seconds)


class Session:
    """Messages as a recorder would have them: (role, message, receipt time). Faults change or drop them."""

    def __init__(self, seed=0, jitter_s=0.01):
        rng = np.random.default_rng(seed)
        self.entries = []
        for role, rate_hz in (("nominal", 20.0), ("odometry", 50.0), ("grid", 10.0)):
            for k in range(int((TICKS + 60) * PERIOD_S * rate_hz)):
                sent_s = START_S - 1.0 + k / rate_hz
                self.entries.append([role, make_input(role, sent_s), sent_s + rng.uniform(0.0, jitter_s)])
        for k in range(TICKS):
            stamp_s = START_S + PERIOD_S * k
            received_s = stamp_s + 0.002 + rng.uniform(0.0, jitter_s, 2)
            self.entries.append(["command", twist_to_msg(AHEAD), received_s[0]])
            self.entries.append(["state", make_state(stamp_s, k), received_s[1]])

    def of(self, role, from_s=-math.inf, until_s=math.inf):
        return [entry for entry in self.entries if entry[0] == role and from_s <= entry[2] < until_s]

    def drop(self, role, from_s=-math.inf, until_s=math.inf):
        dropped = [id(entry) for entry in self.of(role, from_s, until_s)]
        self.entries = [entry for entry in self.entries if id(entry) not in dropped]

    def change(self, role, change, from_s=-math.inf, until_s=math.inf):
        for entry in self.of(role, from_s, until_s):
            change(entry[1])

    def stop(self, from_s, until_s=math.inf, mode=FilterState.STOPPED):
        """Zero is sent, and said."""
        self.change("command", lambda m: assign(m, Twist()), from_s, until_s)
        self.change("state", lambda m: (setattr(m, "u_safe", [0.0] * 3), setattr(m, "mode", mode)), from_s, until_s)

    def write(self, path):
        with rosbag.Bag(str(path), "w") as bag:
            for role, message, received_s in sorted(self.entries, key=lambda entry: entry[2]):
                bag.write(NAMES[role], message, to_time(received_s))
        return str(path)


def assign(message, other):
    message.linear, message.angular = other.linear, other.angular


def make_input(role, sent_s):
    if role == "nominal":
        return twist_to_msg(AHEAD)
    if role == "grid":
        return grid_to_msg(GRID, to_time(sent_s), to_time(sent_s - 1.0))
    message = odometry_to_msg(np.zeros(3), np.zeros(3))
    message.header.stamp = to_time(sent_s)
    return message


def make_state(stamp_s, tick, mode=FilterState.NOMINAL, u=AHEAD):
    state = FilterState(tick=tick, mode=mode, u_safe=list(u))
    state.header.stamp = to_time(stamp_s)
    return state


def judge(session, tmp_path, **bounds):
    return check(read_recording(session.write(tmp_path / "a.bag"), NAMES), Bounds(**bounds))


def test_a_good_session_holds_and_every_rule_was_applied(tmp_path):
    report = judge(Session(), tmp_path)
    assert report.holds, report.violations
    assert min(report.checked[rule] for rule in ("fresh_nominal", "fresh_odometry", "fresh_grid", "one_frame")) == 100
    assert report.checked["equals_state"] == report.checked["within_limits"] == TICKS
    assert report.checked["fresh_constraints"] == 100
    assert report.checked["period"] == 1
    assert report.figures["moving"] == TICKS


@pytest.mark.parametrize("seed", range(5))
def test_delay_on_the_way_to_the_recorder_is_no_violation(tmp_path, seed):
    assert judge(Session(seed, jitter_s=0.045), tmp_path).holds


def test_zero_needs_nothing(tmp_path):
    session = Session()
    for role in ("nominal", "odometry", "grid"):
        session.drop(role, LATE_S)
    session.stop(LATE_S + 0.25)
    report = judge(session, tmp_path)
    assert report.holds, report.violations
    assert report.modes["STOPPED"] > 40


# Every violation, put into a good session by one change.


def set_stamp(seconds):
    return lambda message: setattr(message.header, "stamp", to_time(seconds))


def set_nan(message):
    message.linear.y = math.nan


def silence(role):
    return lambda session: session.drop(role, LATE_S)


def freeze(role):
    return lambda session: session.change(role, set_stamp(LATE_S), LATE_S)


def change_late(role, change):
    return lambda session: session.change(role, change, LATE_S, LATE_S + 0.6)


def send_from_elsewhere(session):
    session.entries.append(["command", twist_to_msg((0.1, 0.0, 0.0)), LATE_S + 0.03])


def slow_down(session):
    for k, entry in enumerate(session.of("state", LATE_S)):
        entry[1].header.stamp = to_time(LATE_S + 0.07 * k)
        entry[2] = LATE_S + 0.07 * k + 0.01
    for k, entry in enumerate(session.of("command", LATE_S)):
        entry[2] = LATE_S + 0.07 * k + 0.005


VIOLATIONS = {
    "silent nominal": ("fresh_nominal", silence("nominal")),
    "silent odometry": ("fresh_odometry", silence("odometry")),
    "silent grid": ("fresh_grid", silence("grid")),
    "odometry with a frozen stamp": ("fresh_odometry", freeze("odometry")),
    "grid with a frozen stamp": ("fresh_grid", freeze("grid")),
    "odometry of the future": ("fresh_odometry", change_late("odometry", set_stamp(LATE_S + 5.0))),
    "nominal that is no number": ("fresh_nominal", change_late("nominal", set_nan)),
    "nominal outside the plane": ("fresh_nominal", change_late("nominal", lambda m: setattr(m.linear, "z", 0.1))),
    "odometry that is no number": (
        "fresh_odometry",
        change_late("odometry", lambda m: setattr(m.pose.pose.position, "x", math.inf)),
    ),
    "odometry without direction": (
        "fresh_odometry",
        change_late("odometry", lambda m: setattr(m.pose.pose.orientation, "w", 0.0)),
    ),
    "grid of another size": ("fresh_grid", change_late("grid", lambda m: setattr(m, "h_m", [1.0]))),
    "grid with h that is no number": ("fresh_grid", change_late("grid", lambda m: setattr(m, "h_m", [math.nan] * 36))),
    "grid of no cell size": ("fresh_grid", change_late("grid", lambda m: setattr(m, "resolution_m", 0.0))),
    "grid with an unknown state": ("fresh_grid", change_late("grid", lambda m: setattr(m, "state", b"\x03" * 36))),
    "old constraints": (
        "fresh_constraints",
        change_late("grid", lambda m: setattr(m, "constraints_stamp", to_time(LATE_S - 15.2))),
    ),
    "no constraints": (
        "fresh_constraints",
        change_late("grid", lambda m: setattr(m, "constraints_stamp", rospy.Time())),
    ),
    "two frames": ("one_frame", change_late("odometry", lambda m: setattr(m.header, "frame_id", "map"))),
    "command that is no number": ("finite", change_late("command", set_nan)),
    "command too fast": ("within_limits", change_late("command", lambda m: setattr(m.linear, "x", 0.51))),
    "command upwards": ("within_limits", change_late("command", lambda m: setattr(m.linear, "z", 0.01))),
    "command unlike its state": ("equals_state", change_late("command", lambda m: setattr(m.linear, "x", 0.29))),
    "stopped but moving": (
        "stopped_is_zero",
        change_late("state", lambda m: setattr(m, "mode", FilterState.STOPPED)),
    ),
    "another publisher": ("has_state", send_from_elsewhere),
    "a slow loop": ("period", slow_down),
}


@pytest.mark.parametrize("name", list(VIOLATIONS))
def test_a_violation_is_found_under_its_name(tmp_path, name):
    rule, inject = VIOLATIONS[name]
    session = Session()
    inject(session)
    report = judge(session, tmp_path)
    assert report.broken[rule] > 0, report.violations
    # A command that is changed no longer equals its state.
    assert set(report.broken) <= {rule, "equals_state", "within_limits"}


@pytest.mark.parametrize(("role", "limit_s"), [("nominal", 0.3), ("odometry", 0.3), ("grid", 0.5)])
def test_the_first_tick_too_late_is_found_and_none_before(tmp_path, role, limit_s):
    session = Session(jitter_s=0.0)
    session.drop(role, LATE_S)
    last_s = max(entry[2] for entry in session.of(role))
    report = judge(session, tmp_path)
    first_s = report.violations[0][0]
    tolerance_s = (
        0.0 if role != "nominal" else 0.05
    )  # a Twist has no stamp: only the receipt counts, with its transport
    assert limit_s + tolerance_s < first_s - last_s <= limit_s + tolerance_s + PERIOD_S + 1e-6


def test_a_stamped_nominal_command_counts_as_one(tmp_path):
    session = Session()
    for entry in session.of("nominal"):
        message = TwistStamped(twist=entry[1])
        message.header.stamp = to_time(entry[2])
        entry[:2] = ["nominal_stamped", message]
    assert judge(session, tmp_path).holds
    session.change("nominal_stamped", set_stamp(LATE_S), LATE_S)
    assert set(judge(session, tmp_path).broken) == {"fresh_nominal"}


@pytest.mark.parametrize("mode", [FilterState.DISABLED, FilterState.OVERRIDE])
def test_disabled_and_override_are_exempt_but_counted(tmp_path, mode):
    session = Session()
    session.drop("grid", LATE_S)
    session.change("command", lambda m: setattr(m.linear, "x", 0.9), LATE_S)
    session.change("state", lambda m: setattr(m, "u_safe", [0.9, 0.0, 0.1]), LATE_S)
    assert set(judge(session, tmp_path).broken) == {"fresh_grid", "within_limits"}
    session.change("state", lambda m: setattr(m, "mode", mode), LATE_S)
    report = judge(session, tmp_path)
    assert report.holds, report.violations
    assert 50 < sum(report.modes[name] for name in Bounds.exempt) < 70


def test_a_filter_killed_and_started_again_is_no_violation(tmp_path):
    session = Session()
    died_s, back_s = LATE_S + 0.01, LATE_S + 1.0
    session.drop("state", died_s, back_s)  # the last command came, its state did not
    session.drop("command", died_s + PERIOD_S, back_s)
    session.change("state", lambda m: setattr(m, "tick", m.tick - 80), back_s)
    report = judge(session, tmp_path)
    assert report.holds, report.violations
    assert report.figures["restarts"] == 1


def test_a_clock_that_goes_back_is_refused(tmp_path, capsys):
    session = Session()
    session.change("state", lambda m: setattr(m.header, "stamp", m.header.stamp - rospy.Duration(2.5)), LATE_S)
    assert main([session.write(tmp_path / "a.bag")]) == 2
    assert "clock goes back" in capsys.readouterr().err


# The program.


def run(*arguments):
    command = [sys.executable, str(PACKAGE / "scripts" / "check_bag"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, check=False, text=True)


def test_it_prints_a_table_and_the_first_ten_violations(tmp_path):
    good, bad = Session(), Session()
    bad.drop("grid", LATE_S)
    done = run(good.write(tmp_path / "good.bag"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "fresh_grid                 100         0" in done.stdout
    assert "exempt (DISABLED, OVERRIDE): 0" in done.stdout
    done = run(bad.write(tmp_path / "bad.bag"))
    assert done.returncode == 1
    assert done.stdout.count("VIOLATED at") == 10
    assert "fresh_grid: stamped 0.5" in done.stdout
    assert "more" in done.stdout.splitlines()[-1]


def test_topics_and_bounds_are_options(tmp_path):
    session = Session()
    session.drop("grid", LATE_S)
    path = session.write(tmp_path / "a.bag")
    assert main([path, "--grid-timeout-s", "10"]) == 0
    assert main([path, "--grid-timeout-s", "10", "--limits", "0.2", "0.2", "0.2"]) == 1
    assert main([path, "--ns", "/robot1"]) == 2
    assert main([path, "--ns", "/robot1", *sum(([f"--{r.replace('_', '-')}", n] for r, n in NAMES.items()), [])]) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("none.bag",), "none.bag"),
        (("text.bag",), "text.bag"),
        (("good.bag", "--odometry", "odometry"), "no message on /odometry; in the bag: /cbf_filter/state"),
        (("good.bag", "--transport-s", "0.3"), "--transport-s: got 0.3, allowed 0 to 0.2"),
        (("good.bag", "--period-s", "nan"), "--period-s: got nan, allowed > 0"),
        (("good.bag", "--limits", "1", "0", "1"), "--limits: got 0, allowed > 0"),
        (("good.bag", "--no-such-option"), "--no-such-option"),
        ((), "bag"),
    ],
)
def test_bad_input_is_told_in_one_line(tmp_path, monkeypatch, arguments, said):
    Session().write(tmp_path / "good.bag")
    (tmp_path / "text.bag").write_text("no bag")
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr
    assert done.stdout == ""


def test_it_takes_nothing_from_the_filter():
    for name in ("bag_invariant.py", "ros/bag_check.py"):
        tree = ast.parse((PACKAGE / "src" / "core_control" / name).read_text())
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
        assert {module for module in modules if module.startswith("core_")} <= {"core_control.bag_invariant"}
