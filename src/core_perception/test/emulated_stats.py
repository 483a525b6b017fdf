# SPDX-License-Identifier: BSD-3-Clause
"""Rates and latencies of many emulated replies, beside the printed tables they emulate.

python src/core_perception/test/emulated_stats.py [REPLIES]
"""

import json
import math
import statistics
import sys
from pathlib import Path

PACKAGE_DIR = Path(__file__).resolve().parents[1]
if str(PACKAGE_DIR / "src") not in sys.path:
    sys.path.insert(0, str(PACKAGE_DIR / "src"))

from core_perception.ontology import Ontology  # noqa: E402
from core_perception.predicates import parse_predicate  # noqa: E402
from core_perception.reasoners.base import Evidence, HeldInstance  # noqa: E402
from core_perception.reasoners.emulated_reasoner import EmulatedReasoner, load_rows  # noqa: E402

# [CORE] Tables II and III, as printed: safe, unsafe, latency [s]. Written out here so that config/emulated.yaml cannot
# agree with itself.
TABLE = {
    "gemma3-12b": (0.83, 0.67, 2.2),
    "llava-13b": (0.0, 0.0, 2.7),
    "gemma3-27b": (0.91, 0.85, 4.1),
    "qwen3-vl-30b": (0.77, 0.73, 26.6),
    "llava-34b": (0.49, 0.56, 6.0),
    "full-prompt": (0.91, 0.85, 4.1),
    "no-safety-logic": (0.90, 0.80, 4.1),
    "no-cot-reasoning": (0.61, 0.77, 2.8),
}
STD_OVER_MEAN = 0.45 / 4.37
LEVEL = 0.999
Z = statistics.NormalDist().inv_cdf(0.5 + LEVEL / 2.0)

SURFACES = frozenset({"ON(floor)=safe", "ON(carpet)=safe"})
HAZARDS = frozenset(
    {
        "NEAR(traffic_cone)=unsafe",
        "BETWEEN(traffic_cone)=unsafe",
        "NEAR(forklift)=unsafe",
        "AROUND(forklift, 1.5)=unsafe",
        "NEAR(table)=unsafe",
    }
)


def wilson(count, total):
    """Wilson score interval of count / total at LEVEL."""
    share, z2 = count / total, Z * Z
    middle = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = Z * math.sqrt(share * (1 - share) / total + z2 / (4 * total * total)) / (1 + z2 / total)
    return max(0.0, middle - half), min(1.0, middle + half)


def scene(number, stamp_ns):
    """Cones in a line, a forklift and a table on floor and carpet; the instance numbers are new in every scene."""
    first = 10 * number + 1
    cones = [HeldInstance(first + k, "traffic_cone", (4.0, 1.2 * k), first) for k in range(5)]
    others = [HeldInstance(first + 5, "forklift", (6.0, -2.0), first + 5)]
    others.append(HeldInstance(first + 6, "table", (2.0, 3.0), first + 6))
    return Evidence(stamp_ns, ("floor", "carpet"), tuple(cones + others))


def parts_right(answer):
    """Whether the safe and the unsafe part of an answer are the true ones; both wrong in a void answer."""
    if answer.constraints is None:
        return False, False
    said = {str(p) for p in answer.constraints.predicates}
    about_surfaces = {text for text in said if text.startswith("ON(")}
    return about_surfaces == SURFACES, said - about_surfaces == HAZARDS


def _compare(value, low, high, printed):
    return {"value": value, "low": low, "high": high, "table": printed, "agrees": low <= printed <= high}


def _rate(flags, printed):
    return _compare(sum(flags) / len(flags), *wilson(sum(flags), len(flags)), printed)


def _latency(latencies_s, printed_s):
    """Normal intervals of the mean and of the standard deviation; the latter's error from the fourth moment."""
    n, mean, std = len(latencies_s), statistics.fmean(latencies_s), statistics.stdev(latencies_s)
    fourth = sum((x - mean) ** 4 for x in latencies_s) / n
    error, std_error = std / math.sqrt(n), math.sqrt((fourth - std**4) / n) / (2 * std)
    return (
        _compare(mean, mean - Z * error, mean + Z * error, printed_s),
        _compare(std, std - Z * std_error, std + Z * std_error, printed_s * STD_OVER_MEAN),
    )


def run_row(row, ontology, replies, correlation="independent", seed=0):
    """Draw replies of one row, each of a new image of a new scene."""
    reasoner = EmulatedReasoner(
        [parse_predicate(t) for t in sorted(SURFACES | HAZARDS)], row, correlation, seed, ontology
    )
    answers = [reasoner.reason(scene(k, 100_000_000 * k)) for k in range(replies)]
    right = [parts_right(answer) for answer in answers]
    safe, unsafe, latency_s = TABLE[row.name]
    mean, std = _latency([answer.latency_ns / 1e9 for answer in answers], latency_s)
    return {
        "safe": _rate([r[0] for r in right], safe),
        "unsafe": _rate([r[1] for r in right], unsafe),
        "both": _rate([r[0] and r[1] for r in right], safe * unsafe),
        "latency_mean_s": mean,
        "latency_std_s": std,
        "void": sum(answer.constraints is None for answer in answers),
    }


def run(replies, names=tuple(TABLE), correlation="independent", seed=0):
    """Compare rows with the tables; ``agrees`` is true when every interval of level LEVEL holds the printed figure."""
    ontology = Ontology.load(PACKAGE_DIR / "config" / "ontology.yaml")
    rows = load_rows(PACKAGE_DIR / "config" / "emulated.yaml")
    results = {name: run_row(rows[name], ontology, replies, correlation, seed) for name in names}
    agrees = all(entry["agrees"] for row in results.values() for entry in row.values() if isinstance(entry, dict))
    return {"replies": replies, "level": LEVEL, "correlation": correlation, "agrees": agrees, "rows": results}


if __name__ == "__main__":
    print(json.dumps(run(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)))
