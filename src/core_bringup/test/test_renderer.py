# SPDX-License-Identifier: BSD-3-Clause
"""The simulated camera: its images back-project exactly, carry the right labels, and its process dies cleanly."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pybullet
import pytest
from simple_world import FLOOR_ID, ROBOT, make_mover, make_object, make_ramp, make_state, make_surface, make_world

from core_bringup.exceptions import BringupError
from core_bringup.pybullet_render_worker import SKY_RGB
from core_bringup.pybullet_renderer import PybulletRenderer
from core_bringup.pybullet_scene import PybulletScene, write_urdf
from core_bringup.robot import CameraMount
from core_bringup.world_types import CameraNoise, Variation

BOX, WALL, PATCH = 10, 12, 2
WORLD = make_world(
    make_object(BOX, (0.6, 0.4, 0.4), (3.0, 0.5, 0.0), yaw_rad=0.4),
    make_object(WALL, (0.2, 8.0, 3.0), (9.0, 0.0, 0.0)),
    surfaces=(make_surface(PATCH, (1.5, -1.0), (2.5, 0.0), z_m=0.004),),
)
STATE = make_state(0.3, 0.1, 0.1)
CAMERA = ROBOT.camera.model


@pytest.fixture(scope="module")
def renderer():
    renderer = PybulletRenderer(WORLD, ROBOT)
    yield renderer
    renderer.close()


@pytest.fixture(scope="module")
def frame(renderer):
    return renderer.render(STATE)


def world_rays(state):
    """Camera centre (3,) and direction (h, w, 3) of every pixel, one metre along the optical axis."""
    R_base_optical, p_base_optical = ROBOT.camera_mount.compute_optical_pose()
    R = np.array(pybullet.getMatrixFromQuaternion(state.q_world_base)).reshape(3, 3)
    u, v = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    rays = np.stack(
        [(u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px, np.ones_like(u, dtype=float)], axis=-1
    )
    return state.p_world_base + R @ p_base_optical, rays @ (R @ R_base_optical).T


def away_from_edges(labels, width_px=1):
    """Pixels whose neighbours all carry their label."""
    same = np.zeros(labels.shape, dtype=bool)
    inner = (slice(width_px, -width_px),) * 2
    same[inner] = True
    for dv in range(-width_px, width_px + 1):
        for du in range(-width_px, width_px + 1):
            same &= np.roll(labels, (dv, du), axis=(0, 1)) == labels
    return same


@pytest.mark.parametrize(("label", "height_m"), [(FLOOR_ID, 0.0), (PATCH, 0.004)])
def test_depth_of_a_horizontal_plane_is_analytic(frame, label, height_m):
    centre, rays = world_rays(STATE)
    with np.errstate(divide="ignore"):
        depth = (height_m - centre[2]) / rays[..., 2]
    mask = (frame.labels == label) & (depth < 12.0)
    assert mask.sum() > 10000
    assert np.abs(frame.depth_m - depth)[mask].max() <= 1e-3


def test_depth_of_a_wall_is_analytic(frame):
    centre, rays = world_rays(STATE)
    mask = frame.labels == WALL
    assert mask.sum() > 10000
    assert np.abs(frame.depth_m - (8.9 - centre[0]) / rays[..., 0])[mask].max() <= 1e-3


def test_depth_and_labels_agree_with_ray_casts(frame):
    client = pybullet.connect(pybullet.DIRECT)
    path = write_urdf(ROBOT)
    scene = PybulletScene(client, WORLD, path, visual=False)
    path.unlink()
    scene.set_robot((50.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0), np.zeros(12))
    centre, rays = world_rays(STATE)
    v, u = np.nonzero(away_from_edges(frame.labels))
    chosen = np.random.default_rng(0).permutation(len(u))[:4000]
    v, u = v[chosen], u[chosen]
    ends = centre + CAMERA.far_m * rays[v, u]
    hits = pybullet.rayTestBatch([centre.tolist()] * len(u), ends.tolist(), physicsClientId=client)
    labels = scene.label_of_body
    pybullet.disconnect(client)
    expected = np.array([labels.get(hit[0], 0) for hit in hits])
    # Beyond the floor's edge the ray still meets its endless collision plane.
    drawn = (frame.labels[v, u] != 0) | (expected != FLOOR_ID)
    np.testing.assert_array_equal(frame.labels[v, u][drawn], expected[drawn])
    depth = np.array([hit[2] * CAMERA.far_m for hit in hits])
    error = np.abs(frame.depth_m[v, u] - depth)
    for label in (FLOOR_ID, WALL, BOX):
        seen = (frame.labels[v, u] == label) & (depth < 12.0)
        assert seen.sum() > 50
        # a pixel on the edge between two faces of the box may show either face
        assert np.quantile(error[seen], 0.97) <= 1e-3
        assert error[seen].max() <= (1e-2 if label == BOX else 1e-3)


def test_sky_has_no_label_no_depth_and_the_colour_of_the_sky(frame):
    sky = np.isnan(frame.depth_m)
    assert sky.any()
    np.testing.assert_array_equal(sky, frame.labels == 0)
    assert np.all(frame.color[sky] == SKY_RGB)


def test_image_types_and_shapes(frame):
    assert (frame.color.dtype, frame.depth_m.dtype, frame.labels.dtype) == (np.uint8, np.float32, np.uint16)
    assert (frame.color.shape, frame.depth_m.shape, frame.labels.shape) == ((320, 500, 3), (320, 500), (320, 500))
    assert set(np.unique(frame.labels)) == {0, FLOOR_ID, PATCH, BOX, WALL}


def test_surfaces_show_their_colour(frame):
    floor = frame.color[frame.labels == FLOOR_ID].mean(axis=0)
    assert 60 < floor[0] < 230
    assert floor[0] > floor[2] + 5
    assert frame.color[frame.labels == BOX].mean(axis=0)[0] > 1.5 * frame.color[frame.labels == BOX].mean(axis=0)[1]


def test_same_state_gives_the_same_images_in_another_process(frame):
    other = PybulletRenderer(WORLD, ROBOT)
    again = other.render(STATE)
    other.close()
    np.testing.assert_array_equal(frame.color, again.color)
    np.testing.assert_array_equal(frame.depth_m, again.depth_m)
    np.testing.assert_array_equal(frame.labels, again.labels)


def test_pixels_of_the_robot_itself_are_masked():
    mount = CameraMount(x_m=-0.2, y_m=0.0, z_m=0.4, roll_rad=0.0, pitch_rad=0.3, yaw_rad=0.0)
    robot = replace(ROBOT, camera=replace(ROBOT.camera, mount=mount))
    renderer = PybulletRenderer(make_world(), robot)
    frame = renderer.render(make_state())
    renderer.close()
    robot_pixels = (frame.labels == 0) & ~np.all(frame.color == SKY_RGB, axis=-1)
    assert robot_pixels[200:, 200:300].mean() > 0.3
    assert np.all(np.isnan(frame.depth_m[robot_pixels]))


def test_texture_of_a_surface_is_drawn_and_repeats(tmp_path):
    cv2 = pytest.importorskip("cv2")
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, :32] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "stripes.png"), image)
    striped = make_surface(2, (1.0, -3.0), (6.0, 3.0), z_m=0.001, texture=tmp_path / "stripes.png")
    renderer = PybulletRenderer(make_world(surfaces=(striped,)), ROBOT)
    frame = renderer.render(make_state())
    renderer.close()
    red = frame.color[frame.labels == 2][:, 0].astype(int)
    assert 0.3 < np.mean(red > 100) < 0.7
    assert np.count_nonzero(np.diff((frame.color[:, 250, 0] > 100).astype(int))) >= 4


def test_frames_come_back_in_order(renderer):
    for yaw in (0.0, 0.4):
        renderer.submit(make_state(yaw_rad=yaw))
    first, second = renderer.collect(), renderer.collect()
    np.testing.assert_array_equal(first.depth_m, renderer.render(make_state()).depth_m)
    assert not np.array_equal(first.labels, second.labels)
    with pytest.raises(BringupError, match="no frame was submitted"):
        renderer.collect()


def test_object_appears_moves_and_disappears(renderer):
    renderer.add_object(make_object(77, (0.4, 0.4, 0.4), (2.0, 0.0, 0.0)))
    before = np.argwhere(renderer.render(make_state()).labels == 77).mean(axis=0)
    renderer.move_object(77, (2.0, 0.8, 0.0), 0.3)
    after = np.argwhere(renderer.render(make_state()).labels == 77).mean(axis=0)
    assert after[1] < before[1] - 50  # to the left is to smaller u
    renderer.remove_object(77)
    assert not np.any(renderer.render(make_state()).labels == 77)
    with pytest.raises(BringupError, match="unknown"):
        renderer.remove_object(77)


def test_death_of_the_child_is_a_clear_error():
    renderer = PybulletRenderer(make_world(), ROBOT)
    renderer._process.kill()
    with pytest.raises(BringupError, match="renderer process .* died"):
        renderer.render(make_state())
    renderer.close()
    renderer.close()


def test_child_dies_with_its_parent():
    code = (
        "import os, sys; from simple_world import *; from core_bringup.pybullet_renderer import PybulletRenderer;"
        "r = PybulletRenderer(make_world(), ROBOT); print(r._process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, sys.path)))
    child = int(
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True).stdout.split()[-1]
    )
    deadline = time.monotonic() + 5.0
    while _is_running(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _is_running(child)


def _is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:  # noqa: PTH123
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_interrupt_does_not_kill_the_child():
    renderer = PybulletRenderer(make_world(), ROBOT)
    renderer._process.send_signal(signal.SIGINT)
    assert renderer.render(make_state()).labels.any()
    renderer.close()


def test_unknown_renderer_and_broken_mesh_are_refused(tmp_path):
    with pytest.raises(BringupError, match="allowed tiny, egl"):
        PybulletRenderer(make_world(), ROBOT, renderer="vulkan")
    broken = replace(make_object(5, (1, 1, 1), (3, 0, 0)), shape="mesh", mesh=tmp_path / "none.obj")
    with pytest.raises(BringupError, match="object_5"):
        PybulletRenderer(make_world(broken), ROBOT)


def test_egl_draws_the_same_labels_or_says_that_it_cannot(frame):
    try:
        egl = PybulletRenderer(WORLD, ROBOT, renderer="egl")
    except BringupError as error:
        assert "egl" in str(error).lower()
        return
    other = egl.render(STATE)
    egl.close()
    same = away_from_edges(frame.labels)
    assert np.mean(frame.labels[same] == other.labels[same]) > 0.999
    seen = same & (frame.labels != 0) & (frame.depth_m < 7.0)
    assert np.median(np.abs(frame.depth_m - other.depth_m)[seen]) < 0.01


def test_patch_as_high_as_the_floor_hides_it():
    renderer = PybulletRenderer(make_world(surfaces=(make_surface(3, (1.0, -3.0), (4.0, 3.0)),)), ROBOT)
    labels = renderer.render(make_state()).labels
    renderer.close()
    assert np.all(labels[250:, 200:300] == 3)


def test_ramp_and_curb_are_drawn_where_they_are():
    """Depth of the slope, of the level above it and of the wall in front is analytic."""
    ramp, walk = make_ramp(3, (2.0, 0.0), (3.5, 1.5), 0.0, 0.15), make_surface(4, (2.5, -3.0), (6.0, -0.2), z_m=0.15)
    renderer = PybulletRenderer(make_world(surfaces=(ramp, walk)), ROBOT)
    state = make_state()
    frame = renderer.render(state)
    renderer.close()
    centre, rays = world_rays(state)
    on_ramp = frame.labels == 3
    assert on_ramp.sum() > 2000
    # the plane z = 0.1 (x - 2):  c_z + t r_z = 0.1 (c_x + t r_x - 2)
    depth = (0.1 * (centre[0] - 2.0) - centre[2]) / (rays[..., 2] - 0.1 * rays[..., 0])
    points = centre + depth[..., None] * rays
    slope = on_ramp & away_from_edges(frame.labels) & (np.abs(points[..., 1] - 0.75) < 0.7)
    assert slope.sum() > 1500
    assert np.abs(frame.depth_m - depth)[slope].max() <= 2e-3
    x, y, z = np.moveaxis(centre + frame.depth_m[..., None] * rays, -1, 0)
    walked = (frame.labels == 4) & away_from_edges(frame.labels)
    wall = walked & (z < 0.13)
    assert wall.sum() > 150
    assert z[wall].min() > -1e-3
    assert np.minimum(np.abs(x - 2.5), np.abs(y + 0.2))[wall].max() < 0.01  # its front and its left side
    assert min(np.sum(wall & (np.abs(side) < 0.01)) for side in (x - 2.5, y + 0.2)) > 50
    level = walked & ~wall & (x > 2.55) & (y < -0.25)
    assert level.sum() > 5000
    assert np.abs(z - 0.15)[level].max() < 2e-3


def test_moving_object_is_drawn_where_the_state_has_it():
    item = make_mover(5, (0.5, 0.5, 1.7), (3.0, 1.0, 0.0), [[3.0, -2.0]])
    renderer = PybulletRenderer(make_world(item), ROBOT)
    for y_m in (1.0, 0.0, -1.0, 0.5):
        frame = renderer.render(replace(make_state(), object_poses={5: (np.array([3.0, y_m, 0.0]), 0.0)}))
        column = np.argwhere(frame.labels == 5)[:, 1].mean()
        expected = CAMERA.cx_px - CAMERA.fx_px * y_m / (3.0 - ROBOT.camera_mount.x_m)
        assert abs(column - expected) < 12
    renderer.close()


def test_noise_is_on_colour_and_depth_never_on_labels():
    noise = CameraNoise(color_sigma=0.02, depth_sigma_per_m2=0.003, depth_dropout=0.05, seed=4)
    renderer = PybulletRenderer(replace(WORLD, variation=Variation(camera_noise=noise)), ROBOT)
    first, again = renderer.render(STATE), renderer.render(STATE)
    later = renderer.render(replace(STATE, time_s=0.1))
    renderer.close()
    clean = PybulletRenderer(WORLD, ROBOT)
    truth = clean.render(STATE)
    clean.close()
    np.testing.assert_array_equal(first.labels, truth.labels)
    np.testing.assert_array_equal(np.isnan(first.depth_m), np.isnan(truth.depth_m))
    assert 0.04 < np.mean(first.depth_m[truth.labels > 0] == 0.0) < 0.06
    assert np.mean(first.color != truth.color) > 0.8
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth_m, again.depth_m)
    assert not np.array_equal(first.color, later.color)
