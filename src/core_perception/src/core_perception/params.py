# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the Python nodes: frozen dataclasses that refuse a wrong or unknown key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from core_perception.exceptions import ParameterError
from core_perception.param_fields import (
    Parameters,
    choice,
    class_map,
    class_names,
    flag,
    number,
    path,
    sentences,
    statements,
    text,
    whole,
)

REASONERS = ("ontology", "auto", "ollama", "openai", "static", "oracle", "emulated", "scripted", "replay", "none")
#: Of these an answer is there at once: where none comes, the chain is broken.
PROMPT_REASONERS = ("ontology", "static", "oracle", "none")
SEGMENTERS = ("simulated", "remote", "topic", "replay")


@dataclass(frozen=True)
class ReasonerParams(Parameters):
    """Parameters of safety_reasoner; README.md has the same as a table.

    Attributes:
        reasoner: which one answers.
        lockstep: answer once per frame of a lock-step world instead of at rate_hz.
        rate_hz: rate of ``safety/constraints`` without lock-step [Hz].
        slop_s: largest difference of the stamps of image, labels and instances without lock-step [s].
        latency_s: declared sim latency of the ontology reasoner under lock-step [s]; must not be below the camera's
            period.
        ontology_file: class list; empty means the package's own.
        wordnet_dir: folder of WordNet's noun files; empty means that of Debian's wordnet-base.
        rules_file: rules of the static reasoner; empty means the package's own.
        predicates: true rules, for the oracle and the emulated reasoner; what scripted says.
        memory: what was seen stays in force (constraint memory, held instances, found arrangements); false answers from
            the newest frame alone.
        embedded_rules: what the ontology calls unsafe holds besides what a model says.
        clear_after_replies: answers in a row that must leave a held hazard out before it is cleared.
        link_m: instances of one class nearer than this belong to one arrangement [m], where the map gives no cluster.
        frames_of_three: number of answers in a row that must see an arrangement of only three instances.
        operator_rules_file: where the operator's rules are kept; ``auto`` is a file by node name under ROS_HOME, empty
            keeps none.
        guidelines: sentences for the language model, besides those of the service add_rule.
        server_url: address of the model server; empty means the usual one on this machine.
        model: its model; empty lets auto choose the first one that sees, and openai the one that is loaded.
        allowed_hosts_file: list of other hosts that may be asked; empty means none.
        allow_remote_images: images may leave this machine.
        api_key_env: name of the environment variable that holds the key; empty means no key.
        deadline_s: longest time of one request in all [s].
        load_timeout_s: longest time for loading the model at the start [s].
        max_tokens: longest reply.
        context_tokens: context that Ollama is to load the model with.
        keep_alive: how long Ollama keeps the model after a request, such as 30m; -1 for ever.
        image_max_px: longest edge of the image that is sent.
        prompt_file: parts of the prompt; empty means the package's own.
        safety_logic: tell the model when each operator applies; false is the ablation "No Safety Logic".
        chain_of_thought: ask for a justification first; false is the ablation "No CoT Reasoning".
        confidence: none, samples (agreement of further answers) or logprobs.
        confidence_samples: answers in all with samples.
        record_dir: every reply is written here, for replay; empty means none.
        record_images: write the images too.
        replay_dir: recording that the replay reasoner answers from.
        scripted_latency_s: declared sim latency of the scripted reasoner [s].
        emulated_row: row of the tables of [CORE] that the emulated reasoner imitates.
        emulated_correlation: errors drawn for each answer, or once for each scene.
        seed: of the sampler, the emulated errors and the pauses after failures.
    """

    reasoner: str = choice("ontology", *REASONERS)
    lockstep: bool = flag(False)
    rate_hz: float = number(10.0, 0.1, 100.0)
    slop_s: float = number(0.05, 0.0, 1.0)
    latency_s: float = number(0.1, 0.0, 60.0, above=True)
    ontology_file: str = path("", "the path of an ontology, or empty for the package's own")
    wordnet_dir: str = path("", "the path of a folder with index.noun and data.noun, or empty for Debian's")
    rules_file: str = path("", "the path of a rules file, or empty for the package's own")
    predicates: Tuple[str, ...] = statements()
    memory: bool = flag(True)
    embedded_rules: bool = flag(True)
    clear_after_replies: int = whole(3, 1, 100)
    link_m: float = number(2.5, 0.0, 20.0, above=True)
    frames_of_three: int = whole(3, 1, 100)
    operator_rules_file: str = path("", "the path of a file, auto, or empty to keep none")
    guidelines: Tuple[str, ...] = sentences()
    server_url: str = text("", "an address such as http://127.0.0.1:11434, or empty for the usual one")
    model: str = text("", "the name of a model, or empty")
    allowed_hosts_file: str = path("", "the path of a list of hosts, or empty")
    allow_remote_images: bool = flag(False)
    api_key_env: str = text("", "the name of an environment variable, or empty")
    deadline_s: float = number(30.0, 0.1, 600.0)
    load_timeout_s: float = number(300.0, 1.0, 3600.0)
    max_tokens: int = whole(700, 16, 8192)
    context_tokens: int = whole(8192, 1024, 262144)
    keep_alive: str = text("30m", "a duration such as 30m, or -1")
    image_max_px: int = whole(896, 64, 4096)
    prompt_file: str = path("", "the path of a prompt file, or empty for the package's own")
    safety_logic: bool = flag(True)
    chain_of_thought: bool = flag(True)
    confidence: str = choice("none", "none", "samples", "logprobs")
    confidence_samples: int = whole(3, 2, 20)
    record_dir: str = path("", "the path of a folder, or empty")
    record_images: bool = flag(False)
    replay_dir: str = path("", "the path of a recording, or empty")
    scripted_latency_s: float = number(4.1, 0.0, 60.0, above=True)
    emulated_row: str = text("gemma3-27b", "a row of config/emulated.yaml")
    emulated_correlation: str = choice("independent", "independent", "scene")
    seed: int = whole(0, 0, 2**31 - 1)

    def check(self) -> None:
        """Check what no field can check alone; see Parameters."""
        if self.reasoner in ("oracle", "emulated", "scripted") and not self.predicates:
            allowed = f"at least one statement with reasoner {self.reasoner}"
            raise ParameterError("predicates", list(self.predicates), allowed)
        if self.reasoner == "replay" and not self.replay_dir:
            raise ParameterError("replay_dir", self.replay_dir, "the path of a recording with reasoner replay")
        if self.reasoner == "ollama" and not self.model:
            raise ParameterError("model", self.model, "the name of a model with reasoner ollama, such as gemma3:27b")


@dataclass(frozen=True)
class SegmenterParams(Parameters):
    """Parameters of segmenter; README.md says which belong to which segmenter.

    Attributes:
        segmenter: which one answers; ``simulated`` reads the ground truth of the simulator.
        lockstep: wait for the constraints of the frame instead of taking the newest.
        ontology_file: class list; empty means the package's own.
        wordnet_dir: folder of WordNet's noun files; empty means that of Debian's wordnet-base.
        miss_rate: probability that an instance is missed in a frame.
        false_positive_rate: probability of one instance in a frame that is not there.
        pixel_drop_rate: share of the pixels of a mask that are dropped.
        erode_px: width by which masks are eroded [px].
        dilate_px: width by which they are dilated, after that [px].
        boundary_noise_px: largest distance by which their edges wander [px].
        latency_s: declared sim latency of the simulated segmenter, one frame at a time [s]; not under lock-step, where
            the world waits for the labels of every frame.
        missed_classes: classes that are never found.
        seed: seed of the random errors, of the label numbers and of the pauses after failures.
        server_url: address of the side-car.
        allowed_hosts_file: list of other hosts that may be asked; empty means none.
        allow_remote_images: images may leave this machine.
        deadline_s: longest time of one request in all [s].
        min_score: weaker instances of the side-car are left out.
        max_classes: most classes of one request; 0 for as many as the side-car takes.
        image_format: how the image is sent.
        image_max_px: longest edge of the image that is sent.
        class_map: meaning of the values of an image of class ids, such as ``11=person`` or ``255=none``; empty where
            label images come with their infos.
        record_dir: every answer is written here, for replay; empty means none.
        replay_dir: recording that replay answers from.
        replay_by: a frame is found by its stamp, or by the hash of its image.
    """

    segmenter: str = choice("simulated", *SEGMENTERS)
    lockstep: bool = flag(False)
    ontology_file: str = path("", "the path of an ontology, or empty for the package's own")
    wordnet_dir: str = path("", "the path of a folder with index.noun and data.noun, or empty for Debian's")
    miss_rate: float = number(0.0, 0.0, 1.0)
    false_positive_rate: float = number(0.0, 0.0, 1.0)
    pixel_drop_rate: float = number(0.0, 0.0, 1.0)
    erode_px: int = whole(0, 0, 50)
    dilate_px: int = whole(0, 0, 50)
    boundary_noise_px: int = whole(0, 0, 50)
    latency_s: float = number(0.0, 0.0, 60.0)
    missed_classes: Tuple[str, ...] = class_names()
    seed: int = whole(0, 0, 2**31 - 1)
    server_url: str = text("http://127.0.0.1:8092", "an address such as http://127.0.0.1:8092")
    allowed_hosts_file: str = path("", "the path of a list of hosts, or empty")
    allow_remote_images: bool = flag(False)
    deadline_s: float = number(2.0, 0.1, 60.0)
    min_score: float = number(0.5, 0.0, 1.0)
    max_classes: int = whole(0, 0, 10000)
    image_format: str = choice("jpeg", "jpeg", "png")
    image_max_px: int = whole(1024, 64, 4096)
    class_map: Tuple[str, ...] = class_map()
    record_dir: str = path("", "the path of a folder, or empty")
    replay_dir: str = path("", "the path of a recording, or empty")
    replay_by: str = choice("stamp", "stamp", "hash")

    def check(self) -> None:
        """Check what no field can check alone; see Parameters."""
        if self.segmenter == "replay" and not self.replay_dir:
            raise ParameterError("replay_dir", self.replay_dir, "the path of a recording with segmenter replay")
        if self.lockstep and self.latency_s > 0.0:
            allowed = "0 with lockstep, where the world waits for the labels of every frame"
            raise ParameterError("latency_s", self.latency_s, allowed)


@dataclass(frozen=True)
class OverlayParams(Parameters):
    """Parameters of safety_overlay.

    Attributes:
        rate_hz: largest rate of ``safety/overlay`` [Hz].
        scale: size of the picture over that of the camera image.
        opacity: weight of the tint, 0 (none) to 1 (only the tint).
        slop_s: largest stamp difference of colour, depth and grid [s].
        floor_z_m: height of the floor in the grid's frame [m].
        obstacle_height_m: points higher than this above the floor are obstacles [m].
        max_range_m: farthest distance along the optical axis that is tinted [m].
        tf_timeout_s: longest wait for the camera's pose [s].
    """

    rate_hz: float = number(5.0, 0.1, 100.0)
    scale: int = whole(2, 1, 4)
    opacity: float = number(0.45, 0.0, 1.0)
    slop_s: float = number(0.02, 0.0, 1.0)
    floor_z_m: float = number(0.0)
    obstacle_height_m: float = number(0.10, 0.0, 5.0)
    max_range_m: float = number(7.0, 0.1, 100.0)
    tf_timeout_s: float = number(0.2, 0.0, 10.0)
