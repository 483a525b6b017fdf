# SPDX-License-Identifier: BSD-3-Clause
"""World files: every shipped one loads, every bad one is refused in one line that says what is allowed."""

import copy
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from core_bringup.exceptions import ConfigError
from core_bringup.ground_truth import GroundTruth
from core_bringup.world import find_worlds_dir, load_world, resolve_world_path, vary_world

WORLDS = find_worlds_dir()
GOOD = {
    "schema": "core_world/1",
    "name": "small",
    "lighting": {"direction": [0, 0, 1]},
    "surfaces": [{"id": 1, "name": "floor", "class": "floor", "polygon_m": [[-5, -5], [5, -5], [5, 5], [-5, 5]]}],
    "models": {"crate": {"class": "crate", "shape": "box", "size_m": [1, 1, 1]}},
    "objects": [
        {"id": 2, "name": "crate_1", "model": "crate", "position_m": [2, 2, 0], "jitter": {"position_m": 0.1}},
        {"id": 3, "name": "post", "class": "bollard", "shape": "cylinder", "size_m": [0.2, 0.2, 1],
         "position_m": [3, 0, 0]},
        {"id": 4, "name": "cone", "class": "traffic_cone", "shape": "mesh", "mesh": "cone.obj",
         "size_m": [0.3, 0.3, 0.7], "position_m": [0, 3, 0]},
    ],
    "tasks": {
        "walk": {
            "description": "Walk.", "expectation": "unsafe",
            "start_pose": [0, 0, 0], "start_variation": [0.3, 0.2, 0.1],
            "waypoints_m": [[1, 0], [4, 0]], "goal_m": [4, 0], "time_limit_s": 60,
            "unsafe_regions": [{"name": "far", "reason": "closed", "polygon_m": [[3, -1], [5, -1], [5, 1], [3, 1]]}],
            "oracle_predicates": ["BETWEEN(traffic_cone)=unsafe"],
        }
    },
}  # fmt: skip
DELETE = object()

# (path of the key, new value or DELETE, words the message must have)
BAD = [
    (("schema",), "core_world/9", "schema: got 'core_world/9'; allowed: core_world/1"),
    (("schema",), DELETE, "schema: missing"),
    (("colour",), 1, "colour: unknown key; allowed: description, lighting, models, name"),
    (("name",), "Big World", "name: got 'Big World'"),
    (("name",), 3, "name: got 3; allowed: a value of type string"),
    (("lighting", "direction"), [0, 0, 0], "zero vector"),
    (("lighting", "ambient"), 1.5, "lighting.ambient: got 1.5; allowed: <= 1"),
    (("surfaces",), [], "surfaces: got []; allowed: at least 1"),
    (("surfaces", 0, "class"), "flor", "surfaces[0].class: got 'flor'; allowed: floor, carpet"),
    (("surfaces", 0, "polygon_m"), [[0, 0], [1, 0]], "at least 3 entries"),
    (("surfaces", 0, "polygon_m"), [[0, 0], [0, 1], [1, 1], [1, 0]], "not convex counter-clockwise"),
    (("surfaces", 0, "polygon_m"), [[-5, -5], [5, -5], [0, 0], [5, 5], [-5, 5]], "not convex"),
    (("surfaces", 0, "texture"), "none.png", "no file"),
    (("surfaces", 0, "texture"), "/etc/x.png", "text like"),
    (("objects", 0, "id"), 1, "objects[0].id: 1 is already used by surfaces[0]"),
    (("objects", 0, "id"), 0, "allowed: >= 1"),
    (("objects", 0, "id"), 70000, "allowed: <= 65535"),
    (("objects", 0, "id"), True, "a value of type integer"),
    (("objects", 0, "id"), 2.5, "a value of type integer"),
    (("objects", 0, "name"), "post", "objects[1].name: 'post' is already used by objects[0]"),
    (("objects", 0, "model"), "crte", "unknown model 'crte'; allowed: crate"),
    (("objects", 0, "position_m"), [0, 0], "at least 3 entries"),
    (("objects", 0, "position_m"), [0, 0, float("nan")], "objects[0].position_m[2]: got nan; allowed: a finite number"),
    (("objects", 0, "position_m"), [0, float("inf"), 0], "got inf; allowed: a finite number"),
    (("objects", 0, "position_m"), "here", "objects[0].position_m: got 'here'; allowed: a value of type array"),
    (("objects", 0, "yaw_rad"), float("nan"), "objects[0].yaw_rad: got nan; allowed: a finite number"),
    (("objects", 0, "yaw_rad"), 90, "allowed: <= 6.3"),
    (("objects", 0, "pose"), [0, 0, 0], "objects[0].pose: unknown key"),
    (("objects", 0, "position_m"), DELETE, "objects[0].position_m: missing"),
    (("objects", 0, "jitter", "position_m"), -0.1, "objects[0].jitter.position_m: got -0.1; allowed: >= 0"),
    (("objects", 1, "size_m"), [0.2, 0.3, 1], "equal x and y"),
    (("objects", 1, "size_m", 2), -1, "objects[1].size_m[2]: got -1; allowed: > 0"),
    (("objects", 1, "size_m"), DELETE, "objects[1].size_m: missing"),
    (("objects", 1, "shape"), "sphere", "objects[1].shape: got 'sphere'; allowed: box, cylinder, mesh"),
    (("objects", 1, "mesh"), "cone.obj", "objects[1].mesh: given for shape 'cylinder'"),
    (("objects", 1, "class"), "bolard", "objects[1].class: got 'bolard'"),
    (("objects", 1, "color_rgba"), [255, 0, 0, 1], "allowed: <= 1"),
    (("objects", 2, "mesh"), "gone.obj", "objects[2].mesh: no file"),
    (("objects", 2, "mesh"), DELETE, "objects[2].mesh: missing"),
    (("objects", 2, "mesh_scale"), [1, 0, 1], "objects[2].mesh_scale[1]: got 0; allowed: > 0"),
    (("models", "crate", "size_m"), [1, -1, 1], "models.crate.size_m[1]: got -1"),
    (("tasks",), {}, "tasks: got {}; allowed: at least 1"),
    (("tasks", "Bad Name"), GOOD["tasks"]["walk"], "Bad Name"),
    (("tasks", "walk", "expectation"), "maybe", "tasks.walk.expectation: got 'maybe'; allowed: unsafe, safe"),
    (("tasks", "walk", "start_pose"), [0, 0, float("inf")], "got inf"),
    (("tasks", "walk", "start_pose"), [50, 0, 0], "(50, 0) is off the floor"),
    (("tasks", "walk", "start_variation"), [-0.1, 0, 0], "tasks.walk.start_variation[0]: got -0.1; allowed: >= 0"),
    (("tasks", "walk", "waypoints_m"), [[1, 0], [9, 0]], "tasks.walk.waypoints_m[1]: (9, 0) is off the floor"),
    (("tasks", "walk", "waypoints_m"), [[1, 0]], "the last waypoint is not the goal"),
    (("tasks", "walk", "goal_m"), [1], "at least 2 entries"),
    (("tasks", "walk", "time_limit_s"), 0, "tasks.walk.time_limit_s: got 0; allowed: > 0"),
    (("tasks", "walk", "unsafe_regions"), [], "none in an unsafe task"),
    (("tasks", "walk", "unsafe_regions", 0, "reason"), "", "at least 1 characters"),
    (("tasks", "walk", "unsafe_regions", 0, "polygon_m"), [[0, 0], [1, 1], [1, 0], [0, 1]], "crosses itself"),
    (("tasks", "walk", "oracle_predicates", 0), "NEXT_TO(floor)=safe", "text like"),
    (("tasks", "walk", "oracle_predicates", 0), "NEAR(forklift)=unsafe", "class 'forklift' is not in this world"),
]


def write(folder, data):
    shutil.copy(WORLDS / "models" / "traffic_cone.obj", folder / "cone.obj")
    path = folder / "small.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False))
    return path


def changed(key_path, value):
    data = copy.deepcopy(GOOD)
    target = data
    for key in key_path[:-1]:
        target = target[key] if isinstance(target, list) else target.setdefault(key, {})
    if value is DELETE:
        del target[key_path[-1]]
    else:
        target[key_path[-1]] = value
    return data


def refusal(path):
    with pytest.raises(ConfigError) as caught:
        load_world(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message


@pytest.mark.parametrize("content", ["", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "f 1 2 3\n", "\udc80 no text"])
def test_a_mesh_without_faces_is_refused_because_it_would_be_drawn_as_nothing(tmp_path, content):
    path = write(tmp_path, GOOD)
    (tmp_path / "cone.obj").write_bytes(content.encode("utf-8", "surrogateescape"))
    assert "objects[2].mesh: " in refusal(path) and "holds no face" in refusal(path)


def test_small_world_loads_with_its_defaults(tmp_path):
    world = load_world(write(tmp_path, GOOD))
    assert [item.id for item in world.objects] == [2, 3, 4]
    assert world.objects[0].class_name == "crate"
    assert world.objects[1].collision == "cylinder"
    assert world.objects[2].mesh == tmp_path / "cone.obj"
    assert world.class_of_label() == {1: "floor", 2: "crate", 3: "bollard", 4: "traffic_cone"}
    assert not world.objects[0].position_m.flags.writeable
    np.testing.assert_array_equal(world.tasks["walk"].unsafe_regions[0].polygon_m[0], [3, -1])


@pytest.mark.parametrize(
    ("key_path", "value", "words"), BAD, ids=[f"{i}-{'.'.join(map(str, b[0]))}" for i, b in enumerate(BAD)]
)
def test_bad_world_is_refused_in_one_line(tmp_path, key_path, value, words):
    assert words in refusal(write(tmp_path, changed(key_path, value)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [1", "not YAML"),
        ("- 1\n- 2\n", "got list; allowed: a YAML mapping"),
        ("", "got NoneType"),
        ("name: a\nname: b\n", ":2: name: given twice, first in line 1"),
        ("a: &x [1]\nb: *x\n", ":2: *x: a YAML alias"),
        ("1: 2\n", "no text"),
        ("a: !!python/object/apply:os.system ['true']\n", "not YAML"),
        ("a: 2020-99-99\n", "not YAML"),
    ],
)
def test_text_that_is_no_plain_mapping_is_refused(tmp_path, text, words):
    assert words in refusal(write(tmp_path, text))


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_bytes(b"name: \xff\xfe\n")
    assert "UTF-8" in refusal(path)


def test_error_names_the_line(tmp_path):
    path = write(tmp_path, changed(("objects", 1, "size_m", 2), -1))
    line = next(i for i, text in enumerate(path.read_text().splitlines(), 1) if text.strip() == "- -1")
    assert refusal(path).startswith(f"{path}:{line}: objects[1].size_m[2]:")


def test_first_error_of_the_file_is_told(tmp_path):
    data = changed(("objects", 1, "shape"), "sphere")
    data["tasks"]["walk"]["time_limit_s"] = -1
    assert "objects[1].shape" in refusal(write(tmp_path, data))


@pytest.mark.parametrize("name", ["warehose", "no/such.yaml", "nosuch.yaml"])
def test_unknown_world_is_refused(name):
    with pytest.raises(ConfigError, match="allowed"):
        resolve_world_path(name)


def test_unknown_task_lists_the_known_ones(tmp_path):
    world = load_world(write(tmp_path, GOOD))
    with pytest.raises(ConfigError, match="no task 'run'; allowed: walk"):
        world.task("run")
    with pytest.raises(ConfigError, match="no task 'run'"):
        vary_world(world, "run", 1)


def test_name_and_path_give_the_same_world():
    assert load_world("warehouse").name == load_world(WORLDS / "warehouse.yaml").name == "warehouse"


def test_seed_zero_is_the_world_as_written(tmp_path):
    world = load_world(write(tmp_path, GOOD))
    varied, start_pose = vary_world(world, "walk", 0)
    assert varied is world
    np.testing.assert_array_equal(start_pose, world.tasks["walk"].start_pose)


def test_variation_repeats_and_stays_within_its_bounds(tmp_path):
    world = load_world(write(tmp_path, GOOD))
    poses = []
    for seed in range(1, 60):
        varied, start_pose = vary_world(world, "walk", seed)
        again, start_again = vary_world(world, "walk", seed)
        np.testing.assert_array_equal(start_pose, start_again)
        np.testing.assert_array_equal(varied.objects[0].position_m, again.objects[0].position_m)
        assert np.all(np.abs(start_pose) <= world.tasks["walk"].start_variation)
        assert np.all(np.abs(varied.objects[0].position_m - world.objects[0].position_m) <= [0.1, 0.1, 0.0])
        assert varied.objects[1] is world.objects[1]
        poses.append(tuple(start_pose))
    assert len(set(poses)) == len(poses)
    with pytest.raises(ValueError, match="seed"):
        vary_world(world, "walk", -1)


@pytest.mark.parametrize("path", sorted(WORLDS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_world_is_walkable_by_its_own_truth(path):
    """Start free of objects; the straight walk of a safe task never, of an unsafe task always, enters a true region."""
    world = load_world(path)
    for name, task in world.tasks.items():
        for seed in range(12):
            varied, start_pose = vary_world(world, name, seed)
            truth = GroundTruth(task.unsafe_regions, varied.objects, 1.1, 0.5)
            places = walk(start_pose, task.waypoints_m)
            states = [truth.evaluate(*place) for place in places]
            assert not states[0].inside
            assert min(state.obstacle_clearance_m for state in states) > (0.2 if task.unsafe_regions else 0.75), (
                name,
                seed,
            )
            assert any(state.inside for state in states) == (task.expectation == "unsafe")


def walk(start_pose, waypoints_m, step_m=0.05):
    """Poses of a robot that turns towards each waypoint and walks straight to it."""
    here, places = np.array(start_pose[:2]), [tuple(start_pose)]
    for goal in waypoints_m:
        leg = goal - here
        yaw = np.arctan2(leg[1], leg[0])
        count = max(int(np.linalg.norm(leg) / step_m), 1)
        places += [(*(here + leg * i / count), yaw) for i in range(count + 1)]
        here = goal
    return places


def test_cone_line_is_what_its_task_says():
    """Gaps between cones pass a 0.5 m wide robot with room to spare, gaps at the ends do not."""
    world = load_world("warehouse")
    cones = sorted((o for o in world.objects if o.class_name == "traffic_cone"), key=lambda o: o.position_m[1])
    assert len(cones) == 5
    y_m = np.array([cone.position_m[1] for cone in cones])
    assert np.all(np.diff(y_m) - 0.36 >= 0.85)
    racks = [o for o in world.objects if o.class_name == "storage_rack" and abs(o.position_m[0] - 6.0) < 1.35]
    faces = sorted(o.position_m[1] + side * 0.55 for o in racks for side in (-1, 1))
    lower, upper = max(f for f in faces if f < y_m[0]), min(f for f in faces if f > y_m[-1])
    assert y_m[0] - 0.18 - lower <= 0.35
    assert upper - y_m[-1] - 0.18 <= 0.35
    lane_m = world.tasks["cone_line"].goal_m[1]
    assert np.min(np.abs(y_m - lane_m)) == pytest.approx(np.diff(y_m)[0] / 2)


def test_models_are_what_their_script_makes(tmp_path):
    import importlib.util

    spec = importlib.util.spec_from_file_location("make_models", WORLDS / "models" / "make_models.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.make_all(tmp_path)
    made = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    assert len(made) > 10
    for name in made:
        shipped = WORLDS / "models" / name
        assert shipped.is_file(), name
        if name.suffix in (".obj", ".mtl"):
            assert shipped.read_text() == (tmp_path / name).read_text(), name


def test_sizes_of_objects_are_those_of_their_meshes():
    for item in load_world("warehouse").objects:
        if item.mesh is not None:
            corners = np.array(
                [line.split()[1:] for line in Path(item.mesh).read_text().splitlines() if line.startswith("v ")], float
            )
            low, high = corners.min(0) * item.mesh_scale, corners.max(0) * item.mesh_scale
            np.testing.assert_allclose(low[2], 0.0, atol=1e-6, err_msg=item.name)
            np.testing.assert_allclose(
                high - low, item.size_m, atol=0.16 if "wall" in item.mesh.stem else 0.02, err_msg=item.name
            )
