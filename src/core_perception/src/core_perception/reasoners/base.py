# SPDX-License-Identifier: BSD-3-Clause
"""The interface of a reasoner and the evidence it is given."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Tuple

from core_perception.predicates import Constraints


@dataclass(frozen=True)
class HeldInstance:
    """One object of the instance memory, as a reasoner sees it.

    Attributes:
        id: number given by the memory, stable while the object is held; > 0.
        class_name: canonical class name.
        position_m: centre of the footprint x, y [m] in the fixed frame of the map.
        cluster: number of the cluster it belongs to; 0 if the memory gives none.
        in_view: the newest frame saw it.
    """

    id: int
    class_name: str
    position_m: Tuple[float, float]
    cluster: int = 0
    in_view: bool = True


@dataclass(frozen=True)
class Evidence:
    """What is known of one frame.

    Attributes:
        stamp_ns: stamp of the frame [ns].
        classes_seen: canonical names of the classes the segmenter found in it.
        instances: what the instance memory held after it.
    """

    stamp_ns: int
    classes_seen: Tuple[str, ...] = ()
    instances: Tuple[HeldInstance, ...] = ()


class Reasoner(abc.ABC):
    """States safety constraints. One object serves one robot; calls come in the order of the stamps."""

    #: Name in core_msgs/SafetyConstraints.source.
    source: str = ""
    #: False for rules that are fixed: they hold from the frame itself on, with no latency, and are stamped anew with
    # every frame.
    reads_evidence: bool = True

    @abc.abstractmethod
    def reason(self, evidence: Evidence) -> Constraints:
        """Return the constraints that hold from this evidence on; image_stamp_ns is that of the evidence."""

    def reset(self) -> None:  # noqa: B027 - a reasoner without memory has nothing to forget
        """Forget everything learnt from earlier evidence."""
