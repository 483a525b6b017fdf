# SPDX-License-Identifier: BSD-3-Clause
"""The node world_bridge on a ROS master of its own, with a fake chain at the other end."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from core_bringup.kinematic_backend import integrate_twist

rospy = pytest.importorskip("rospy")
pytestmark = pytest.mark.skipif(shutil.which("rosmaster") is None, reason="needs rosmaster")

HERE = Path(__file__).resolve().parent
BRIDGE, CHAIN = HERE.parent / "scripts" / "world_bridge", HERE / "fakes" / "fake_chain"
LOCKSTEP = ("_backend:=kinematic", "_renderer:=none", "_lockstep:=true", "_rtf:=0")
DEADLINE_S = 30.0


def wait_for(condition, what, deadline_s=DEADLINE_S):
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s, f"deadline while waiting for {what}"
        time.sleep(0.005)


@pytest.fixture(scope="module")
def master(tmp_path_factory):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    os.environ.update(
        ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_HOME=str(tmp_path_factory.mktemp("ros"))
    )
    process = subprocess.Popen(
        ["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    import rosgraph

    wait_for(rosgraph.is_master_online, "the master")
    rospy.set_param("/use_sim_time", True)
    rospy.init_node("bridge_test", disable_signals=True, disable_rostime=True)
    yield
    rospy.signal_shutdown("done")
    process.terminate()
    process.wait()


class Graph:
    """Starts nodes and collects messages; everything is ended by close."""

    def __init__(self):
        self._processes, self._subscribers = [], []
        for name in ("/world_bridge", "/fake_chain"):
            if rospy.has_param(name):
                rospy.delete_param(name)

    def start(self, program, *arguments):
        process = subprocess.Popen(
            [sys.executable, str(program), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._processes.append(process)
        return process

    def listen(self, topic, kind):
        messages = []
        self._subscribers.append(rospy.Subscriber(topic, kind, messages.append, queue_size=1000, tcp_nodelay=True))
        return messages

    def set_going(self):
        """Unpause the world once it knows of every listener, so that none misses a tick."""
        from std_srvs.srv import Trigger

        from core_bringup.ros.connections import find_unserved

        wait_for(lambda: not find_unserved([s.name for s in self._subscribers]), "connections to the world")
        assert self.call("unpause", Trigger).success

    def call(self, service, kind, *arguments):
        rospy.wait_for_service(service, timeout=DEADLINE_S)
        return rospy.ServiceProxy(service, kind)(*arguments)

    def close(self):
        for subscriber in self._subscribers:
            subscriber.unregister()
        for process in self._processes:
            process.terminate()
            try:
                process.communicate(timeout=DEADLINE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


@pytest.fixture
def graph(master):
    graph = Graph()
    yield graph
    graph.close()


def positions(odometry):
    return np.array([[m.pose.pose.position.x, m.pose.pose.position.y] for m in odometry])


def test_lockstep_walk_is_exact_and_complete(graph):
    from core_msgs.msg import Tick, Violation
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock

    odometry, ticks = graph.listen("odom", Odometry), graph.listen("lockstep/tick", Tick)
    truths, clocks = graph.listen("ground_truth/violation", Violation), graph.listen("/clock", Clock)
    graph.start(BRIDGE, *LOCKSTEP, "_start_paused:=true")
    graph.start(CHAIN, "_command:=[0.3, 0.05, 0.1]")
    graph.set_going()
    wait_for(lambda: len(odometry) > 200, "200 ticks")
    assert [tick.tick for tick in ticks[:200]] == list(range(1, 201))
    for messages in (odometry, ticks, truths):
        assert [m.header.stamp.to_nsec() for m in messages[:200]] == [k * 50_000_000 for k in range(1, 201)]
    assert [m.clock.to_nsec() for m in clocks[:200]] == [k * 50_000_000 for k in range(1, 201)]
    pose, expected = np.zeros(3), []
    for _ in range(200):
        expected.append(pose[:2])
        pose = integrate_twist(pose, [0.3, 0.05, 0.1], 0.05)
    np.testing.assert_array_equal(positions(odometry[:200]), expected)
    assert truths[0].clearance_m == pytest.approx(5.45)
    assert truths[0].region == "behind_cone_line"


def test_reset_goes_back_to_the_first_tick_and_the_chain_goes_on(graph):
    from nav_msgs.msg import Odometry
    from std_srvs.srv import Trigger

    odometry = graph.listen("odom", Odometry)
    graph.start(BRIDGE, *LOCKSTEP, "_start_paused:=true")
    graph.start(CHAIN)
    graph.set_going()
    wait_for(lambda: len(odometry) > 100, "100 ticks")
    assert graph.call("reset", Trigger).success
    stamps = lambda: [m.header.stamp.to_nsec() for m in odometry]  # noqa: E731
    wait_for(lambda: any(b < a for a, b in zip(stamps(), stamps()[1:])), "a stamp that goes back")
    back = next(i for i, (a, b) in enumerate(zip(stamps(), stamps()[1:])) if b < a) + 1
    wait_for(lambda: len(odometry) > back + 100, "100 ticks after the reset")
    assert stamps()[back : back + 100] == [k * 50_000_000 for k in range(1, 101)]
    first = next(i for i, stamp in enumerate(stamps()) if stamp == 2_000_000_000)
    again = back + 39
    np.testing.assert_array_equal(positions([odometry[first]]), positions([odometry[again]]))


def test_paused_world_does_single_steps(graph):
    from core_msgs.srv import Step
    from std_srvs.srv import Trigger

    graph.start(BRIDGE, *LOCKSTEP, "_start_paused:=true")
    graph.start(CHAIN)
    assert graph.call("step", Step, 3).stamp.to_nsec() == 150_000_000
    assert graph.call("step", Step, 2).stamp.to_nsec() == 250_000_000
    refused = graph.call("step", Step, 0)
    assert not refused.success
    assert "allowed: >= 1" in refused.message
    assert graph.call("reset", Trigger).success
    assert graph.call("step", Step, 1).stamp.to_nsec() == 50_000_000
    assert graph.call("unpause", Trigger).success
    refused = graph.call("step", Step, 1)
    assert not refused.success
    assert "while paused" in refused.message
    assert graph.call("pause", Trigger).success
    assert graph.call("step", Step, 1).success


def test_stall_ends_with_status_1_and_names_the_node(graph):
    bridge = graph.start(BRIDGE, *LOCKSTEP, "_stall_timeout_s:=1.0")
    graph.start(CHAIN, "_mute_after_tick:=20")
    _, errors = bridge.communicate(timeout=DEADLINE_S)
    assert bridge.returncode == 1
    assert "stalled at tick 21 (sim time 1.050 s)" in errors
    assert "awaiting cmd_vel_nominal_stamped by waypoint_controller; expected 1.050 s, newest 1.000 s" in errors


def test_command_that_is_not_finite_makes_the_robot_stand_for_that_tick(graph):
    from nav_msgs.msg import Odometry

    odometry = graph.listen("odom", Odometry)
    bridge = graph.start(BRIDGE, *LOCKSTEP, "_start_paused:=true")
    graph.start(CHAIN, "_non_finite_tick:=20")
    graph.set_going()
    wait_for(lambda: len(odometry) > 60, "60 ticks")
    speeds = [m.twist.twist.linear.x for m in odometry[:60]]
    assert speeds == [0.0] + [0.3] * 19 + [0.0] + [0.3] * 39
    bridge.terminate()
    _, errors = bridge.communicate()
    assert errors.count("cmd_vel is not finite") == 1
    assert bridge.returncode == 0


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("_bakend:=kinematic", "world_bridge: ~bakend: unknown parameter"),
        ("_rtf:=-1", "world_bridge: ~rtf: got -1"),
        ("_task:=fly", "no task 'fly'; allowed: "),
        ("_world:=warehose", "no world 'warehose'; allowed:"),
        ("_robot:=/no/such.yaml", "/no/such.yaml"),
    ],
)
def test_bad_input_ends_with_status_2_and_one_line_before_anything_is_published(graph, argument, words):
    bridge = graph.start(BRIDGE, *LOCKSTEP, argument)
    _, errors = bridge.communicate(timeout=DEADLINE_S)
    assert bridge.returncode == 2
    assert words in errors
    assert len(errors.strip().splitlines()) == 1
    assert "/odom" not in [topic for topic, _ in rospy.get_published_topics()]


def test_realtime_world_runs_by_the_wall_clock_and_stands_when_commands_stop(graph):
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock

    odometry, clocks = graph.listen("odom", Odometry), graph.listen("/clock", Clock)
    graph.start(BRIDGE, "_backend:=kinematic", "_renderer:=none", "_cmd_vel_timeout_s:=0.3")
    command, publisher = Twist(), rospy.Publisher("cmd_vel", Twist, queue_size=1)
    command.linear.x = 0.4
    wait_for(lambda: odometry and publisher.get_num_connections(), "odometry and a listener to cmd_vel")
    count, sim_s, wall_s = len(clocks), clocks[-1].clock.to_sec(), time.monotonic()
    while time.monotonic() - wall_s < 2.0:
        publisher.publish(command)
        time.sleep(0.05)
    elapsed_s = time.monotonic() - wall_s
    assert (len(clocks) - count) / elapsed_s > 60.0
    assert (clocks[-1].clock.to_sec() - sim_s) / elapsed_s == pytest.approx(1.0, abs=0.1)
    assert odometry[-1].twist.twist.linear.x == 0.4
    wait_for(lambda: odometry[-1].twist.twist.linear.x == 0.0, "a stand", deadline_s=2.0)
