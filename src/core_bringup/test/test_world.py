# SPDX-License-Identifier: BSD-3-Clause
"""World files: every shipped one loads, every bad one is refused in one line that says what is allowed."""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from core_bringup.exceptions import ConfigError
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
            "description": "Walk.", "expectation": "unsafe", "category": "barriers",
            "start_pose": [0, 0, 0], "start_variation": [0.3, 0.2, 0.1],
            "waypoints_m": [[1, 0], [4, 0]], "goal_m": [4, 0], "time_limit_s": 60,
            "unsafe_regions": [{"name": "far", "reason": "closed", "because": ["BETWEEN(traffic_cone)=unsafe"],
                                "polygon_m": [[3, -1], [5, -1], [5, 1], [3, 1]]}],
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
    (("objects", 0, "id"), 300.0, "objects[0].id: got 300.0; allowed: a value of type integer"),
    (("tasks", "walk", "number"), 1.0, "tasks.walk.number: got 1.0; allowed: a value of type integer"),
    (("name",), "small\n", "name: got 'small\\n'; allowed: text like"),
    (("objects", 0, "name"), "crate\n", "objects[0].name: got 'crate\\n'"),
    (("tasks", "walk", "oracle_predicates", 0), "ON(floor)=safe\n", "allowed: text like ON(floor)=safe"),
    (("objects", 0, "name"), "post", "objects[1].name: 'post' is already used by objects[0]"),
    (("objects", 0, "model"), "crte", "unknown model 'crte'; allowed: barrel"),
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


RAMP = {"id": 8, "name": "ramp", "class": "sidewalk_ramp", "polygon_m": [[-4, 2], [-2, 2], [-2, 4], [-4, 4]]}
WALKER = {"id": 9, "name": "walker", "class": "person", "shape": "cylinder", "size_m": [0.5, 0.5, 1.7],
          "position_m": [-3, 0, 0]}  # fmt: skip
RULE = {"predicate": "ON(floor)=unsafe"}
TASK, REGION = ("tasks", "walk"), ("tasks", "walk", "unsafe_regions", 0)
REGION_KINDS = "exactly one of polygon_m, disc, around"


def task(**keys):
    return {**copy.deepcopy(GOOD["tasks"]["walk"]), **keys}


def region(**keys):
    kept = copy.deepcopy(GOOD["tasks"]["walk"]["unsafe_regions"][0])
    del kept["polygon_m"]
    return {**kept, **keys}


def walker(**motion):
    return {**WALKER, "motion": {"path_m": [[-3, 2]], "speed_mps": 1, **motion}}


def in_task(key, value, suffix, words):
    return (*TASK, key), value, f"tasks.walk.{key}{suffix}", words


def in_region(key, value, suffix, words):
    return (*REGION, key), value, f"tasks.walk.unsafe_regions[0].{key}{suffix}", words


def event(suffix, words, **keys):
    return in_task("events", [{"at_s": 1, **keys}], f"[0].{suffix}", words)


def ramp(key, words, **keys):
    return ("surfaces", 1), {**RAMP, **keys}, f"surfaces[1].{key}", words


POST_PARTS = [[-0.1, -0.1, 0, 0.1, 0.1, 1]]


def parts(key, value, words, **keys):
    """A post with these parts, or without any."""
    post = {**GOOD["objects"][1], "collision": "parts", "collision_parts_m": value, **keys}
    if value is DELETE:
        del post["collision_parts_m"]
    return ("objects", 1), post, f"objects[1].{key}", words


def moving(key, words, **motion):
    return ("objects", 3), walker(**motion), f"objects[3].motion.{key}", words


def extra(key, words, **keys):
    return in_task("objects", [{**WALKER, **keys}], f"[0].{key}", words)


def varied(suffix, words, value):
    return ("variation",), value, f"variation.{suffix}", words


# Every way a task, a ramp, a motion or a variation can be wrong: (path, value, key that is named, words).
BAD_TASKS = [
    in_task("category", DELETE, "", "missing; allowed: this key is required: buffers, barriers"),
    in_task("category", "doors", "", "got 'doors'; allowed: buffers, barriers, traversal"),
    in_task("number", 13, "", "got 13; allowed: <= 12"),
    in_task("number", 2.5, "", "a value of type integer"),
    (("tasks", "b"), task(number=3), "tasks.b.number", "3 is already the number of walk; allowed: a number"),
    in_task("split", "test", "", "got 'test'; allowed: main, heldout"),
    (TASK, task(split="heldout"), "tasks.walk.variant_of", "missing in a heldout task; allowed: one of "),
    in_task("variant_of", "walk", "", "given in a main task; allowed: variant_of only with"),
    (("tasks", "b"), task(split="heldout", variant_of="run"), "tasks.b.variant_of", "no main task 'run'; allowed: w"),
    (("tasks", "b"), task(split="heldout", variant_of="b"), "tasks.b.variant_of", "no main task 'b'; allowed: walk"),
    in_task("time_limit_s", 7, "", "got 7; allowed: >= 7.2, the way to the goal at 0.5 m/s"),
    in_task("start_pose", [3.0, 0.3, 0], "", "starts in the unsafe region far; allowed: a start"),
    in_task("start_pose", [2.0, 2.0, 0], "", "deep in a solid object; allowed: a start"),
    in_task("start_variation", [2.6, 0, 0], "", "a seed may start at (2.6, 0, 0), in the unsafe region far;"),
    in_task("start_variation", [1.6, 1.6, 0], "", "deep in a solid object; allowed: a start"),
    in_task("expectation", "safe", "", "got 'safe', but the way enters far; allowed: unsafe, or another way"),
    (
        REGION,
        region(polygon_m=[[-5, -5], [-4, -5], [-4, -4]]),
        "tasks.walk.expectation",
        "but the way enters no region",
    ),
    in_task("hides", ["crate_9"], "[0]", "no object 'crate_9' in the world's list; allowed: cone"),
    in_task("hides", ["post", "post"], "", "allowed: entries that differ"),
    extra("id", "2 is already used by objects[0]", id=2),
    extra("name", "'post' is already used by objects[1]", name="post"),
    extra("model", "unknown model 'nun'; allowed: barrel", model="nun"),
    extra("size_m", "allowed: equal x and y", size_m=[1, 2, 1]),
    in_region("because", DELETE, "", "missing; allowed: this key is required"),
    in_region("because", [], "", "got []; allowed: at least 1 entries"),
    in_region("because", ["ON(floor)"], "[0]", "allowed: text like ON(floor)=safe or AROUND("),
    in_region("because", ["ON(floor)=safe"], "[0]", "allowed: a predicate =unsafe"),
    in_region("because", ["ON(grass)=unsafe"], "[0]", "class 'grass' is not in this world; allowed"),
    in_region("because", ["ON(floor, 1.5)=unsafe"], "[0]", "a radius, allowed on AROUND only"),
    in_region("disc", {"center_m": [3, 0], "radius_m": 1}, "", "polygon_m and disc; allowed: " + REGION_KINDS),
    (REGION, region(), "tasks.walk.unsafe_regions[0]", "got none of them; allowed: " + REGION_KINDS),
    in_region("disc", {"center_m": [3, 0]}, ".radius_m", "missing; allowed: this key is required"),
    in_region("disc", {"center_m": [3, 0], "radius_m": 0}, ".radius_m", "got 0; allowed: > 0"),
    (REGION, region(around={"object": "pst", "radius_m": 1}), "around.object", "no object 'pst' in this task; allowed"),
    in_task("over_cautious", ["NEAR(floor)"], "[0]", "allowed: text like ON(floor)=safe"),
    in_task("over_cautious", ["ON(gras)=unsafe"], "[0]", "class 'gras' is not in this world; allowed: bollard"),
    in_task("wrong_answer", ["ON(floor=safe"], "[0]", "allowed: text like ON(floor)=safe"),
    in_task("wrong_answer", "ON(floor)=safe", "", "allowed: a value of type array"),
    in_task("wrong_answer", ["AROUND(cart, 99)=unsafe"], "[0]", "allowed 0 < radius <= 20.0 m"),
    in_task("wrong_answer", ["ON(cart, slow)=safe"], "[0]", "allowed slow on unsafe ones"),
    event("at_s", "got -1; allowed: >= 0", at_s=-1, add_rule=RULE),
    event("at_s", "got 60; allowed: < time_limit_s 60", at_s=60, add_rule=RULE),
    event("add_rule", "missing; allowed: this key is required"),
    event("add_rule", "got none of them; allowed: exactly one of predicate, guideline", add_rule={}),
    event("add_rule", "got predicate and guideline", add_rule={**RULE, "guideline": "Stop."}),
    event("add_rule.text", "unknown key; allowed: guideline, lifetime_s", add_rule={**RULE, "text": "x"}),
    event("add_rule.guideline", "at least 1 characters", add_rule={"guideline": ""}),
    event("add_rule.lifetime_s", "got -1; allowed: >= 0", add_rule={**RULE, "lifetime_s": -1}),
    (("objects", 0, "presence"), 1.5, "objects[0].presence", "got 1.5; allowed: <= 1"),
    (("objects", 0, "presence"), "often", "objects[0].presence", "got 'often'; allowed: a value of type number"),
    (("objects", 0, "motion"), {"speed_mps": 1}, "objects[0].motion.path_m", "missing; allowed: this key is required"),
    moving("path_m[1]", "(-9, 2) is off the floor; allowed: a place", path_m=[[-3, 2], [-9, 2]]),
    moving("path_m[0]", "(-3, 0) is where it comes from; allowed: a place", path_m=[[-3, 0]]),
    moving("speed_mps", "got 0; allowed: > 0", speed_mps=0),
    moving("start", "exactly one of at_s, robot_within_m", start={"at_s": 1, "robot_within_m": 2}),
    moving("start", "exactly one of at_s, robot_within_m", start={}),
    moving("start.at_s", "got -2; allowed: >= 0", start={"at_s": -2}),
    moving("loops", "unknown key; allowed: face_motion, loop, path_m", loops=True),
    (("objects", 1, "collision_size_m"), [1, 2, 1], "objects[1].collision_size_m", "allowed: equal x and y"),
    parts("collision", DELETE, "parts without collision_parts_m; allowed: parts together with collision_parts_m"),
    parts("collision_parts_m", POST_PARTS, "given for collision 'box'; allowed: collision: parts", collision="box"),
    parts("collision_parts_m", [], "got []; allowed: at least 1 entries"),
    parts("collision_parts_m[0]", [[0, 0, 0, 0.1, 0.1]], "got [0, 0, 0, 0.1, 0.1]; allowed: at least 6 entries"),
    parts("collision_parts_m", [*POST_PARTS, [0, 0, 0.5, 0.1, 0.1, 0.5]], "box 1 is empty; allowed: x0 < x1"),
    parts("collision_parts_m", [[0, 0, 0, 0.2, 0.1, 1]], "box 0 reaches out of size_m [0.2, 0.2, 1.0]; allowed"),
    parts("collision_parts_m", [[0, 0, -0.1, 0.1, 0.1, 1]], "box 0 reaches out of size_m"),
    parts(
        "collision_size_m", POST_PARTS, "given for collision 'parts'; allowed: only with", collision_size_m=[1, 1, 1]
    ),
    ramp("corner_z_m", "got 3 heights; allowed: 4, one for each", corner_z_m=[0, 0.1, 0.2]),
    ramp("corner_z_m", "0.050 m off; allowed: one plane", corner_z_m=[0, 0.1, 0.1, 0.2]),
    ramp("corner_z_m", "a slope of 0.55; allowed: <= 0.5", corner_z_m=[0, 1.1, 1.1, 0]),
    ramp("corner_z_m", "with z_m; allowed: z_m or corner_z_m, not both", corner_z_m=[0, 0.1, 0.1, 0], z_m=0),
    ramp("z_m", "got -0.1, lower than the floor; allowed: >= 0", z_m=-0.1),
    (("surfaces", 0, "corner_z_m"), [0, 1, 1, 0], "surfaces[0].corner_z_m", "given for the floor; allowed: a level"),
    ramp("textures[0]", "no file", textures=["a.png"]),
    ramp("textures", "allowed: texture or textures, not both", textures=["a.png"], texture="a.png"),
    ramp("class", "got 'curb_ramp'; allowed: floor, carpet", **{"class": "curb_ramp"}),
    varied("light", "unknown key; allowed: camera_noise, light_ambient", {"light": 1}),
    varied("light_ambient", "got -0.1; allowed: >= 0", {"light_ambient": -0.1}),
    varied("camera_noise.depth_dropout", "got 1.5; allowed: <= 1", {"camera_noise": {"depth_dropout": 1.5}}),
    varied("camera_noise.color_sigma", "got 3; allowed: <= 0.2", {"camera_noise": {"color_sigma": 3}}),
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
    elif isinstance(target, list) and key_path[-1] == len(target):
        target.append(value)
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


@pytest.mark.parametrize("key, value", [("texture", "a.png"), ("textures", ["a.png"])])
@pytest.mark.parametrize("content", [b"", b"garbage", b"\xff\xd8\xff\xe0 JPEG"])
def test_a_texture_that_is_no_png_is_refused_because_it_would_be_drawn_white(tmp_path, content, key, value):
    path = write(tmp_path, changed(("surfaces", 0, key), value))
    (tmp_path / "a.png").write_bytes(content)
    assert f"surfaces[0].{key}" in refusal(path) and "is no PNG" in refusal(path)


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
    ("key_path", "value", "key", "words"), BAD_TASKS, ids=[f"{i}-{b[2]}" for i, b in enumerate(BAD_TASKS)]
)
def test_bad_task_ramp_motion_or_variation_is_refused_with_line_and_key(tmp_path, key_path, value, key, words):
    data = changed(key_path, value)
    data["tasks"]["walk"].setdefault("number", 3)
    path = write(tmp_path, data)
    message = refusal(path)
    place, told_key, _ = message.split(": ", 2)
    assert told_key.endswith(key)
    assert words in message
    assert "allowed" in message
    # the line holds the last name of the key that is written in the file
    line = int(place.rsplit(":", 1)[1])
    names = [part.split("[")[0] for part in told_key.split(".")]
    text = path.read_text().splitlines()[line - 1]
    assert any(name in text for name in names) or text.strip().startswith("-"), (line, text)


def test_the_same_bad_ways_are_right_when_they_are_right(tmp_path):
    """The world the bad ones differ from loads, with every new key in it."""
    data = copy.deepcopy(GOOD)
    data["variation"] = {"light_azimuth_rad": 0.5, "camera_noise": {"color_sigma": 0.01, "depth_sigma_per_m2": 0.002}}
    data["surfaces"].append({**RAMP, "corner_z_m": [0, 0.1, 0.1, 0]})
    data["objects"].append(walker(start={"robot_within_m": 2.5}, loop=True, pause_s=1))
    data["tasks"]["walk"].update(
        number=3, hides=["post"], over_cautious=["NEAR(crate)=unsafe"], wrong_answer=["ON(lava)=safe"],
        objects=[{**WALKER, "id": 10, "name": "nurse", "position_m": [3, 2, 0], "presence": 1}],
        events=[{"at_s": 2, "add_rule": {"guideline": "Keep left.", "lifetime_s": 5}}, {"at_s": 3.5, "add_rule": RULE}],
    )  # fmt: skip
    data["tasks"]["walk_far"] = task(split="heldout", variant_of="walk")
    data["tasks"]["walk"]["unsafe_regions"] += [
        region(name="around", around={"object": "nurse", "radius_m": 0.5}, because=["AROUND(person, 1.5)=unsafe"]),
        region(name="disc", disc={"center_m": [4, 0], "radius_m": 0.5}),
    ]
    data = json.loads(json.dumps(data))  # a list used twice would be written as an alias
    world = load_world(write(tmp_path, data))
    walk = world.tasks["walk"]
    assert (walk.number, walk.category, walk.split, walk.variant_of) == (3, "barriers", "main", None)
    assert (world.tasks["walk_far"].split, world.tasks["walk_far"].variant_of) == ("heldout", "walk")
    assert [(e.at_s, e.text, e.kind, e.lifetime_s) for e in walk.events] == [
        (2.0, "Keep left.", "guideline", 5.0), (3.5, "ON(floor)=unsafe", "predicate", 0.0)
    ]  # fmt: skip
    assert walk.wrong_answer == ("ON(lava)=safe",)
    assert walk.unsafe_regions[1].because == ("AROUND(person, 1.5)=unsafe",)
    assert (walk.unsafe_regions[2].radius_m, tuple(walk.unsafe_regions[2].center_m)) == (0.5, (4.0, 0.0))
    motion = world.objects[3].motion
    assert (motion.start_at_s, motion.start_within_m, motion.loop, motion.pause_s) == (None, 2.5, True, 1.0)
    assert world.surfaces[1].height_m((-3.0, 3.0)) == pytest.approx(0.05)
    assert world.camera_noise.depth_sigma_per_m2 == 0.002


def task_world(tmp_path, **keys):
    data = copy.deepcopy(GOOD)
    data["tasks"]["walk"].update(objects=[{**WALKER, "position_m": [-3, 3, 0]}], hides=["post", "crate_1"])
    data["tasks"]["walk"]["expectation"] = "safe"
    data["tasks"]["walk"]["unsafe_regions"] = [
        region(around={"object": "walker", "radius_m": 1}, because=["AROUND(person)=unsafe"])
    ]
    data["objects"][0].update(keys)
    return load_world(write(tmp_path, data))


def test_world_of_a_task_has_its_objects_and_not_those_it_hides(tmp_path):
    world = task_world(tmp_path)
    assert [item.name for item in world.objects] == ["crate_1", "post", "cone"]
    for made in (world.for_task("walk"), world.for_task("walk").for_task("walk"), vary_world(world, "walk", 0)[0]):
        assert [item.name for item in made.objects] == ["cone", "walker"]
        assert made.class_of_label() == {1: "floor", 4: "traffic_cone", 9: "person"}
        assert made.task("walk").unsafe_regions[0].item is made.objects[1]
    with pytest.raises(ConfigError, match="no task 'run'"):
        world.for_task("run")


def test_region_around_an_object_that_is_hidden_or_may_be_missing_is_refused(tmp_path):
    data = changed(("tasks", "walk", "hides"), ["post"])
    data["tasks"]["walk"]["unsafe_regions"] = [region(around={"object": "post", "radius_m": 1})]
    assert "no object 'post' in this task; allowed: cone, crate_1" in refusal(write(tmp_path, data))
    data["tasks"]["walk"]["hides"] = []
    data["objects"][1]["presence"] = 0.5
    assert "'post' has presence 0.5" in refusal(write(tmp_path, data))


def test_region_around_an_object_follows_its_jitter(tmp_path):
    data = changed(("objects", 1, "jitter"), {"position_m": 0.3})
    data["tasks"]["walk"]["unsafe_regions"] = [region(around={"object": "post", "radius_m": 1})]
    world = load_world(write(tmp_path, data))
    for seed in (1, 2, 3):
        varied, _ = vary_world(world, "walk", seed)
        assert varied.task("walk").unsafe_regions[0].item is varied.objects[1]
        assert np.any(varied.objects[1].position_m != world.objects[1].position_m)


def test_parts_are_scaled_as_the_mesh_is(tmp_path):
    shutil.copy(WORLDS / "models" / "traffic_cone.obj", tmp_path / "cone.obj")
    keys = {"mesh_scale": [2, 1, 0.5], "size_m": [0.8, 0.4, 0.5], "collision": "parts"}
    data = changed(("objects", 2), {**GOOD["objects"][2], **keys, "collision_parts_m": [[-0.2, -0.1, 0, 0, 0.1, 1]]})
    cone = load_world(write(tmp_path, data)).objects[2]
    np.testing.assert_allclose(cone.collision_parts_m, [[-0.4, -0.1, 0, 0, 0.1, 0.5]])


def test_a_missing_catalogue_is_told_with_a_model_that_might_be_in_it(tmp_path):
    data = changed(("objects", 0), {"id": 2, "name": "a", "model": "thing", "position_m": [2, 2, 0]})
    with pytest.raises(ConfigError, match=f"unknown model 'thing'; allowed: crate; {tmp_path}/models/models.yaml does"):
        load_world(write(tmp_path, data), worlds_dir=tmp_path)


@pytest.mark.parametrize("elsewhere", [True, False])
def test_every_world_sees_the_catalogue_and_its_own_models_win(tmp_path, elsewhere):
    folder = tmp_path / "worlds"
    (folder / "models").mkdir(parents=True)
    shutil.copy(WORLDS / "models" / "traffic_cone.obj", folder / "models" / "cone.obj")
    entry = "{class: %s, shape: mesh, mesh: cone.obj, size_m: [1, 1, 1], collision_size_m: [0.2, 0.2, 1]}\n"
    (folder / "models" / "models.yaml").write_text("thing: " + entry % "barrel" + "crate: " + entry % "barrel")
    (tmp_path / "else").mkdir()
    data = changed(("objects", 0), {"id": 2, "name": "a", "model": "thing", "position_m": [2, 2, 0]})
    data["objects"].append({"id": 5, "name": "b", "model": "crate", "position_m": [-2, 2, 0]})
    world = load_world(write(tmp_path / "else" if elsewhere else folder, data), worlds_dir=folder)
    thing, own = world.objects[0], world.objects[3]
    assert (thing.class_name, thing.mesh) == ("barrel", folder / "models" / "cone.obj")
    assert (own.class_name, own.shape) == ("crate", "box")
    np.testing.assert_array_equal(thing.collision_size_m, [0.2, 0.2, 1])
    np.testing.assert_array_equal(own.collision_size_m, own.size_m)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{class: barel, shape: box, size_m: [1, 1, 1]}", "models.yaml:2: thing.class: got 'barel'; allowed: barrel"),
        ("{class: barrel, shape: cylinder, size_m: [1, 2, 1]}", "models.yaml:2: thing.size_m: a cylinder with x 1.0"),
        ("{class: barrel, shape: mesh, mesh: x.obj, size_m: [1, 1, 1]}", "models.yaml:2: thing.mesh: no file"),
        ("{class: barrel, shape: box, size_m: [1, 1, 1], id: 4}", "models.yaml:2: thing.id: unknown key"),
    ],
)
def test_mistake_in_the_catalogue_is_told_with_its_own_file_and_line(tmp_path, entry, words):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "models.yaml").write_text(f"# first line\nthing: {entry}\n")
    data = changed(("objects", 0), {"id": 2, "name": "a", "model": "thing", "position_m": [2, 2, 0]})
    with pytest.raises(ConfigError) as caught:
        load_world(write(tmp_path, data), worlds_dir=tmp_path)
    assert words in str(caught.value)


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
        ("a: " + "[" * 100000 + "]" * 100000, ":1: (file): nested too deeply; allowed: at most 32 levels"),
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


def test_presence_is_a_share_of_the_seeds_and_seed_zero_has_it(tmp_path):
    world = load_world(write(tmp_path, changed(("objects", 0, "presence"), 0.7)))
    assert [item.name for item in vary_world(world, "walk", 0)[0].objects] == ["crate_1", "post", "cone"]
    there = [vary_world(world, "walk", seed)[0].objects[0].name == "crate_1" for seed in range(1, 301)]
    assert 0.6 < np.mean(there) < 0.8
    none = load_world(write(tmp_path, changed(("objects", 0, "presence"), 0)))
    assert all(len(vary_world(none, "walk", seed)[0].objects) == 2 for seed in range(1, 20))


def test_light_texture_and_noise_vary_within_their_bounds(tmp_path):
    data = copy.deepcopy(GOOD)
    data["lighting"] = {"direction": [1, 0, 1], "ambient": 0.95, "diffuse": 0.5}
    data["variation"] = {
        "light_azimuth_rad": 0.6, "light_ambient": 0.1, "light_diffuse": 0.2, "camera_noise": {"color_sigma": 0.01}
    }  # fmt: skip
    data["surfaces"][0]["textures"] = ["a.png", "b.png", "c.png"]
    for name in data["surfaces"][0]["textures"]:
        (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n")
    world = load_world(write(tmp_path, data))
    same, _ = vary_world(world, "walk", 0)
    assert same.lighting is world.lighting
    assert same.surfaces[0].texture == tmp_path / "a.png"
    assert not same.camera_noise.is_on
    varied = [vary_world(world, "walk", seed)[0] for seed in range(1, 60)]
    assert {w.surfaces[0].texture.name for w in varied} == {"a.png", "b.png", "c.png"}
    azimuths = [np.arctan2(*w.lighting.direction[1::-1]) for w in varied]
    assert max(np.abs(azimuths)) <= 0.6
    assert np.ptp(azimuths) > 0.6
    assert all(np.hypot(*w.lighting.direction[:2]) == pytest.approx(1.0) for w in varied)
    assert all(0.85 <= w.lighting.ambient <= 1.0 and 0.3 <= w.lighting.diffuse <= 0.7 for w in varied)
    assert len({w.lighting.diffuse for w in varied}) == len(varied)
    assert [w.camera_noise.seed for w in varied] == list(range(1, 60))
    assert all(w.camera_noise.is_on and w.camera_noise.color_sigma == 0.01 for w in varied)


def test_one_more_object_changes_no_other_draw(tmp_path):
    data = changed(("objects", 1, "jitter"), {"position_m": 0.2, "yaw_rad": 0.5})
    before = load_world(write(tmp_path, data))
    data["objects"].insert(0, {**WALKER, "jitter": {"position_m": 0.1}, "presence": 0.5})
    after = load_world(write(tmp_path, data))
    for seed in range(1, 10):
        (first, start), (second, again) = (vary_world(world, "walk", seed) for world in (before, after))
        np.testing.assert_array_equal(start, again)
        moved = {item.name: (*item.position_m, item.yaw_rad) for item in second.objects}
        assert all((*item.position_m, item.yaw_rad) == moved[item.name] for item in first.objects)
        shifts = {tuple(np.round((a.position_m - b.position_m)[:2], 6)) for a, b in zip(first.objects, before.objects)}
        assert len(shifts) == 3  # each its own way: at most 0.1, at most 0.2, none


def test_highest_surface_counts_and_beyond_them_the_floor(tmp_path):
    data = copy.deepcopy(GOOD)
    data["surfaces"].append({**RAMP, "corner_z_m": [0, 0.2, 0.2, 0]})
    slab = {"id": 11, "name": "slab", "polygon_m": [[-3, 2], [-1, 2], [-1, 4], [-3, 4]], "z_m": 0.12}
    data["surfaces"].append({**RAMP, **slab})
    world = load_world(write(tmp_path, data))
    places = {
        (0, 0): 0.0,
        (-4, 3): 0.0,
        (-3.5, 3): 0.05,
        (-2.9, 3): 0.12,
        (-2.1, 3): 0.19,
        (-1.5, 3): 0.12,
        (9, 0): 0.0,
    }
    assert {place: round(world.surface_height_m(*place), 9) for place in places} == places


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
