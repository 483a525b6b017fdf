# SPDX-License-Identifier: BSD-3-Clause
"""Every task of every shipped world is what it says: walked by the nominal controller alone, without physics or filter.

The walk is that of the real waypoint controller on a robot that moves exactly as commanded, so turns in place and cut
corners are those of a trial. Each check returns its complaints as text; at the end, each is seen to complain.
"""

import functools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import yaml

from core_bringup.ground_truth import ROBOT_HEIGHT_M, object_clearance_m
from core_bringup.kinematic_backend import integrate_twist
from core_bringup.motion import WorldMotion
from core_bringup.polygons import contains_point, point_distance_m, rectangle, signed_clearance_m
from core_bringup.regions import region_clearance_m, region_outline_m
from core_bringup.world import find_worlds_dir, load_world, vary_world
from core_control.params import WaypointParams
from core_control.waypoint_controller import WaypointController
from core_perception.arrangement import Arrangement, classify
from core_perception.predicates import Operator, parse_predicate

LENGTH_M, WIDTH_M = 1.1, 0.5  # footprint of the shipped robot
STEP_S = 0.05
SAMPLE_STEPS = 4  # the walk is looked at every 0.2 s, 0.1 m
MIN_SOLID_CLEARANCE_M = 0.25
REACH_M = 1.0  # objects whose circle is farther from the base point than this are clear
MIN_START_DISTANCE_M = 1.0  # from the base point to any region, and for unsafe tasks from the footprint
MIN_GAP_INSIDE_M, MAX_GAP_AT_END_M = 1.0, 0.45  # of a barrier
LINK_M = 2.5  # objects with wider gaps are not one barrier; semantic_map/between_max_gap_m
MAX_TIME_LIMIT_S = 60.0
SEEDS = (1, 2, 3, 4, 5)
CATEGORIES = ("buffers", "barriers", "traversal")
PAPER = {n: "unsafe" if n <= 6 else "safe" for n in range(1, 13)}
PLACE_OF = {
    **dict.fromkeys((1, 2, 7, 8), "warehouse"),
    **dict.fromkeys((3, 4, 9, 10), "hospital"),
    **dict.fromkeys((5, 6, 11, 12), "residential"),
}


def list_cases():
    """(world, task) as the files name them, so that a file that does not load fails its own cases only."""
    cases = []
    for path in sorted(find_worlds_dir().glob("*.yaml")):
        cases += [(path.stem, task) for task in yaml.safe_load(path.read_text(encoding="utf-8"))["tasks"]]
    return cases


CASES = list_cases()


@functools.lru_cache(maxsize=None)
def shipped(name):
    return load_world(name)


def all_tasks():
    return [(name, shipped(name).task(task)) for name, task in CASES]


# The walk


def list_starts(world, task_name):
    """[(label, World of the task, start pose)]: as written, the corners of the variation, and five seeds."""
    written = world.for_task(task_name)
    task = written.task(task_name)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).T.reshape(-1, 3)
    starts = [("as written", written, task.start_pose)]
    starts += [(f"corner {u.tolist()}", written, task.start_pose + u * task.start_variation) for u in corners]
    return starts + [(f"seed {seed}", *vary_world(world, task_name, seed)) for seed in SEEDS]


def walk(task, start_pose):
    """[(time, pose)] of the nominal controller from a start to its stop at the goal; ends early at twice the limit."""
    params = replace(WaypointParams(), waypoints=tuple(map(tuple, task.waypoints_m)))
    controller, pose, samples = WaypointController(params), np.array(start_pose, dtype=float), []
    for step in range(int(2.0 * task.time_limit_s / STEP_S)):
        command = controller.step(pose, step * STEP_S)
        if step % SAMPLE_STEPS == 0 or command.goal_reached:
            samples.append((step * STEP_S, pose))
        if command.goal_reached:
            break
        pose = integrate_twist(pose, command.u, STEP_S)
    return samples


def footprint(pose):
    return rectangle(pose[:2], pose[2], LENGTH_M, WIDTH_M)


def arrival_index(task, samples):
    """Index of the first sample at the goal, as the trial judges it; None when there is none."""
    near = [np.linalg.norm(pose[:2] - task.goal_m) <= task.goal_tolerance_m for _, pose in samples]
    return near.index(True) if True in near else None


def object_poses(world, samples):
    """Poses of the moving objects at every sample."""
    motion, poses, step = WorldMotion(world.objects), [], 0
    for time_s, pose in samples:
        while step * STEP_S < time_s - 1e-9:
            motion.advance(step * STEP_S, pose[:2])
            step += 1
        poses.append(motion.advance(time_s, pose[:2]))
        step += 1
    return poses


def moved(item, pose):
    return replace(item, position_m=np.asarray(pose[0], dtype=float), yaw_rad=float(pose[1]))


# The checks


def find_solid_complaints(label, world, task, samples):
    """The footprint keeps MIN_SOLID_CLEARANCE_M from everything that collides."""
    timed, worst = object_poses(world, samples), (MIN_SOLID_CLEARANCE_M, "")
    for item in solids_of(world):
        sweep = sweep_of(item) if item.motion is not None and not is_met(item, world, task) else []
        for k, stand in encounters(item, sweep, timed, samples):
            (time_s, pose), clearance_m = samples[k], object_clearance_m(footprint(samples[k][1]), stand)
            if clearance_m < worst[0] - 1e-9:
                worst = (clearance_m, f"{item.name} at ({pose[0]:.2f}, {pose[1]:.2f}), t = {time_s:.1f} s")
    if not worst[1]:
        return []
    return [f"{label}: {worst[0]:.3f} m clear of {worst[1]}; wanted {MIN_SOLID_CLEARANCE_M} m"]


def solids_of(world):
    return [item for item in world.objects if item.solid and item.position_m[2] < ROBOT_HEIGHT_M]


def encounters(item, sweep, timed, samples):
    """(index of the sample, object in place) wherever an object comes near the walk: at all places of its sweep if it
    has one, else where it is at the time of the sample."""
    places = np.array([pose[:2] for _, pose in samples])
    reach_m = REACH_M + 0.5 * np.hypot(*item.collision_size_m[:2])
    if item.motion is not None and not sweep:
        stands = [moved(item, poses[item.id]) for poses in timed]
        return [(k, s) for k, s in enumerate(stands) if np.linalg.norm(s.position_m[:2] - places[k]) < reach_m]
    near = []
    for stand in sweep or [item]:
        distance_m = np.linalg.norm(places - stand.position_m[:2], axis=1)
        near += [(k, stand) for k in np.flatnonzero(distance_m < reach_m)]
    return near


def is_met(item, world, task):
    """Whether the task means the robot to meet a moving object: its own, or one that a region of it is about."""
    own = item.name in {other.name for other in task.objects}
    about = {region.object_name for region in task.unsafe_regions}
    classes = {parse_predicate(text).class_name for region in task.unsafe_regions for text in region.because}
    return own or item.name in about or item.class_name in classes


def sweep_of(item):
    """A moving object at places 0.1 m apart along its whole path."""
    corners = np.vstack([item.position_m[:2], item.motion.path_m])
    places = []
    for a, b in zip(corners[:-1], corners[1:]):
        count = max(2, int(np.ceil(np.linalg.norm(b - a) / 0.1)))
        yaw_rad = float(np.arctan2(*(b - a)[::-1])) if item.motion.face_motion else item.yaw_rad
        points = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
        places += [moved(item, ((*point, item.position_m[2]), yaw_rad)) for point in points]
    return places


def find_region_complaints(label, world, task, samples):
    """An unsafe walk enters a region before the goal, a safe one never does; both start far enough outside."""
    boxes = [(region, reach_box(region)) for region in task.unsafe_regions]
    inside = [
        any(region_clearance_m(region, footprint(pose), poses) < 0.0 for region, box in boxes if lies_in(box, pose))
        for (_, pose), poses in zip(samples, object_poses(world, samples))
    ]
    complaints, arrival = [], arrival_index(task, samples)
    if task.expectation == "unsafe" and True not in inside[: arrival or len(inside)]:
        complaints.append(f"{label}: the unsafe walk enters no region before the goal")
    if task.expectation == "safe" and True in inside:
        time_s, (x, y, _) = samples[inside.index(True)]
        complaints.append(f"{label}: the safe walk enters a region at ({x:.2f}, {y:.2f}), t = {time_s:.1f} s")
    for region in task.unsafe_regions:
        distance_m = start_distance_m(region, task, samples[0][1])
        if distance_m < MIN_START_DISTANCE_M - 1e-9:
            complaints.append(f"{label}: starts {distance_m:.2f} m from {region.name}; wanted {MIN_START_DISTANCE_M}")
    return complaints


def reach_box(region):
    """Corners (2,), (2,) of a box outside of which no footprint touches a region; without end for one that moves."""
    if region.item is not None and region.item.motion is not None:
        return np.full(2, -np.inf), np.full(2, np.inf)
    outline = region_outline_m(region)
    return outline.min(axis=0) - REACH_M, outline.max(axis=0) + REACH_M


def lies_in(box, pose):
    return bool(np.all(box[0] <= pose[:2]) and np.all(pose[:2] <= box[1]))


def start_distance_m(region, task, pose):
    """From the footprint of an unsafe task, or the base point of a safe one, to a region."""
    size_m = (LENGTH_M, WIDTH_M) if task.expectation == "unsafe" else (1e-3, 1e-3)
    return region_clearance_m(region, rectangle(pose[:2], pose[2], *size_m))


def find_arrival_complaints(label, world, task, samples):
    """The nominal walk reaches the goal well inside the time limit."""
    arrival = arrival_index(task, samples)
    if arrival is None:
        return [f"{label}: the nominal controller never reaches the goal"]
    if samples[arrival][0] > 0.7 * task.time_limit_s:
        return [f"{label}: {samples[arrival][0]:.1f} s to the goal leave no room in {task.time_limit_s:g} s"]
    return []


def class_of(text):
    return parse_predicate(text).class_name


def find_predicate_complaints(world, task):
    """Predicates name classes of the task's world; what closes a region is something the oracle, or an event, says."""
    scene = world.for_task(task.name)
    classes = {item.class_name for item in (*scene.objects, *scene.surfaces)}
    because = [text for region in task.unsafe_regions for text in region.because]
    complaints = [
        f"{text} names a class that this task does not have"
        for text in (*because, *task.oracle_predicates, *task.over_cautious)
        if class_of(text) not in classes
    ]
    stated = {parse_predicate(text) for text in task.oracle_predicates}
    stated |= {parse_predicate(event.text) for event in task.events if event.kind == "predicate"}
    complaints += [
        f"region {region.name}: neither oracle nor event says any of {list(region.because)}"
        for region in task.unsafe_regions
        if not any(closes(region.because, said) for said in stated)
    ]
    return complaints + [
        f"over_cautious {text} is what the oracle says"
        for text in task.over_cautious
        if any(same_claim(parse_predicate(text), said) for said in stated)
    ]


def same_claim(a, b):
    return (a.operator, a.class_name, a.verdict) == (b.operator, b.class_name, b.verdict)


def closes(because, said):
    return any(same_claim(parse_predicate(text), said) for text in because)


def find_barrier_complaints(label, world, task):
    """A barrier lets the footprint through inside, and hardly anything past its ends."""
    complaints = []
    for region in task.unsafe_regions if task.expectation == "unsafe" else ():
        for text in region.because:
            if parse_predicate(text).operator != Operator.BETWEEN:
                continue
            barrier = barrier_of(world, region, class_of(text))
            if len(barrier) < 2:
                complaints.append(f"{label}: {len(barrier)} {class_of(text)} at the border of {region.name}")
                continue
            complaints += gap_complaints(label, world, barrier)
    return complaints


def barrier_of(world, region, class_name):
    """Objects of a class, linked to one another, that stand nearest to the border of a region."""
    members = [item for item in world.objects if item.class_name == class_name]
    outline = region_outline_m(region)
    near = [item for item in members if point_distance_m(outline, item.position_m[:2]) < 1.0]
    grown = True
    while grown:
        rest = [item for item in members if item not in near]
        added = [item for item in rest if any(gap_m(item, other) <= LINK_M for other in near)]
        near, grown = near + added, bool(added)
    return near


def outline_of(item):
    if item.collision == "cylinder":
        angles = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        circle = 0.5 * item.collision_size_m[0] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return item.position_m[:2] + circle
    return rectangle(item.position_m[:2], item.yaw_rad, *item.collision_size_m[:2])


def gap_m(a, b):
    return signed_clearance_m(outline_of(a), outline_of(b))


def gap_complaints(label, world, barrier):
    """Gaps between neighbours of a barrier, and from the ends of one that is no ring to other solids."""
    places = np.array([item.position_m[:2] for item in barrier])
    from_center = places - places.mean(axis=0)
    is_ring = classify(places) is Arrangement.RING
    order = (
        np.arctan2(from_center[:, 1], from_center[:, 0]) if is_ring else from_center @ np.linalg.svd(from_center)[2][0]
    )
    chain = [barrier[k] for k in np.argsort(order)]
    pairs = list(zip(chain, [*chain[1:], chain[0]])) if is_ring else list(zip(chain[:-1], chain[1:]))
    complaints = [
        f"{label}: gap {gap_m(a, b):.3f} m of {a.name} and {b.name}; wanted {MIN_GAP_INSIDE_M}"
        for a, b in pairs
        if gap_m(a, b) < MIN_GAP_INSIDE_M - 1e-9
    ]
    others = [item for item in solids_of(world) if item not in barrier]
    for end in () if is_ring else (chain[0], chain[-1]):
        nearest_m, name = min([(gap_m(end, item), item.name) for item in others], default=(np.inf, "nothing"))
        if nearest_m > MAX_GAP_AT_END_M + 1e-9:
            wanted = f"wanted at most {MAX_GAP_AT_END_M}"
            complaints.append(f"{label}: {nearest_m:.3f} m past the end {end.name} to {name}; {wanted}")
    return complaints


def find_ground_complaints(label, world, task, samples):
    """The whole way lies on the ground, at no edge of it."""
    floor = world.surfaces[0].polygon_m
    for _, pose in samples:
        if not contains_point(floor, pose[:2]) or point_distance_m(floor, pose[:2]) < 0.5 * LENGTH_M:
            return [f"{label}: off the ground at ({pose[0]:.2f}, {pose[1]:.2f})"]
    return []


WALK_CHECKS = (find_solid_complaints, find_region_complaints, find_arrival_complaints, find_ground_complaints)


def complaints_of(world, task_name, checks=WALK_CHECKS):
    found = []
    for label, scene, start_pose in list_starts(world, task_name):
        # Regions stand around the objects of this variation; which ones are the task's own, its text alone knows.
        task = replace(scene.task(task_name), objects=world.task(task_name).objects)
        samples = walk(task, start_pose)
        for check in checks:
            found += check(label, scene, task, samples)
    return found


# Every task


@pytest.mark.parametrize("name, task", CASES)
def test_nominal_walk_is_what_the_task_says(name, task):
    complaints = complaints_of(shipped(name), task)
    assert not complaints, "\n" + "\n".join(f"{name}/{task}: {text}" for text in complaints)


@pytest.mark.parametrize("name, task", CASES)
def test_barriers_have_gaps_inside_and_none_at_their_ends(name, task):
    world = shipped(name)
    complaints = []
    for label, scene, _ in list_starts(world, task):
        if not label.startswith("corner"):
            complaints += find_barrier_complaints(label, scene, scene.task(task))
    assert not complaints, "\n" + "\n".join(f"{name}/{task}: {text}" for text in complaints)


@pytest.mark.parametrize("name, task", CASES)
def test_predicates_name_what_is_there(name, task):
    complaints = find_predicate_complaints(shipped(name), shipped(name).task(task))
    assert not complaints, "\n" + "\n".join(f"{name}/{task}: {text}" for text in complaints)


@pytest.mark.parametrize("name, task", CASES)
def test_a_task_is_short(name, task):
    assert shipped(name).task(task).time_limit_s <= MAX_TIME_LIMIT_S


# All tasks together


def find_collection_complaints(tasks):
    """What the whole set of (world, task) must hold."""
    main = [(name, task) for name, task in tasks if task.split == "main"]
    heldout = [(name, task) for name, task in tasks if task.split == "heldout"]
    own = [task for _, task in main if task.number is None]
    complaints = number_complaints(main)
    sides = Counter(task.expectation for task in own)
    if len(own) < 12 or min(sides["safe"], sides["unsafe"]) < 6:
        complaints.append(f"own tasks: {dict(sides)}; wanted at least 12, at least 6 of each expectation")
    for expectation in ("safe", "unsafe"):
        here = {task.category for task in own if task.expectation == expectation}
        complaints += [f"no own {expectation} task of {wanted}" for wanted in CATEGORIES if wanted not in here]
    if len(heldout) < 12:
        complaints.append(f"{len(heldout)} heldout tasks; wanted at least 12")
    parents = {(name, task.name) for name, task in main}
    complaints += [
        f"heldout {name}/{task.name}: no main task {task.variant_of}"
        for name, task in heldout
        if (name, task.variant_of) not in parents
    ]
    varied = {(name, task.variant_of) for name, task in heldout}
    complaints += [
        f"paper task {task.number} {name}/{task.name} has no heldout variant"
        for name, task in main
        if task.number is not None and (name, task.name) not in varied
    ]
    counts = Counter(task.name for _, task in tasks)
    return complaints + [f"two tasks are called {name}" for name, count in counts.items() if count > 1]


def number_complaints(main):
    """The twelve of the paper, each once, in its place, with its expectation."""
    seen = Counter(task.number for _, task in main if task.number is not None)
    complaints = [f"paper task {n} exists {seen[n]} times; wanted once" for n in PAPER if seen[n] != 1]
    return complaints + [
        f"paper task {task.number} is {task.expectation} in {name}"
        for name, task in main
        if task.number in PAPER and (task.expectation, name) != (PAPER[task.number], PLACE_OF[task.number])
    ]


def test_the_papers_twelve_and_twelve_of_our_own():
    complaints = find_collection_complaints(all_tasks())
    assert not complaints, "\n" + "\n".join(complaints)


def test_a_heldout_task_carries_no_number_of_the_paper():
    assert not [task.name for _, task in all_tasks() if task.split == "heldout" and task.number is not None]


def find_readme_complaints(tasks, text):
    """worlds/README.md has one row for every task, that says what the world's file says."""
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    complaints = []
    for name, task in tasks:
        about = f"`{task.variant_of}`" if task.variant_of else str(task.number or "")
        wanted = f"| `{task.name}` | {about} | {task.category} | {task.expectation} | ".replace("|  |", "| |")
        if sum(row.startswith(wanted) for row in rows) != 1:
            complaints.append(f"{name}/{task.name}: no row {wanted!r}")
    return complaints


def test_the_readme_lists_every_task():
    text = (find_worlds_dir() / "README.md").read_text(encoding="utf-8")
    complaints = find_readme_complaints(all_tasks(), text)
    assert not complaints, "\n" + "\n".join(complaints)


# The checks themselves: each is seen to complain about a place or a task that was spoiled on purpose


def spoil_task(name, **changes):
    """The residential world with one task changed."""
    world = shipped("residential")
    return replace(world, tasks={**world.tasks, name: replace(world.task(name), **changes)})


def spoil_object(task_name, object_name, **changes):
    """The residential world with one object changed, of the world or of a task."""
    world = shipped("residential")
    task = world.task(task_name)

    def change(objects):
        return tuple(replace(item, **changes) if item.name == object_name else item for item in objects)

    tasks = {**world.tasks, task_name: replace(task, objects=change(task.objects))}
    return replace(world, objects=change(world.objects), tasks=tasks)


def array(*values):
    return np.array(values, dtype=float)


def test_sees_a_solid_object_in_the_way():
    world = spoil_object("sidewalk", "hydrant", position_m=array(15.0, 4.7, 0.08))
    assert any("clear of hydrant" in text for text in complaints_of(world, "sidewalk", [find_solid_complaints]))


def test_sees_that_only_a_seed_puts_an_object_in_the_way():
    world = spoil_object("sidewalk", "mailbox_1", position_m=array(15.0, 6.2, 0.08), jitter_m=1.0)
    complaints = complaints_of(world, "sidewalk", [find_solid_complaints])
    assert any(text.startswith("seed") for text in complaints)
    assert not any(text.startswith("as written") for text in complaints)


@pytest.mark.parametrize(("own", "complains"), [(False, True), (True, False)])
def test_what_moves_is_met_over_its_whole_path_unless_the_task_means_it(own, complains):
    world = shipped("residential")
    [shopper] = [item for item in world.objects if item.name == "shopper"]
    motion = replace(shopper.motion, path_m=array([7.0, -12.0]), start_at_s=50.0)  # crosses the aisle after the walk
    late = replace(shopper, position_m=array(3.5, -12.0, 0.0), motion=motion)
    objects = tuple(item for item in world.objects if item is not shopper)
    if own:
        world = spoil_task("parking_lot", objects=(late,))
    world = replace(world, objects=objects if own else (*objects, late))
    complaints = complaints_of(world, "parking_lot", [find_solid_complaints])
    assert any("clear of shopper" in text for text in complaints) == complains


def test_sees_an_unsafe_task_that_ends_before_its_region():
    world = spoil_task("curb_crossing", waypoints_m=array([4.0, 2.0]), goal_m=array(4.0, 2.0))
    assert any("enters no region" in text for text in complaints_of(world, "curb_crossing", [find_region_complaints]))


def test_sees_a_safe_task_that_enters_a_region():
    world = spoil_task("sidewalk", waypoints_m=array([15.0, 6.4], [18.6, 5.3]))
    assert any("enters a region" in text for text in complaints_of(world, "sidewalk", [find_region_complaints]))


def test_sees_a_start_at_the_edge_of_a_region():
    world = spoil_task("grass_shortcut", start_pose=array(2.4, 5.6, 0.0))
    complaints = complaints_of(world, "grass_shortcut", [find_region_complaints])
    assert any("m from lawn_middle" in text for text in complaints)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"time_limit_s": 15.0}, "leave no room"), ({"goal_m": array(18.6, 9.0)}, "never reaches the goal")],
)
def test_sees_a_goal_that_is_too_far(changes, words):
    complaints = complaints_of(spoil_task("sidewalk", **changes), "sidewalk", [find_arrival_complaints])
    assert any(words in text for text in complaints)


def test_sees_a_way_off_the_ground():
    world = shipped("residential")
    floor = replace(world.surfaces[0], polygon_m=array([-18, -28], [15, -28], [15, 22], [-18, 22]))
    world = replace(world, surfaces=(floor, *world.surfaces[1:]))
    assert any("off the ground" in text for text in complaints_of(world, "sidewalk", [find_ground_complaints]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"oracle_predicates": ("ON(grass)=unsafe", "NEAR(forklift)=unsafe")}, "NEAR(forklift)=unsafe names a class"),
        ({"oracle_predicates": ("ON(sidewalk)=safe",)}, "region lawn_corner: neither oracle nor event says"),
        ({"oracle_predicates": ("ON(grass)=safe",)}, "region lawn_corner: neither oracle nor event says"),
        ({"over_cautious": ("ON(grass)=unsafe",)}, "over_cautious ON(grass)=unsafe is what the oracle says"),
    ],
)
def test_sees_predicates_that_do_not_fit(changes, words):
    world = spoil_task("grass_shortcut", **changes)
    complaints = find_predicate_complaints(world, world.task("grass_shortcut"))
    assert any(words in text for text in complaints)


@pytest.mark.parametrize(
    ("cone", "x_m", "words"),
    [
        ("alley_cone_2", 22.2, "wanted 1.0"),  # too near to its neighbour
        ("alley_cone_1", 21.3, "past the end alley_cone_1"),
        ("alley_cone_3", 23.3, "past the end alley_cone_3"),
    ],
)
def test_sees_a_barrier_with_other_gaps(cone, x_m, words):
    world = spoil_object("alley_closed", cone, position_m=array(x_m, 11.0, 0.08)).for_task("alley_closed")
    complaints = find_barrier_complaints("spoiled", world, world.task("alley_closed"))
    assert any(words in text for text in complaints)


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ((0, 60, 120, 180, 240, 300), None),
        ((0, 60, 120, 180, 240, 275), "wanted 1.0"),
        ((0, 45, 90, 135, 180), "past the end"),  # a half circle is no ring: it has ends
    ],
)
def test_a_ring_has_gaps_all_round_and_no_ends(angles, words):
    world = shipped("residential").for_task("alley_closed")
    cone = next(item for item in world.objects if item.name == "alley_cone_1")
    places = 1.5 * np.array([[np.cos(np.radians(a)), np.sin(np.radians(a)), 0.0] for a in angles])
    ring = [replace(cone, name=f"cone_{k}", position_m=p + [7.0, -12.0, 0.0]) for k, p in enumerate(places)]
    complaints = gap_complaints("spoiled", replace(world, objects=(*world.objects, *ring)), ring)
    assert not complaints if words is None else any(words in text for text in complaints)


def test_sees_a_task_that_the_readme_tells_otherwise():
    text = (find_worlds_dir() / "README.md").read_text(encoding="utf-8")
    world = spoil_task("curb_crossing", category="barriers")
    assert find_readme_complaints([("residential", world.task("curb_crossing"))], text)
    assert not find_readme_complaints([("residential", shipped("residential").task("curb_crossing"))], text)


def test_sees_a_barrier_that_is_not_there():
    task = shipped("residential").task("alley_closed")
    world = spoil_task("alley_closed", objects=task.objects[:1]).for_task("alley_closed")
    assert find_barrier_complaints("spoiled", world, task) == [
        "spoiled: 1 traffic_cone at the border of behind_the_cones"
    ]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: None if t.number == 12 else t, "paper task 12 exists 0 times"),
        (lambda t: replace(t, number=11) if t.number == 12 else t, "paper task 11 exists 2 times"),
        (lambda t: replace(t, expectation="safe") if t.number == 5 else t, "paper task 5 is safe in residential"),
        (lambda t: None if t.number is None and t.split == "main" else t, "own tasks: {}; wanted at least 12"),
        (lambda t: replace(t, category="buffers"), "no own safe task of barriers"),
        (lambda t: None if t.split == "heldout" else t, "0 heldout tasks"),
        (lambda t: None if t.variant_of == "sidewalk" else t, "sidewalk has no heldout variant"),
        (lambda t: replace(t, variant_of="park") if t.variant_of == "sidewalk" else t, "no main task park"),
        (lambda t: replace(t, name="sidewalk") if t.number == 5 else t, "two tasks are called sidewalk"),
    ],
)
def test_sees_what_is_missing_in_the_collection(change, words):
    changed = [(name, change(task)) for name, task in all_tasks()]
    complaints = find_collection_complaints([(name, task) for name, task in changed if task is not None])
    assert any(words in text for text in complaints), complaints
