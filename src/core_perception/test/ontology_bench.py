# SPDX-License-Identifier: BSD-3-Clause
"""Measures the embedded reasoner: categories of names of public data sets, time a frame, rates of arrangements."""

import csv
import time
from pathlib import Path

import arrangement_scenes as scenes
import numpy as np

from core_perception.arrangement import classify, cluster
from core_perception.ontology import Ontology
from core_perception.reasoners.base import Evidence, HeldInstance
from core_perception.reasoners.ontology_reasoner import OntologyReasoner

PACKAGE_DIR = Path(__file__).resolve().parents[1]
DATA_DIR = Path(__file__).resolve().parent / "data"
# Drawn and labelled before the ontology was run on them, the second after the fixes that the first led to.
NAME_LISTS = ("class_names_heldout.csv", "class_names_heldout_2.csv")
# Right answers of the first run on each list, of the ontology as it was then: no later run can measure them again.
FIRST_SHOT_RIGHT = {"class_names_heldout.csv": 147, "class_names_heldout_2.csv": 126}
NAVIGABLE, OBSTACLE = "navigable_surface", "metric_obstacle"


def read_names(name):
    """Return (name, accepted categories) of every row of a list."""
    with (DATA_DIR / name).open(encoding="utf-8", newline="") as file:
        return [(row["name"], row["accepted_categories"].split("|")) for row in csv.DictReader(file)]


def judge_names(ontology, rows):
    """Return the counts of a list of (name, accepted categories)."""
    judged = [(ontology.look_up(name).categories[0].value, accepted) for name, accepted in rows]
    return {
        "names": len(judged),
        "right": sum(got in accepted for got, accepted in judged),
        "always_obstacle_right": sum(OBSTACLE in accepted for _, accepted in judged),
        "rare": sum(OBSTACLE not in accepted for _, accepted in judged),
        "rare_right": sum(got in accepted for got, accepted in judged if OBSTACLE not in accepted),
        "called_navigable": sum(got == NAVIGABLE and NAVIGABLE not in accepted for got, accepted in judged),
    }


def milliseconds_per_frame(ontology, frames=200, seed=0):
    """Return the mean CPU time of reason() [ms]: 20 classes, 5 of them unknown and new, and 30 instances that move."""
    rng, reasoner = np.random.default_rng(seed), OntologyReasoner(ontology)
    unknown = [name for file in NAME_LISTS for name, _ in read_names(file)]
    names = list(rng.choice(ontology.vocabulary, 15, replace=False))
    classes = ["traffic_cone", "stanchion", "person", "road_flare", "cardboard_box"]
    places_m = rng.uniform(0.0, 12.0, (30, 2))
    spent_s = 0.0
    for frame in range(frames):
        places_m += rng.normal(0.0, 0.05, places_m.shape)
        # A prefix makes the name new to every cache.
        fresh = [f"kind{frame}x{k}_{name}" for k, name in enumerate(rng.choice(unknown, 5))]
        instances = tuple(HeldInstance(k + 1, classes[k % 5], tuple(place)) for k, place in enumerate(places_m))
        evidence = Evidence(frame, (*names, *fresh), instances, history_start_ns=1)
        start = time.process_time()
        reasoner.reason(evidence)
        spent_s += time.process_time() - start
    return 1e3 * spent_s / frames


def blocking_rate(scene, trials, rng):
    """Return the share of scenes in which some cluster blocks."""
    blocked = 0
    for _ in range(trials):
        points = scene(rng)
        blocked += any(classify(points[group]).blocks for group in cluster(points))
    return blocked / trials


def arrangement_rates(trials, seed):
    """Return scene -> share of scenes that block; of the scatters the number of objects with the largest share."""
    families = {
        name: scenes.GENERATORS[name] for name in ("line", "arc", "ring", "square", "corner", "line_of_three", "lane")
    }
    rates = {
        name: blocking_rate(scene, trials, np.random.default_rng([seed, k]))
        for k, (name, scene) in enumerate(families.items())
    }
    for side_m in (3.0, 6.0):
        by_count = {
            count: blocking_rate(
                lambda rng, count=count, side_m=side_m: scenes.scatter_of(rng, count, side_m),
                trials,
                np.random.default_rng([seed, 100 + count, int(side_m)]),
            )
            for count in range(4, 11)
        }
        rates[f"scatter_{side_m:g}m"] = float(np.mean(list(by_count.values())))
        rates[f"scatter_{side_m:g}m_worst_count"] = max(by_count.values())
    return rates


def run(trials=2000, seed=0) -> dict:
    """Return every figure of the embedded reasoner.

    Args:
        trials: scenes of each kind of arrangement.
        seed: of the scenes.
    """
    ontology = Ontology.load(PACKAGE_DIR / "config" / "ontology.yaml")
    lists = {name: judge_names(ontology, read_names(name)) for name in NAME_LISTS}
    total = {key: sum(counts[key] for counts in lists.values()) for key in lists[NAME_LISTS[0]]}
    return {
        "names": total["names"],
        "accuracy": total["right"] / total["names"],
        "accuracy_first_shot": {name: FIRST_SHOT_RIGHT[name] / lists[name]["names"] for name in NAME_LISTS},
        "accuracy_always_obstacle": total["always_obstacle_right"] / total["names"],
        "accuracy_not_obstacles": total["rare_right"] / total["rare"],
        "hazards_called_navigable": total["called_navigable"],
        "wordnet_problem": ontology.wordnet_problem,
        "ms_per_frame": milliseconds_per_frame(ontology),
        "arrangements": arrangement_rates(trials, seed),
    }
