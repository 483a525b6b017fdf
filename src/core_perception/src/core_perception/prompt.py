# SPDX-License-Identifier: BSD-3-Clause
"""Puts the prompt of a vision-language model together from the parts in ``config/prompt.yaml``.

Source: [CORE] appendix, VLM prompt, for the structure; Table III for the two parts that can be left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Sequence

from core_perception.exceptions import PerceptionError, quote
from core_perception.yaml_file import read_yaml

PARTS = (
    "role",
    "categories",
    "operators_with_logic",
    "operators_without_logic",
    "picture_text",
    "guidelines",
    "output_with_reasoning",
    "output_without_reasoning",
    "user",
    "user_without_picture",
)
MAX_SENTENCE_CHARS = 300
FORBIDDEN = frozenset("<>[]{}|")


@dataclass(frozen=True)
class Prompt:
    """What a model is sent besides the image.

    Attributes:
        system: who it is, what to look for, how to answer.
        user: the request itself.
    """

    system: str
    user: str


def check_sentence(text: str) -> str:
    """Return a sentence of the operator, ready for the prompt.

    Raises:
        PerceptionError: it is no printable line of 1 to 300 characters, or has one of the brackets and bars with which
            models mark who speaks: tokenisers read "<|assistant|>" in the middle of a text as a change of turns.
    """
    text = text.strip() if isinstance(text, str) else ""
    if not (0 < len(text) <= MAX_SENTENCE_CHARS and text.isprintable()) or FORBIDDEN.intersection(text):
        allowed = f"one printable line of at most {MAX_SENTENCE_CHARS} characters without {' '.join(sorted(FORBIDDEN))}"
        raise PerceptionError(f"sentence: got {text[:80]!r}, allowed {allowed}")
    return text


class PromptTemplate:
    """The parts, with the choice of what is left out."""

    def __init__(self, parts: Mapping[str, str], safety_logic: bool = True, chain_of_thought: bool = True):
        """Keep the parts.

        Args:
            parts: text by name, exactly PARTS.
            safety_logic: tell when each operator applies; False is "No Safety Logic" of [CORE], Table III.
            chain_of_thought: ask for a justification first; False is "No CoT Reasoning".
        """
        self._parts = {name: text.strip() for name, text in parts.items()}
        self._operators = "operators_with_logic" if safety_logic else "operators_without_logic"
        self._output = "output_with_reasoning" if chain_of_thought else "output_without_reasoning"
        self.chain_of_thought = chain_of_thought

    @classmethod
    def load(cls, path, safety_logic: bool = True, chain_of_thought: bool = True) -> PromptTemplate:
        """Read a YAML file with exactly the keys PARTS, all text.

        Raises:
            PerceptionError: the file cannot be read or has other content; the message starts with the path.
        """
        parts = read_yaml(path)
        if not isinstance(parts, dict) or set(parts) != set(PARTS):
            got = sorted(map(str, parts)) if isinstance(parts, dict) else parts
            raise PerceptionError(f"{path}: got {quote(got)}, allowed exactly {', '.join(PARTS)}")
        for name, text in parts.items():
            if not isinstance(text, str) or not text.strip():
                raise PerceptionError(f"{path}: {name}: got {quote(text)}, allowed text")
        return cls(parts, safety_logic, chain_of_thought)

    def compose(self, guidelines: Sequence[str] = (), picture: bool = True) -> Prompt:
        """Return the prompt.

        Args:
            guidelines: sentences of the operator, one line each.
            picture: an image goes with it.
        """
        names = ["role", "categories", self._operators, "picture_text"]
        sections = [self._parts[name] for name in names]
        if guidelines:
            lines = [f"- {' '.join(sentence.split())}" for sentence in guidelines]
            sections.append("\n".join([self._parts["guidelines"], *lines]))
        sections.append(self._parts[self._output])
        return Prompt("\n\n".join(sections), self._parts["user" if picture else "user_without_picture"])
