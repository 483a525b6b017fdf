# SPDX-License-Identifier: BSD-3-Clause
"""The models of the worlds: the files are what their script makes, and the catalogue tells the truth about them."""

import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
import yaml

from core_bringup.world import find_worlds_dir
from core_bringup.world_schema import OBJECT_CLASSES

MODELS = find_worlds_dir() / "models"
CATALOGUE = yaml.safe_load((MODELS / "models.yaml").read_text(encoding="utf-8"))
MESHES = sorted(path.stem for path in MODELS.glob("*.obj"))
MAX_TRIANGLES = 600


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
    """A walker's clearance is measured from what collides; only a person's is drawn narrower than it collides."""
    entry = CATALOGUE[name]
    size_m, collision_m = np.array(entry["size_m"]), np.array(entry.get("collision_size_m", entry["size_m"]))
    assert entry["collision"] in ("box", "cylinder")
    if entry["collision"] == "cylinder":
        assert collision_m[0] == collision_m[1]
    if entry["class"] != "person":
        assert np.all(collision_m <= size_m)
