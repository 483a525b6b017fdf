# SPDX-License-Identifier: BSD-3-Clause
"""Makes the segmenter that the parameters name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from core_perception.ontology import Ontology
from core_perception.params import SegmenterParams
from core_perception.reasoners.vlm_client import BackOff
from core_perception.segmenters.base import Segmenter
from core_perception.segmenters.class_map import ClassMap
from core_perception.segmenters.label_errors import LabelErrors
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.recording import RecordingSegmenter, ReplaySegmenter
from core_perception.segmenters.remote import RemoteSegmenter
from core_perception.segmenters.simulated import SimulatedSegmenter
from core_perception.segmenters.topic import TopicSegmenter
from core_perception.sidecar_client import SidecarClient, find_endpoint
from core_perception.wordnet import WORDNET_DIR


@dataclass(frozen=True)
class SegmenterParts:
    """What the node works with.

    Attributes:
        segmenter: finds the instances.
        ontology: its classes are always asked for.
    """

    segmenter: Segmenter
    ontology: Ontology


def make_segmenter(params: SegmenterParams, config_dir: Path, robot_name: str) -> SegmenterParts:
    """Return the segmenter; nothing is sent yet.

    Args:
        params: which one, and its settings.
        config_dir: folder of the files the package ships.
        robot_name: tells several robots that share a side-car apart.

    Raises:
        PerceptionError: a file is missing or wrong, or an address is not allowed.
    """
    wordnet_dir = params.wordnet_dir or WORDNET_DIR
    ontology = Ontology.load(params.ontology_file or config_dir / "ontology.yaml", wordnet_dir)
    segmenter = _make(params, ontology, OpenNames(ontology, wordnet_dir), robot_name)
    if params.record_dir:
        segmenter = RecordingSegmenter(segmenter, Path(params.record_dir))
    return SegmenterParts(segmenter, ontology)


def _make(params: SegmenterParams, ontology: Ontology, names: OpenNames, robot_name: str) -> Segmenter:
    if params.segmenter == "remote":
        endpoint = find_endpoint(params.server_url, params.allowed_hosts_file, params.allow_remote_images)
        return RemoteSegmenter(
            SidecarClient(endpoint, params.deadline_s),
            ontology,
            names,
            BackOff(f"{robot_name} {params.seed}"),
            min_score=params.min_score,
            max_classes=params.max_classes,
            image_format=params.image_format,
            max_image_px=params.image_max_px,
        )
    if params.segmenter == "topic":
        return TopicSegmenter(ontology, names, ClassMap.parse(params.class_map) if params.class_map else None)
    if params.segmenter == "replay":
        return ReplaySegmenter(Path(params.replay_dir), params.replay_by, is_held_back=not params.lockstep)
    errors = LabelErrors(
        miss_rate=params.miss_rate,
        false_positive_rate=params.false_positive_rate,
        pixel_drop_rate=params.pixel_drop_rate,
        erode_px=params.erode_px,
        dilate_px=params.dilate_px,
        boundary_noise_px=params.boundary_noise_px,
        missed_classes=params.missed_classes,
    )
    return SimulatedSegmenter(ontology, names, params.seed, errors, params.latency_s)
