# SPDX-License-Identifier: BSD-3-Clause
"""Keeps an arrangement of held instances in force while enough of them are held.

As the robot comes near, members leave the view or the map refines their place; a barrier that was seen once must not
flicker with that.
"""

from __future__ import annotations

from collections import Counter
from typing import Dict, FrozenSet, List, Sequence, Tuple

import numpy as np

from core_perception.arrangement import Arrangement, classify, cluster

MOVED_M = 0.02


class ArrangementMemory:
    """Arrangements of one class."""

    def __init__(self, link_m: float, frames_of_three: int):
        """Start empty.

        Args:
            link_m: single-link distance where no clusters are given [m].
            frames_of_three: updates in a row that must see an arrangement of three members before it counts.
        """
        self._link_m, self._frames_of_three = link_m, frames_of_three
        self._in_force: Dict[FrozenSet[int], Arrangement] = {}
        self._of_three: Counter = Counter()
        self._judged: Dict[FrozenSet[int], Tuple[np.ndarray, Arrangement]] = {}

    def update(
        self, ids: Sequence[int], positions_m: np.ndarray, clusters: Sequence[int]
    ) -> Tuple[Tuple[Arrangement, FrozenSet[int]], ...]:
        """Take in the instances held now and return what is in force.

        A blocking shape comes into force when it is seen; with three members only after frames_of_three updates in a
        row. It leaves when fewer than two of its members are held, or when its members are found to be part of a lane.
        It grows with its cluster.

        Args:
            ids: (n,) instance numbers, ascending.
            positions_m: (n, 2) their places on the ground [m].
            clusters: (n,) cluster numbers of the map, 0 for none; where all are > 0 they are used, otherwise single
                link.

        Returns:
            Per arrangement in force its shape when it was last recognised and its members that are held, ordered by
            member number.
        """
        held = frozenset(ids)
        self._in_force = {m: shape for m, shape in self._in_force.items() if len(m & held) >= 2}
        seen_threes, groups = set(), self._groups(positions_m, clusters)
        places_m = {frozenset(ids[i] for i in group): positions_m[group] for group in groups}
        self._judged = {members: self._judge(members, places) for members, places in places_m.items()}
        for members, (_, shape) in self._judged.items():
            if shape == Arrangement.LANE:
                self._forget(members)
            elif shape.blocks and (len(members) > 3 or self._confirmed(members, seen_threes)):
                self._forget(members)
                self._in_force[members] = shape
        self._of_three = Counter({m: n for m, n in self._of_three.items() if m in seen_threes})
        ordered = sorted(self._in_force.items(), key=lambda item: min(item[0]))
        return tuple((shape, members & held) for members, shape in ordered)

    def _groups(self, positions_m, clusters) -> List[np.ndarray]:
        if len(clusters) and min(clusters) > 0:
            return [np.flatnonzero(np.asarray(clusters) == c) for c in sorted(set(clusters))]
        return cluster(positions_m, self._link_m)

    def _judge(self, members, positions_m):
        """Places and shape of a group; what was judged before is judged anew only when some member has moved."""
        known = self._judged.get(members)
        if known is not None and np.abs(known[0] - positions_m).max() <= MOVED_M:
            return known
        return positions_m, classify(positions_m)

    def _confirmed(self, members, seen_threes):
        seen_threes.add(members)
        self._of_three[members] += 1
        return self._of_three[members] >= self._frames_of_three

    def _forget(self, members):
        self._in_force = {m: shape for m, shape in self._in_force.items() if not m & members}
