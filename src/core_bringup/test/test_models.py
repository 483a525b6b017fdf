# SPDX-License-Identifier: BSD-3-Clause
"""The models of the worlds: the files are what their script makes, and the catalogue tells the truth about them."""

import dataclasses
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest
import yaml
from simple_world import make_object

from core_bringup.touched import object_outlines_m
from core_bringup.world import find_worlds_dir
from core_bringup.world_schema import OBJECT_CLASSES

MODELS = find_worlds_dir() / "models"
CATALOGUE = yaml.safe_load((MODELS / "models.yaml").read_text(encoding="utf-8"))
MESHES = sorted(path.stem for path in MODELS.glob("*.obj"))
MAX_TRIANGLES = 600
PIXEL_M, MARGIN_M = 0.01, 0.2  # of the pictures from above
HIGHEST_M = 0.9  # of the robot
MOST_OPEN_M, MOST_OUT_M = 0.10, 0.04
# Limbs of a person move about its cylinder, and the foot of a drip stand is a star.
NOT_AS_DRAWN = ("person_standing", "person_walking", "person_worker", "nurse", "iv_stand")


def read_png(path):
    """The (h, w, 3) image of a PNG as write_png writes it: 8 bits, three channels, no filter."""
    data, place, packed = path.read_bytes(), 8, b""
    while place < len(data):
        length, tag = struct.unpack(">I4s", data[place : place + 8])
        chunk = data[place + 8 : place + 8 + length]
        if tag == b"IHDR":
            width, height, depth, color_type = struct.unpack(">IIBB", chunk[:10])
            assert (depth, color_type) == (8, 2)
        packed += chunk if tag == b"IDAT" else b""
        place += 12 + length
    rows = np.frombuffer(zlib.decompress(packed), dtype=np.uint8).reshape(height, 1 + 3 * width)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 3).astype(int)


def read_obj(name):
    """Corners (n, 3) and triangles (m, 3, 3) of NAME.obj [m], and its normals (m, 3, 3)."""
    lines = [line.split() for line in (MODELS / f"{name}.obj").read_text().splitlines()]
    corners, normals = (np.array([x[1:] for x in lines if x[0] == tag], dtype=float) for tag in ("v", "vn"))
    faces = np.array([[corner.split("/") for corner in x[1:]] for x in lines if x[0] == "f"], dtype=int) - 1
    assert faces.shape[1:] == (3, 3)
    return corners, corners[faces[:, :, 0]], normals[faces[:, :, 2]]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    subprocess.run([sys.executable, "-B", str(MODELS / "make_models.py"), str(folder)], check=True, timeout=120)
    return folder


def test_models_are_what_their_script_makes(made):
    names = {p.relative_to(made) for p in made.rglob("*") if p.is_file()}
    shipped = {p.relative_to(MODELS) for p in MODELS.rglob("*") if p.suffix in (".obj", ".mtl", ".png")}
    assert len(names) > 10
    assert names == shipped
    for name in sorted(names):
        if name.suffix == ".png":
            # zlib may pack otherwise and the FFT may round otherwise, by version
            assert np.abs(read_png(made / name) - read_png(MODELS / name)).max() <= 1, name
        else:
            assert (made / name).read_text() == (MODELS / name).read_text(), name


def test_the_catalogue_names_every_mesh_and_every_mesh_is_there():
    assert sorted(entry["mesh"] for entry in CATALOGUE.values()) == [f"{name}.obj" for name in MESHES]
    for name, entry in CATALOGUE.items():
        assert entry["class"] in OBJECT_CLASSES, name
        assert entry["mesh"] == f"{name}.obj"
        assert entry["shape"] == "mesh", name


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_as_large_as_the_catalogue_says(name):
    corners, _, _ = read_obj(name)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size_m = np.array(CATALOGUE[name]["size_m"])
    np.testing.assert_allclose(high - low, size_m, rtol=0.02)
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.abs(low + high)[:2] <= 0.02 * size_m[:2])


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_light_and_its_triangles_face_the_way_of_their_normals(name):
    _, triangles, normals = read_obj(name)
    assert len(triangles) <= MAX_TRIANGLES
    turned = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    assert np.einsum("ij,ikj->ik", turned, normals).min() > 0.0
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-3)


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_has_one_texture_and_it_is_there(name):
    material = (MODELS / f"{name}.mtl").read_text().split("\n")
    textures = [line.split()[1] for line in material if line.startswith("map_Kd")]
    assert len(textures) == 1
    assert (MODELS / textures[0]).is_file()


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_what_collides_is_within_what_is_drawn(name):
    """A person is drawn narrower than it collides; parts are held within size_m by the loader."""
    entry = CATALOGUE[name]
    size_m, collision_m = np.array(entry["size_m"]), np.array(entry.get("collision_size_m", entry["size_m"]))
    if entry["collision"] == "cylinder":
        assert collision_m[0] == collision_m[1]
    if entry["class"] != "person":
        assert np.all(collision_m <= size_m)


def fill_from_above(polygons_m, half_m):
    """Picture of what polygons (n, 2 or 3) cover within +- half_m (2,) and a margin."""
    size_px = np.ceil(2.0 * (np.asarray(half_m) + MARGIN_M) / PIXEL_M).astype(int)
    picture = np.zeros(size_px[::-1], np.uint8)
    for polygon_m in polygons_m:
        corners_px = np.round((np.asarray(polygon_m)[:, :2] / PIXEL_M + 0.5 * size_px - 0.5) * 16).astype(np.int32)
        cv2.fillPoly(picture, [corners_px], 1, shift=4)
        cv2.polylines(picture, [corners_px], True, 1, shift=4)  # what is upright has no area from above
    return picture


def cut_below(triangles, height_m):
    """What of triangles (m, 3, 3) lies below a height."""
    cut = []
    for triangle in triangles:
        kept = []
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0)):
            kept += [a] if a[2] <= height_m else []
            if (a[2] - height_m) * (b[2] - height_m) < 0.0:
                kept.append(a + (b - a) * (height_m - a[2]) / (b[2] - a[2]))
        cut += [np.array(kept)] if kept else []
    return cut


def farthest_m(places, picture):
    """Largest distance of set pixels to those of a picture."""
    return float((cv2.distanceTransform(1 - picture, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * PIXEL_M)[places > 0].max())


@pytest.mark.parametrize("name", [name for name in MESHES if name not in NOT_AS_DRAWN])
def test_within_the_height_of_the_robot_what_is_touched_is_what_is_drawn(name):
    """The world must not lie: no invisible wall wider than MOST_OPEN_M, and nothing to walk through."""
    entry, half_m = CATALOGUE[name], 0.5 * np.array(CATALOGUE[name]["size_m"][:2])
    item = dataclasses.replace(
        make_object(5, entry["size_m"], (0.0, 0.0, 0.0)),
        collision=entry["collision"],
        collision_size_m=np.array(entry.get("collision_size_m", entry["size_m"])),
        collision_parts_m=np.array(entry.get("collision_parts_m", ())).reshape(-1, 6),
    )
    touched = fill_from_above(object_outlines_m(item, high_m=HIGHEST_M), half_m)
    drawn = fill_from_above(cut_below(read_obj(name)[1], HIGHEST_M), half_m)
    border = touched - cv2.erode(touched, np.ones((3, 3), np.uint8))
    assert farthest_m(border, drawn) <= MOST_OPEN_M
    assert farthest_m(drawn, touched) <= MOST_OUT_M


@pytest.mark.parametrize("name", [name for name in MESHES if name.startswith("storage_rack")])
def test_nobody_looks_through_the_end_of_a_rack(name):
    """The lowest pallets have ends: without, a camera sees the floor behind them, where the rack stands."""
    _, triangles, normals = read_obj(name)
    for side in (-1, 1):
        end = triangles[(normals[:, :, 0] * side > 0.99).all(axis=1) & (triangles[:, :, 2].max(axis=1) < 0.2)]
        assert np.abs(end[:, :, 1]).max() > 0.45
        assert (end[:, :, 2].min(), end[:, :, 2].max()) == pytest.approx((0.0, 0.12))
