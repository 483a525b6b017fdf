# SPDX-License-Identifier: BSD-3-Clause
"""What bench soundness counts, on cases with known answers, and a short run of every case of it."""

import itertools

import numpy as np
import pytest
from control_support import LENGTH_M, WIDTH_M, Plant, footprint_overlaps, make_field, make_random_mask
from soundness_cases import CASES, CELL_M, CELLS, Excuses, KnownMap, Tally, find_overlapped, make_filter, run_episode
from soundness_shards import SHARD_EPISODES, ShardFile, compute_key, hash_sources

HALF_M = (LENGTH_M / 2.0, WIDTH_M / 2.0)


def run(case, profile, episodes=3, steps=150, **options):
    tally = Tally()
    for seed in range(episodes):
        tally.add(run_episode(case, profile, seed, steps, **options))
    return tally


@pytest.mark.parametrize("case", list(CASES))
def test_core_is_never_in_a_cell_it_could_have_kept_out_of(case):
    tally = run(case, "core")
    assert tally.steps >= 300
    assert tally.avoidable_violating_steps == 0
    assert CASES[case].revealed or tally.violating_steps == 0
    assert tally.passed > 0.2 * tally.steps


def test_a_hazard_that_appears_as_near_as_the_discs_reach_is_not_entered_by_a_corner_of_the_body():
    # Stopping brings the discs into the cell but not the body; no deeper for the discs was in for the body.
    assert run_episode("revealed_map", "core", 1439).avoidable_violating_steps == 0


def test_the_papers_form_is_found_to_violate():
    assert run("point", "paper", episodes=10).violating_steps > 0
    assert run("footprint", "paper").violating_steps > 0


def test_a_filter_that_heeds_nothing_is_found_out(monkeypatch):
    monkeypatch.setattr("core_control.cbf_filter.CbfFilter.step", lambda self, inputs: PassedOn(inputs.u_nominal))
    for case in CASES:
        assert run(case, "core").avoidable_violating_steps > 0


class PassedOn:
    """A result of a filter that lets everything pass."""

    reason = ""

    def __init__(self, u):
        self.u_safe = u


def test_the_design_of_comparison_keeps_out_too():
    tally = run("footprint_lag", "core", design="reference")
    assert tally.violating_steps == 0
    assert tally.passed > 0.2 * tally.steps


def test_overlaps_agree_with_those_of_separating_axes_over_all_cells():
    rng = np.random.default_rng(0)
    for _ in range(20):
        field = make_field(make_random_mask(rng, CELLS), resolution_m=CELL_M)
        poses = np.column_stack([rng.uniform(field.lo_m, field.hi_m, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
        for pose in poses:
            found = find_overlapped(field.unsafe, field.lo_m, pose[None], HALF_M)
            assert bool(found) == footprint_overlaps(field, pose)
        together = find_overlapped(field.unsafe, field.lo_m, poses, HALF_M)
        apart = [find_overlapped(field.unsafe, field.lo_m, pose[None], HALF_M) for pose in poses]
        assert together == set().union(*apart)


def test_a_cell_is_excused_only_if_no_stop_at_its_first_tick_kept_out_of_it():
    unsafe = np.zeros((CELLS, CELLS), dtype=bool)
    lo_m = np.full(2, -CELLS * CELL_M / 2.0)
    ahead, here = np.array([[2.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0]])
    unsafe[CELLS // 2, CELLS // 2] = True  # around (0.1, 0.1)
    cell = int(np.flatnonzero(unsafe)[0])
    excuses = Excuses(HALF_M)
    assert excuses.judge({cell}) == (False, False), "not known yet"
    excuses.learn(unsafe, lo_m, here)
    assert excuses.judge({cell}) == (True, False), "it appeared below the robot"
    excuses.learn(np.zeros_like(unsafe), lo_m, here)
    assert excuses.judge({cell}) == (False, False), "gone again"
    excuses.learn(unsafe, lo_m, ahead)
    assert excuses.judge({cell}) == (True, True), "a stop kept out of it"
    excuses.learn(unsafe, lo_m, here)
    assert excuses.judge({cell}) == (True, True), "it was known before"
    assert excuses.judge({-1}) == (True, True), "outside of the grid"


def test_hazards_of_a_revealed_map_appear_near_the_robot_and_stay():
    rng = np.random.default_rng(1)
    truth = make_random_mask(rng, CELLS)
    known = KnownMap(truth, True, "core", rng)
    iy, ix = np.argwhere(truth)[0]
    near = np.append(known.field.compute_centre(np.array([iy]), np.array([ix]))[0], 0.0)
    away_m = np.hypot(*(known.field.compute_centre(*np.nonzero(truth)) - near[:2]).T)
    shares = []
    for tick in range(0, 200, 2):
        assert known.look(tick, near)
        assert not known.look(tick + 1, near)
        shares.append(float(known.field.unsafe[truth][away_m < 2.0].mean()))
    assert shares[0] < 0.7, "most of it is hidden at first"
    assert min(shares[-20:]) > 0.9, "what is near is known in the end, but for flicker"
    assert known.field.unsafe[truth][away_m > 6.0].mean() < 0.1, "what is far away is hidden"


@pytest.mark.parametrize("case", ["footprint_lag", "revealed_map"])
def test_an_episode_does_not_depend_on_those_before_it(case):
    make_filter.cache_clear()
    fresh = [run_episode(case, "core", seed, 60) for seed in (3, 4)]
    assert [run_episode(case, "core", seed, 60) for seed in (4, 3)] == fresh[::-1]


def test_a_predicted_stop_is_what_the_plant_does_without_commands():
    plant = Plant(np.array([1.0, 2.0, 0.5]), 0.1, delay_ticks=2)
    for _ in range(4):
        plant.step(np.array([0.5, 0.2, 0.8]))
    poses = plant.predict_stop()
    np.testing.assert_array_equal(poses[0], plant.pose)
    driven = np.concatenate([plant.step(np.zeros(3)) for _ in range(18)])
    np.testing.assert_allclose(poses[1 : len(driven) + 1], driven[: len(poses) - 1], atol=1e-5)
    assert np.linalg.norm(poses[-1] - driven[-1]) < 1e-3


def test_shards_add_up_over_interrupted_runs(tmp_path):
    path, one = tmp_path / "deep" / "core_point.jsonl", Tally(steps=500, passed=300, episodes=1, bad_seeds=[7])
    shards = ShardFile(path)
    for number in (0, 2):
        shards.append(number, one)
    with path.open("a") as stream:
        stream.write('{"shard": 3, "steps": 5')
    again = ShardFile(path)
    assert again.tally == Tally(steps=1000, passed=600, episodes=2, bad_seeds=[7, 7])
    assert list(itertools.islice(again.find_missing(), 3)) == [1, 3, 4]
    again.append(1, one)
    again.append(1, one)
    assert ShardFile(path).tally.steps == again.tally.steps == 1500
    assert SHARD_EPISODES >= 1


def test_the_key_follows_the_code_and_not_its_comments(tmp_path):
    a, b = tmp_path / "a.py", tmp_path / "b.py"
    a.write_text("x = 1\n")
    b.write_text("y = 2\n")
    key = hash_sources([a, b])
    a.write_text("# why\nx  =  1\n")
    assert hash_sources([b, a]) == key
    a.write_text("x = 2\n")
    assert hash_sources([a, b]) != key
    assert compute_key() == compute_key() != key
