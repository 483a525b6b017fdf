# SPDX-License-Identifier: BSD-3-Clause
"""The interface of a reasoner, the evidence it is given and the answer it gives."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

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
        image: (h, w, 3) uint8 rgb; None where the reasoner reads none.
        guidelines: sentences of the operator, for a language model.
        history_start_ns: stamp of the first frame in the map's memory [ns], by which the instances are counted; None
            while no map is known.
    """

    stamp_ns: int
    classes_seen: Tuple[str, ...] = ()
    instances: Tuple[HeldInstance, ...] = ()
    image: Optional[np.ndarray] = field(default=None, compare=False, repr=False)
    guidelines: Tuple[str, ...] = ()
    history_start_ns: Optional[int] = None


@dataclass(frozen=True)
class Answer:
    """What a reasoner made of one evidence.

    Attributes:
        constraints: what it states; None when the answer is void, which changes nothing.
        latency_ns: time it took, measured, drawn or recorded [ns]; None where the declared latency counts.
        void_cause: why it is void, a word to count by; empty otherwise.
        detail: the same in a line for a person.
        retry_after_ns: time to leave the server alone after a failure [ns].
    """

    constraints: Optional[Constraints]
    latency_ns: Optional[int] = None
    void_cause: str = ""
    detail: str = ""
    retry_after_ns: int = 0


class Reasoner(abc.ABC):
    """States safety constraints. One object serves one robot; calls come in the order of the stamps."""

    #: Name in core_msgs/SafetyConstraints.source.
    source: str = ""
    #: False for rules that are fixed: they hold from the frame itself on, with no latency, and are stamped anew with
    # every frame.
    reads_evidence: bool = True
    #: True where evidence.image is needed.
    reads_image: bool = False
    #: True where evidence.guidelines are heeded.
    reads_guidelines: bool = False
    #: True where each answer is about one image alone, so that a constraint memory must hold what came before.
    forgets: bool = False
    #: True where the embedded rules hold besides what it says: of a model, or what stands for one.
    is_guarded: bool = False
    #: True where reason() may take seconds of wall time: it is then called from a thread of its own.
    is_slow: bool = False

    @abc.abstractmethod
    def reason(self, evidence: Evidence) -> Answer:
        """Answer one evidence; never raises for what a server, a model or a recording does."""

    def reset(self) -> None:  # noqa: B027 - a reasoner without memory has nothing to forget
        """Forget everything learnt from earlier evidence."""

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Give up a running reason() and free what is held; the reasoner is not used afterwards."""
