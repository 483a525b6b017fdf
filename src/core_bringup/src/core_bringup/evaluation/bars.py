# SPDX-License-Identifier: BSD-3-Clause
"""How every bench ends: its figures held against their bars, a table for people and one JSON object for programs."""

from __future__ import annotations

import json
import operator
import sys
from typing import Any, Dict, Mapping, Tuple

HOLDS = {"==": operator.eq, ">=": operator.ge, "<=": operator.le}


def judge(bars: Mapping[str, Tuple[float, str, float]]) -> Dict[str, Dict[str, Any]]:
    """Name -> figure, bar and whether it is met, of name -> (figure, ==, >= or <=, limit). NaN meets no bar."""
    return {
        name: {"figure": figure, "bar": f"{sign} {limit:g}", "met": bool(HOLDS[sign](figure, limit))}
        for name, (figure, sign, limit) in bars.items()
    }


def finish(results: Dict[str, Any], bars: Mapping[str, Mapping[str, Any]]) -> int:
    """Print the bars on stderr and all results with them as the last line of stdout.

    Args:
        results: what was measured; gets the key "bars".
        bars: as judge() gives them; a key "where" is printed behind a bar.

    Returns:
        Exit status: 0 when every bar is met, else 1.
    """
    results["bars"] = bars
    width = max([28, *(len(name) + 2 for name in bars)])
    for name, bar in bars.items():
        met = "met" if bar["met"] else "NOT MET"
        print(
            f"{name:{width}}{bar['figure']:>12.6g}   bar {bar['bar']:10} {met:8} {bar.get('where', '')}".rstrip(),
            file=sys.stderr,
        )
    print(json.dumps(results, sort_keys=True))
    return 0 if all(bar["met"] for bar in bars.values()) else 1
