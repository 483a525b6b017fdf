# SPDX-License-Identifier: BSD-3-Clause
"""Long triangles are divided without a gap, and the picture stays what it was."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from simple_world import ROBOT, make_object, make_ramp, make_state, make_surface, make_world

from core_bringup import pybullet_render_worker, pybullet_scene
from core_bringup.drawn_mesh import DrawnMesh, box_mesh, read_mesh, surface_mesh
from core_bringup.pybullet_render_worker import FramePainter
from core_bringup.world import find_worlds_dir

MODELS = find_worlds_dir() / "models"


def normals(mesh):
    """(n, 3) normals of the triangles, as long as twice their areas."""
    p = mesh.corners[:, :, :3]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def edges(mesh):
    """Directed edges as pairs of rounded points."""
    p = [[tuple(np.round(point, 9)) for point in triangle] for triangle in mesh.corners[:, :, :3].tolist()]
    return [(a, b) for t in p for a, b in zip(t, t[1:] + t[:1])]


@pytest.mark.parametrize("size_m", [(18.0, 0.2, 3.4), (1.0, 1.0, 1.0), (30.0, 20.0, 0.1)])
def test_division_keeps_the_solid_closed_and_its_edges_short(size_m):
    whole = box_mesh(size_m)
    for mesh in (whole, whole.divide(1.5)):
        directed = edges(mesh)
        assert len(set(directed)) == len(directed)
        assert {(b, a) for a, b in directed} == set(directed)  # every edge has its other side: no gap, no T-junction
        n = normals(mesh)
        assert np.linalg.norm(n, axis=1).sum() / 2 == pytest.approx(
            2 * (size_m[0] * size_m[1] + size_m[1] * size_m[2] + size_m[0] * size_m[2])
        )
        np.testing.assert_allclose(n / np.linalg.norm(n, axis=1)[:, None], mesh.corners[:, 0, 5:], atol=1e-9)
    lengths = [np.linalg.norm(np.subtract(a, b)) for a, b in edges(whole.divide(1.5))]
    assert max(lengths) <= 1.5
    assert whole.divide(100.0).corners.shape == whole.corners.shape


def test_scale_counts_for_the_division_and_the_normals():
    divided = box_mesh((1.0, 1.0, 1.0)).divide(1.0, (8.0, 1.0, 1.0))
    assert len(divided.corners) > 60
    slanted = DrawnMesh(
        np.array([[[0, 0, 0, 0, 0, 0.6, 0, 0.8], [0, 1, 0, 0, 0, 0.6, 0, 0.8], [-0.8, 0, 0.6, 0, 0, 0.6, 0, 0.8]]])
    )
    stretched = slanted.scaled((3.0, 1.0, 1.0))
    n = normals(stretched)[0]
    np.testing.assert_allclose(abs(n / np.linalg.norm(n)), stretched.corners[0, 0, 5:], atol=1e-9)


@pytest.mark.parametrize("path", sorted(MODELS.glob("*.obj")), ids=lambda path: path.stem)
def test_every_shipped_model_reads_back_as_it_was_written(path, tmp_path):
    mesh = read_mesh(path)
    assert mesh.texture.is_file()
    (tmp_path / "again.obj").write_text("mtllib x.mtl\n" + mesh.obj_text())
    (tmp_path / "x.mtl").write_text(f"newmtl x\nKd 1 1 1\nmap_Kd {mesh.texture}\n")
    again = read_mesh(tmp_path / "again.obj")
    np.testing.assert_allclose(again.corners, mesh.corners, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("x.obj", "\nf ", "\nf 1/1/1 "), ("x.obj", "\nf ", "\nf -"), ("x.mtl", "Kd 1 1 1\n", "Kd 1 0 0\n"),
     ("x.mtl", "map_Kd", "map_Bump"), ("x.obj", "mtllib", "mtl"), ("x.obj", "\nvt ", "\nv  ")],
)  # fmt: skip
def test_any_other_file_is_left_to_the_renderer(tmp_path, file, old, new):
    text = (MODELS / "traffic_cone.obj").read_text().replace("mtllib traffic_cone.mtl", "mtllib x.mtl")
    (tmp_path / "x.obj").write_text(text)
    (tmp_path / "x.mtl").write_text((MODELS / "traffic_cone.mtl").read_text())
    shutil.copytree(MODELS / "textures", tmp_path / "textures")
    assert read_mesh(tmp_path / "x.obj") is not None
    content = (tmp_path / file).read_text()
    assert old in content
    (tmp_path / file).write_text(content.replace(old, new))
    assert read_mesh(tmp_path / "x.obj") is None


def test_surface_has_walls_where_it_is_higher_than_the_floor():
    marking, slab = make_surface(2, (0, 0), (2, 1), z_m=0.004), make_surface(2, (0, 0), (2, 1), z_m=0.3)
    assert len(surface_mesh(marking).corners) == 2
    assert len(surface_mesh(slab).corners) == 10
    assert surface_mesh(slab).corners[:, :, 2].min() == pytest.approx(-0.3)
    ramp = surface_mesh(make_ramp(2, (0, 0), (2, 1), 0.0, 0.1))
    assert ramp.corners[:, :, 2].min() == 0.0
    assert np.all(normals(ramp)[:2, 2] > 0.0)
    outward = normals(surface_mesh(slab))[2:]
    middles = surface_mesh(slab).corners[2:, :, :2].mean(axis=1) - [1.0, 0.5]
    assert np.all(np.sum(outward[:, :2] * middles, axis=1) > 0.0)


def test_picture_is_the_same_with_and_without_division(monkeypatch):
    wall = make_object(5, (14.0, 0.2, 3.0), (4.0, 1.2, 0.0))
    panel = replace(
        make_object(6, (12.0, 0.12, 2.7), (4.0, -1.5, 0.0)), shape="mesh", mesh=MODELS / "wall_panel.obj",
        mesh_scale=np.array([6.0, 1.0, 1.0]),
    )  # fmt: skip
    slab = make_surface(7, (1.0, -1.0), (9.0, 0.0), z_m=0.08, texture=MODELS / "textures" / "concrete.png")
    monkeypatch.setattr(pybullet_render_worker, "FacePainter", lambda *_: None)  # all by PyBullet
    pictures = []
    for longest_m in (1000.0, 1.0):
        monkeypatch.setattr(pybullet_scene, "_LONGEST_EDGE_M", longest_m)
        painter = FramePainter(make_world(wall, panel, surfaces=(slab,)), ROBOT, ROBOT.camera.model, "tiny")
        pictures.append(painter.paint(make_state()))
    (color, depth, labels), (color_2, depth_2, labels_2) = pictures
    assert set(np.unique(labels)) == {0, 1, 5, 6, 7}
    assert np.mean(labels != labels_2) < 2e-3
    same = labels == labels_2
    assert np.nanmax(np.abs(depth - depth_2)[same & (depth < 10.0)]) < 2e-3
    assert np.mean(np.abs(color.astype(int) - color_2)[same].max(axis=-1) > 8) < 5e-3
