# SPDX-License-Identifier: BSD-3-Clause
"""Large flat faces are found, and look as if PyBullet's software renderer had drawn them."""

from dataclasses import replace

import numpy as np
import pytest
from simple_world import FLOOR_ID, ROBOT, make_mover, make_object, make_ramp, make_state, make_surface, make_world

from core_bringup import pybullet_render_worker
from core_bringup.drawn_mesh import DrawnMesh, box_mesh, read_mesh, surface_mesh
from core_bringup.exceptions import BringupError
from core_bringup.flat_faces import find_flat_faces
from core_bringup.pybullet_render_worker import FramePainter
from core_bringup.rotations import quaternion_of_rpy
from core_bringup.world import find_worlds_dir

MODELS = find_worlds_dir() / "models"
CAMERA = ROBOT.camera.model
WALL = 5


def polygon_area_m2(face):
    p = face.corners_m
    return 0.5 * np.linalg.norm(np.cross(p[2] - p[0], p[3] - p[1]))


def test_faces_of_a_box_are_its_sides():
    mesh = box_mesh((4.0, 0.2, 3.0))
    faces, covered = find_flat_faces(mesh, 0.0)
    assert covered.all()
    assert sorted(polygon_area_m2(face) for face in faces) == pytest.approx([0.6, 0.6, 0.8, 0.8, 12.0, 12.0])
    assert sum(abs(face.normal) for face in faces) == pytest.approx([2.0, 2.0, 2.0])
    large, covered = find_flat_faces(mesh, 0.7)
    assert len(large) == 4
    assert covered.sum() == 8
    assert find_flat_faces(DrawnMesh(np.zeros((0, 3, 8))), 0.0)[0] == []


@pytest.mark.parametrize("path", sorted(MODELS.glob("*.obj")), ids=lambda path: path.stem)
def test_faces_of_every_shipped_model_are_flat_convex_and_keep_texture_and_area(path):
    mesh = read_mesh(path)
    faces, covered = find_flat_faces(mesh, 0.01)
    corners = mesh.corners[covered]
    p = corners[:, :, :3]
    area_m2 = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    assert sum(polygon_area_m2(face) for face in faces) == pytest.approx(area_m2)
    points = {}
    for x, y, z, u, v, *normal in corners.reshape(-1, 8):
        points.setdefault(tuple(np.round([x, y, z, *normal], 4)), []).append((u, v))
    for face in faces:
        sides = np.roll(face.corners_m, -1, axis=0) - face.corners_m
        assert np.abs(sides @ face.normal).max() < 1e-4
        assert (np.cross(sides, np.roll(sides, -1, axis=0)) @ face.normal).min() > -1e-9
        for corner in face.corners_m:
            wanted = np.array(points[tuple(np.round([*corner, *face.normal], 4))])
            assert np.abs(wanted - face.uv_map @ [*corner, 1.0]).max(axis=1).min() < 1e-3


def test_round_bent_and_bent_in_pairs_are_no_quads():
    flat = box_mesh((1.0, 1.0, 1.0)).corners[:2]
    round_edge = flat.copy()
    round_edge[:, :, 5:] = [0.6, 0.8, 0.0]
    assert find_flat_faces(DrawnMesh(round_edge), 0.0)[0] == []
    skew = flat.copy()
    skew[1, 2, 3] += 0.3  # another texture coordinate at one corner
    bent_in = flat.copy()
    a, b, c = flat[0]
    bent_in[1, 2] = a + 2.0 * (b - a) + 2.5 * (c - b)
    for pair in (skew, bent_in):
        assert all(
            np.array_equal(face.corners_m[2], face.corners_m[3]) for face in find_flat_faces(DrawnMesh(pair), 0.0)[0]
        )


def build_world():
    """Walls beside, before and behind the camera, a slab, a ramp, a corner, a marking and a small box on it."""
    panel = replace(
        make_object(6, (12.0, 0.12, 2.7), (4.0, -1.2, 0.0), yaw_rad=0.1), shape="mesh", mesh=MODELS / "wall_panel.obj",
        mesh_scale=np.array([6.0, 1.0, 1.0]),
    )  # fmt: skip
    corner = replace(
        make_surface(11, (4.0, -1.0), (6.0, 0.0), z_m=0.05), polygon_m=np.array([[4, -1], [6, -1], [6, 0.0]])
    )
    surfaces = (
        make_surface(7, (1.0, -0.9), (3.5, 0.0), z_m=0.08, texture=MODELS / "textures" / "concrete.png"),
        make_ramp(8, (3.6, 0.2), (5.0, 1.0), 0.0, 0.15),
        make_surface(9, (1.5, 0.1), (3.0, 1.0), texture=MODELS / "textures" / "crosswalk.png"),
        corner,
    )
    items = (
        make_object(WALL, (14.0, 0.2, 3.0), (4.0, 1.2, 0.0)),
        panel,
        make_object(10, (0.3, 0.3, 0.3), (2.0, 0.5, 0)),
    )
    return make_world(*items, surfaces=surfaces)


def paint(monkeypatch, world, state, own_faces):
    with monkeypatch.context() as patch:
        if not own_faces:
            patch.setattr(pybullet_render_worker, "FacePainter", lambda *_: None)
        return FramePainter(world, ROBOT, CAMERA, "tiny").paint(state)


@pytest.mark.parametrize(
    ("place_m", "rpy_rad"),
    [((0.0, 0.01), (0.0, 0.0, 0.0)), ((2.0, 0.6), (0.3, 0.2, 0.7)), ((4.0, -0.3), (-0.2, -0.1, 2.6))],
)
def test_picture_is_that_of_pybullet(monkeypatch, place_m, rpy_rad):
    state = make_state(*place_m)
    state = replace(state, q_world_base=np.array(quaternion_of_rpy(*rpy_rad)))
    color, depth, labels = paint(monkeypatch, build_world(), state, own_faces=True)
    color_2, depth_2, labels_2 = paint(monkeypatch, build_world(), state, own_faces=False)
    assert len(np.unique(labels)) >= 4
    assert np.mean(labels != labels_2) < 5e-4
    same = (labels == labels_2) & (labels > 0)
    error_m = np.abs(depth - depth_2)[same & (depth_2 < 12.0)]
    assert np.quantile(error_m, 0.9999) < 1e-3
    difference = np.abs(color.astype(int) - color_2).max(axis=-1)
    assert np.mean(difference[same] > 1) < 1e-3


def wall_x_m(painter, state):
    """Median x of the points of the wall that are seen, state's heading being 0; NaN where it is not seen."""
    _, depth, labels = painter.paint(state)
    R, p = ROBOT.camera_mount.compute_optical_pose()
    u, v = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    rays = np.stack([(u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px, np.ones(u.shape)], axis=-1)
    x_m = state.p_world_base[0] + p[0] + depth * (rays @ R[0])
    return float(np.median(x_m[labels == WALL])) if np.any(labels == WALL) else np.nan


def test_faces_follow_an_object_that_is_moved_removed_and_put_back():
    wall = make_object(WALL, (0.2, 8.0, 3.0), (5.0, 0.0, 0.0))
    painter, state = FramePainter(make_world(wall), ROBOT, CAMERA, "tiny"), make_state()
    assert wall_x_m(painter, state) == pytest.approx(4.9, abs=1e-3)
    painter.scene.move_object(WALL, (7.0, 0.0, 0.0), np.pi)
    assert wall_x_m(painter, state) == pytest.approx(6.9, abs=1e-3)
    moved = replace(state, object_poses={WALL: ((6.0, 0.0, 0.0), 0.0)})
    assert wall_x_m(painter, moved) == pytest.approx(5.9, abs=1e-3)
    painter.scene.remove_object(WALL)
    assert np.isnan(wall_x_m(painter, state))
    painter.scene.add_object(replace(wall, position_m=np.array([4.0, 0.0, 0.0])))
    assert wall_x_m(painter, state) == pytest.approx(3.9, abs=1e-3)


def test_object_that_moves_by_itself_is_left_to_pybullet(monkeypatch):
    mover = make_mover(WALL, (0.2, 8.0, 1.7), (5.0, 0.0, 0.0), [[8.0, 0.0]], shape="box")
    painter = FramePainter(make_world(mover), ROBOT, CAMERA, "tiny")
    painter.paint(make_state())
    monkeypatch.setattr(painter._faces, "_collect", lambda: pytest.fail("all faces are laid out anew"))
    pose = (np.array([6.0, 0.0, 0.0]), 0.0)
    assert wall_x_m(painter, replace(make_state(), object_poses={WALL: pose})) == pytest.approx(5.9, abs=1e-3)


def test_shadows_fall_on_the_floor():
    world = make_world(make_object(WALL, (1.0, 1.0, 2.0), (3.0, 0.0, 0.0)))
    light = replace(world.lighting, shadow=True)
    color, _, labels = FramePainter(replace(world, lighting=light), ROBOT, CAMERA, "tiny").paint(make_state())
    assert len(np.unique(color[labels == FLOOR_ID][:, 0])) > 1
    color, _, labels = FramePainter(world, ROBOT, CAMERA, "tiny").paint(make_state())
    assert len(np.unique(color[labels == FLOOR_ID][:, 0])) == 1


def test_object_that_cannot_be_seen_hides_nothing():
    glass = replace(make_object(WALL, (0.2, 8.0, 3.0), (3.0, 0.0, 0.0)), color_rgba=np.array([1.0, 1.0, 1.0, 0.0]))
    labels = FramePainter(make_world(glass), ROBOT, CAMERA, "tiny").paint(make_state())[2]
    assert set(np.unique(labels)) == {0, FLOOR_ID}


def test_smaller_object_shows_where_two_faces_lie_in_one_plane():
    wall, board = make_object(WALL, (0.2, 8.0, 3.0), (5.0, 0.0, 0.0)), make_object(6, (0.2, 2.8, 2.0), (5.0, 0.0, 0.0))
    labels = FramePainter(make_world(wall, board), ROBOT, CAMERA, "tiny").paint(make_state())[2]
    board_rows = [np.flatnonzero(row == 6) for row in labels if np.any(row == 6)]
    assert len(board_rows) > 50
    assert all(row[-1] - row[0] + 1 == len(row) > 50 for row in board_rows)


def test_texture_that_cannot_be_read_is_refused(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"no picture")
    patch = make_surface(3, (1.0, -1.0), (2.0, 1.0), texture=tmp_path / "broken.png")
    with pytest.raises(BringupError, match=r"broken\.png"):
        FramePainter(make_world(surfaces=(patch,)), ROBOT, CAMERA, "tiny")


def test_degenerate_wall_of_a_ramp_is_no_face():
    faces, _ = find_flat_faces(surface_mesh(make_ramp(2, (0, 0), (2, 1), 0.0, 0.1)), 0.0)
    assert all(np.isfinite(face.uv_map).all() and abs(np.linalg.norm(face.normal) - 1.0) < 1e-9 for face in faces)
