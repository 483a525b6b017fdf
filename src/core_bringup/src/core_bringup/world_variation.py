# SPDX-License-Identifier: BSD-3-Clause
"""Draws one bounded variation of a world by a seed."""

from __future__ import annotations

from dataclasses import replace
from typing import Optional, Tuple

import numpy as np

from core_bringup.world_build import freeze
from core_bringup.world_types import Lighting, Surface, World, WorldObject

# Each thing has a random stream of its own, so that one more object changes nothing else.
_OBJECT_STREAM, _SURFACE_STREAM, _LIGHT_STREAM = 1, 2, 3


def vary_world(world: World, task_name: str, seed: int) -> Tuple[World, np.ndarray]:
    """Draw one bounded variation of the world of a task and of the task's start.

        start_pose = nominal + u * start_variation,  u uniform in [-1, 1]^3

    Objects that declare jitter are shifted along x and y and turned the same way, and stay away with probability
    1 - presence; the light's azimuth and coefficients move within the world's variation; a surface takes one of its
    textures; the camera's noise gets the seed. Seed 0 is the world as written, without noise.

    Returns:
        World as World.for_task gives it, start_pose (3,) x [m], y [m], yaw [rad].

    Raises:
        ConfigError: unknown task. ValueError: negative seed.
    """
    task = world.task(task_name)
    if seed < 0:
        raise ValueError(f"seed must be >= 0, got {seed}")
    world = world.for_task(task_name)
    if seed == 0:
        return world, task.start_pose.copy()
    start_pose = task.start_pose + _stream(seed).uniform(-1.0, 1.0, 3) * task.start_variation
    varied = (_vary_object(item, seed) for item in world.objects)
    world = world.with_objects([item for item in varied if item is not None], task_name)
    noise = replace(world.camera_noise, seed=seed)
    return replace(
        world,
        surfaces=tuple(_vary_surface(surface, seed) for surface in world.surfaces),
        lighting=_vary_lighting(world, _stream(seed, _LIGHT_STREAM).uniform(-1.0, 1.0, 3)),
        variation=replace(world.variation, camera_noise=noise),
    ), start_pose


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64((seed, *key) if key else seed))


def _vary_object(item: WorldObject, seed: int) -> Optional[WorldObject]:
    stream = _stream(seed, _OBJECT_STREAM, item.id)
    u, is_present = stream.uniform(-1.0, 1.0, 3), stream.uniform() < item.presence
    if not is_present:
        return None
    if item.jitter_m == 0.0 and item.jitter_yaw_rad == 0.0:
        return item
    shift_m = np.array([u[0] * item.jitter_m, u[1] * item.jitter_m, 0.0])
    yaw_rad = item.yaw_rad + float(u[2]) * item.jitter_yaw_rad
    return replace(item, position_m=freeze(item.position_m + shift_m), yaw_rad=yaw_rad)


def _vary_surface(surface: Surface, seed: int) -> Surface:
    if len(surface.textures) < 2:
        return surface
    chosen = int(_stream(seed, _SURFACE_STREAM, surface.id).integers(len(surface.textures)))
    return replace(surface, texture=surface.textures[chosen])


def _vary_lighting(world: World, u: np.ndarray) -> Lighting:
    light, largest = world.lighting, world.variation
    turn = float(u[0]) * largest.light_azimuth_rad
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = light.direction
    return replace(
        light,
        direction=freeze((c * x - s * y, s * x + c * y, z)),
        ambient=float(np.clip(light.ambient + u[1] * largest.light_ambient, 0.0, 1.0)),
        diffuse=float(np.clip(light.diffuse + u[2] * largest.light_diffuse, 0.0, 1.0)),
    )
