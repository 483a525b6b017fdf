# SPDX-License-Identifier: BSD-3-Clause
"""The node world_bridge: a simulated robot on the topics of a real one."""

from __future__ import annotations

import sys
import threading
from typing import List

import rospy

from core_bringup.exceptions import BringupError, ConfigError
from core_bringup.params import BridgeParams
from core_bringup.ros.bridge_loops import BridgeLoop, LockstepLoop, RealtimeLoop
from core_bringup.ros.bridge_publishers import BridgePublishers
from core_bringup.ros.bridge_services import BridgeServices
from core_bringup.run_control import RunControl
from core_bringup.simulation import Simulation

NODE = "world_bridge"
EXIT_OK, EXIT_FAILED, EXIT_BAD_INPUT = 0, 1, 2
LOG_FLUSH_S = 0.5
JOIN_POLL_S = 0.2


def run_bridge(params: BridgeParams, simulation: Simulation) -> None:
    """Publish, serve and loop until the node ends; BringupError when the chain stalls or the renderer dies."""
    control = RunControl(params.start_paused)
    rospy.on_shutdown(control.end)
    publishers = BridgePublishers(simulation, params)
    loop = (LockstepLoop if params.lockstep else RealtimeLoop)(simulation, params, publishers, control)
    BridgeServices(control, lambda: loop.stamp_ns, params.stall_timeout_s)
    rospy.loginfo(
        "world %s, task %s, seed %d: %s, renderer %s, %s", simulation.world.name, params.task, params.seed,
        params.backend, params.renderer, "lock-step" if params.lockstep else f"rtf {params.rtf:g}",
    )  # fmt: skip
    _run_in_thread(loop)


def _run_in_thread(loop: BridgeLoop) -> None:
    """Run the loop beside the main thread, and raise here what it raises.

    rospy handles signals in the main thread and closes every publisher there; a loop interrupted while it publishes
    would hold the lock that the handler waits for.
    """
    errors: List[Exception] = []

    def run() -> None:
        try:
            loop.run()
        except Exception as error:  # noqa: BLE001 - handed on, not swallowed
            errors.append(error)

    thread = threading.Thread(target=run, name="world", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(JOIN_POLL_S)
    if errors:
        raise errors[0]


def main() -> int:
    """Exit status: 0 ended from outside, 1 the chain stalled or a child process died, 2 bad input."""
    rospy.init_node(NODE)
    simulation = None
    try:
        params = BridgeParams.from_dict(rospy.get_param("~", {}), NODE)
        simulation = Simulation(params)
        run_bridge(params, simulation)
    except ConfigError as error:
        # One write: print() would write the end of the line apart, and other nodes' lines come in between.
        sys.stderr.write(f"{error}\n" if error.source == NODE else f"{NODE}: {error}\n")
        return EXIT_BAD_INPUT
    except BringupError as error:
        if rospy.is_shutdown():
            return EXIT_OK
        rospy.logfatal("%s", error)
        rospy.rostime.wallsleep(LOG_FLUSH_S)  # let the message out on /rosout
        return EXIT_FAILED
    except rospy.ROSException:
        if not rospy.is_shutdown():
            raise
    finally:
        if simulation is not None:
            simulation.close()
    return EXIT_OK
