# SPDX-License-Identifier: BSD-3-Clause
"""Walks a little and prints the SHA-256 of every state; test_pybullet_backend runs it in fresh processes."""

import hashlib
import sys

import numpy as np
from simple_world import ROBOT, make_object, make_world

from core_bringup.pybullet_backend import PybulletBackend


def compute_walk_hash(seed):
    backend = PybulletBackend(make_world(make_object(5, (0.3, 0.3, 0.3), (0.9, 0.1, 0.0))), ROBOT, seed=seed)
    digest = hashlib.sha256()
    for command in ([0.5, 0.0, 0.0], [0.3, 0.2, -0.5], [0.0, 0.0, 0.0]):
        for _ in range(20):
            state = backend.step(np.array(command), 0.05)
            digest.update(
                np.concatenate([state.p_world_base, state.q_world_base, state.v_base, state.w_base]).tobytes()
            )
            digest.update(state.joint_positions_rad.tobytes())
    backend.close()
    return digest.hexdigest()


if __name__ == "__main__":
    print(compute_walk_hash(int(sys.argv[1])))
