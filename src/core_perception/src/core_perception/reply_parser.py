# SPDX-License-Identifier: BSD-3-Clause
"""A model's reply -> predicates: the JSON schema a server is given, a tolerant reader, then strict checks.

What is forgiven is spelling: code fences, words before and after, trailing commas, lists written as text, missing
quotes, the answer in ``thinking``. What is not forgiven is meaning: a reply that breaks the grammar, contradicts
itself, calls an object a surface or is larger than a reply has to be is void as a whole.

Every step takes time linear in the length of the reply, and nothing recurses deeper than MAX_DEPTH.

Source: [CORE] appendix, VLM prompt, output format. Differs: lists instead of comma-separated text (both are read), and
    a malformed reply is void; the sample of the paper's prompt itself has a trailing comma.
"""

from __future__ import annotations

import dataclasses
import json
import re
import unicodedata
from dataclasses import dataclass
from typing import Callable, Dict, List, Optional, Tuple

from core_perception.exceptions import PredicateError, ReplyError
from core_perception.predicates import (
    Operator,
    Predicate,
    Verdict,
    apply_precedence,
    canonical_class_name,
    parse_predicate,
)

MAX_REPLY_BYTES = 65536
MAX_DEPTH = 8
MAX_ITEMS = 32
MAX_JUSTIFICATION_CHARS = 600
FIELDS = ("safety_logic", "classes", "unsafe_regions", "safe_regions")

#: Why a reply is void, as stable words to count by.
VOID_CAUSES = (
    "empty",  # no text at all
    "too_large",  # more than MAX_REPLY_BYTES
    "too_deep",  # brackets nested deeper than MAX_DEPTH
    "not_json",  # nothing in it reads as a reply, or it was cut off
    "not_an_object",  # JSON, but a list, a text or a number
    "ambiguous",  # several replies that differ, or one field twice
    "missing_field",  # classes, unsafe_regions or safe_regions is not there
    "wrong_type",  # a field is neither text nor a list of texts
    "too_many",  # more than MAX_ITEMS in one list
    "bad_predicate",  # a region outside the grammar
    "bad_class",  # a class outside the syntax
    "on_object",  # ON of something that is no surface
    "contradiction",  # one region is safe and unsafe
)

_CLASS_PATTERN = "[a-z][a-z0-9_]{0,62}"
_CLASS_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9 _'-]{0,63}\Z")
_TOKENS = re.compile(r'\\.|["{}\[\]]', re.DOTALL)
_TRAILING_COMMA = re.compile(r'("(?:[^"\\]|\\.)*")|,(?=\s*[}\]])', re.DOTALL)
_FIELD_START = re.compile(r"^[ \t{,\"'`*-]{0,16}(%s)[\"'`*]{0,4}[ \t]{0,16}:" % "|".join(FIELDS), re.I | re.M)
_DECORATION = " \t\r\n\"'`[]*.,;-\u201c\u201d\u2018\u2019"
_FULL_WIDTH = str.maketrans({"\uff08": "(", "\uff09": ")", "\uff0c": ","})
_NOTHING = ("none", "null", "n/a", "empty")


@dataclass(frozen=True)
class Reply:
    """What a model answered.

    Attributes:
        predicates: unsafe ones first, each list in the reply's order; precedence is applied.
        classes: canonical names in the reply's order.
        justification: printable text of one line, at most MAX_JUSTIFICATION_CHARS.
    """

    predicates: Tuple[Predicate, ...]
    classes: Tuple[str, ...]
    justification: str


def reply_schema(chain_of_thought: bool = True) -> dict:
    """Return the JSON schema of a reply; servers generate the properties in this order, the justification first.

    Args:
        chain_of_thought: ask for ``safety_logic``; False is an ablation of [CORE], Table III.
    """

    def texts(pattern):
        return {"type": "array", "maxItems": MAX_ITEMS, "items": {"type": "string", "pattern": pattern}}

    region = rf"^(ON|NEAR|AROUND|BETWEEN)\({_CLASS_PATTERN}\)$"
    properties = {"safety_logic": {"type": "string", "maxLength": MAX_JUSTIFICATION_CHARS}} if chain_of_thought else {}
    properties.update(classes=texts(f"^{_CLASS_PATTERN}$"), unsafe_regions=texts(region), safe_regions=texts(region))
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _is_never_object(_name: str) -> bool:
    return False


def parse_reply(
    text: str,
    thinking: str = "",
    is_object: Callable[[str], bool] = _is_never_object,
    canonical: Callable[[str], str] = canonical_class_name,
) -> Reply:
    """Read a reply.

    Args:
        text: what the model answered.
        thinking: what it wrote before; read in place of a blank text, as some servers put the answer there.
        is_object: tells of a canonical class name that it is no surface, so that ON does not apply to it.
        canonical: the name under which a class is known; raises PredicateError for what is none.

    Raises:
        ReplyError: the reply is void; its ``cause`` is one of VOID_CAUSES.
    """
    fields = _read_fields(_answer_part(text, thinking))
    missing = [name for name in FIELDS[1:] if name not in fields]
    if missing:
        raise ReplyError("missing_field", f"{', '.join(missing)}: not in the reply")
    justification = fields.get("safety_logic", "")
    if not isinstance(justification, str):
        raise ReplyError("wrong_type", f"safety_logic: got {type(justification).__name__}, allowed text")
    classes = [_read_class(item, canonical) for item in _items(fields, "classes")]
    unsafe = [_read_region(item, Verdict.UNSAFE, canonical) for item in _items(fields, "unsafe_regions")]
    safe = [_read_region(item, Verdict.SAFE, canonical) for item in _items(fields, "safe_regions")]
    for predicate in (*unsafe, *safe):
        if predicate.operator == Operator.ON and is_object(predicate.class_name):
            raise ReplyError("on_object", f"{predicate.expression}: allowed on surfaces only")
    both = {(p.operator, p.class_name) for p in unsafe} & {(p.operator, p.class_name) for p in safe}
    if both:
        operator, name = min(both)
        raise ReplyError("contradiction", f"{operator.name}({name}): both safe and unsafe")
    return Reply(apply_precedence((*unsafe, *safe)), tuple(dict.fromkeys(classes)), _one_line(justification))


def _answer_part(text, thinking) -> str:
    """The part that holds the answer, without what was thought aloud."""
    for part in (text, thinking):
        if not isinstance(part, str):
            raise ReplyError("wrong_type", f"reply: got {type(part).__name__}, allowed text")
        if len(part) > MAX_REPLY_BYTES or len(part.encode("utf-8", "surrogatepass")) > MAX_REPLY_BYTES:
            raise ReplyError("too_large", f"got {len(part)} characters, allowed {MAX_REPLY_BYTES} bytes")
        answer = part.rpartition("</think>")[2]
        if answer.strip():
            return answer
    raise ReplyError("empty", "got no text")


def _read_fields(text: str) -> Dict[str, object]:
    """The fields of the one reply in a text."""
    objects = _outermost_objects(text)
    if len(objects) > MAX_ITEMS:
        raise ReplyError("ambiguous", f"got {len(objects)} objects, allowed one")
    loaded = [fields for fields in map(_load_object, objects) if fields is not None]
    replies = [fields for fields in loaded if not fields.keys().isdisjoint(FIELDS)]
    if any(fields != replies[0] for fields in replies):
        raise ReplyError("ambiguous", f"got {len(replies)} objects that differ, allowed one")
    if replies:
        return replies[0]
    if loaded:
        raise ReplyError("missing_field", f"{', '.join(FIELDS[1:])}: in none of {len(loaded)} objects")
    fields = _read_lines(text)
    if fields is None:
        cause = "not_an_object" if _is_other_json(text) else "not_json"
        raise ReplyError(cause, f"got {_one_line(text)[:60]!r}, allowed one JSON object")
    return fields


def _outermost_objects(text: str) -> List[str]:
    """Every {...} that stands in no other one; quotes and brackets count inside of braces only."""
    objects, start, in_string = [], 0, False
    closing: List[str] = []
    for match in _TOKENS.finditer(text):
        token = match.group()
        if token == '"' and closing:
            in_string = not in_string
        elif in_string or (not closing and token != "{"):
            continue
        elif token in "{[":
            start = start if closing else match.start()
            closing.append("}" if token == "{" else "]")
            if len(closing) > MAX_DEPTH:
                raise ReplyError("too_deep", f"got brackets nested deeper than {MAX_DEPTH}")
        elif token == closing[-1]:
            closing.pop()
            if not closing:
                objects.append(text[start : match.end()])
    return objects


def _load_object(text: str) -> Optional[Dict[str, object]]:
    """The fields of a JSON object, trailing commas forgiven; None when it is no JSON."""
    try:
        # Numbers have no place in a reply; as floating point they cost no time, however many digits they have.
        return json.loads(
            _TRAILING_COMMA.sub(r"\1", text), object_pairs_hook=_unique_fields, parse_int=float, strict=False
        )
    except json.JSONDecodeError:
        return None


def _unique_fields(pairs) -> Dict[str, object]:
    fields: Dict[str, object] = {}
    for key, value in pairs:
        name = key.strip().lower().replace(" ", "_").replace("-", "_")
        if name in fields:
            raise ReplyError("ambiguous", f"{_one_line(name)[:60]}: got it twice, allowed once")
        fields[name] = value
    return fields


def _read_lines(text: str) -> Optional[Dict[str, object]]:
    """Fields written as ``name: value``, each beginning a line, with or without braces around; None if there are none.

    Braces that open must close, so that a reply which was cut off is not taken for a whole one.
    """
    if "{" in text:
        text = text.partition("{")[2].rpartition("}")[0]
        if "{" in text or "}" in text:
            return None
    starts = list(_FIELD_START.finditer(text))
    ends = [start.start() for start in starts[1:]] + [len(text)]
    pairs = [(start.group(1), text[start.end() : end].strip("`\"', \t\r\n")) for start, end in zip(starts, ends)]
    return _unique_fields(pairs) if pairs else None


def _is_other_json(text: str) -> bool:
    bare = text.strip("` \t\r\n")
    bare = bare[4:].lstrip() if bare.startswith("json") else bare
    return bare[:1] in tuple('["') or re.match(r"(?:-?[0-9][0-9.eE+-]*|true|false|null)\Z", bare) is not None


def _items(fields, name) -> List[str]:
    """The entries of a field, be it a list of texts or one text."""
    value = fields[name]
    texts = [value] if isinstance(value, str) else value
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise ReplyError("wrong_type", f"{name}: got {_one_line(repr(value)[:60])}, allowed text or a list of texts")
    items = [item for text in texts for item in _split(text.translate(_FULL_WIDTH))]
    if len(items) > MAX_ITEMS:
        raise ReplyError("too_many", f"{name}: got {len(items)}, allowed {MAX_ITEMS}")
    return [] if len(items) == 1 and items[0].lower() in _NOTHING else items


def _split(text: str) -> List[str]:
    """Split at commas, semicolons and line ends that are not inside of parentheses."""
    items, depth, start = [], 0, 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth <= 0 and character in ",;\n":
            items.append(text[start:position])
            start = position + 1
    items.append(text[start:])
    return [item for item in (item.strip(_DECORATION) for item in items) if item]


def _without_accents(text: str, cause: str) -> str:
    """ASCII text; letters of other scripts are refused, for some look like Latin ones."""
    plain = "".join(c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    if not plain.isascii():
        raise ReplyError(cause, f"got {_one_line(ascii(text)[:80])}, allowed Latin letters")
    return plain


def _read_class(text: str, canonical) -> str:
    plain = _without_accents(text, "bad_class").strip(_DECORATION)
    try:
        if not _CLASS_TEXT.match(plain):
            raise PredicateError("allowed a letter, then up to 63 letters, digits, spaces or underscores")
        return canonical(plain)
    except PredicateError as error:
        raise ReplyError("bad_class", f"got {_one_line(plain)[:80]!r}: {_one_line(str(error))[:160]}") from error


def _read_region(text: str, verdict: Verdict, canonical) -> Predicate:
    plain = _without_accents(text, "bad_predicate")
    try:
        predicate = parse_predicate(plain, verdict)
    except PredicateError as error:
        raise ReplyError("bad_predicate", _one_line(str(error))[:200]) from error
    if predicate.verdict != verdict:
        raise ReplyError("contradiction", f"{predicate} stands among the {verdict.name.lower()} regions")
    arguments = plain.partition("(")[2].rpartition(")")[0]
    return dataclasses.replace(predicate, class_name=_read_class(arguments.split(",")[0], canonical))


def _one_line(text: str) -> str:
    """Printable text without line ends; half surrogates, which no message can carry, become spaces as well."""
    printable = "".join(character if character.isprintable() else " " for character in text)
    return " ".join(printable.split())[:MAX_JUSTIFICATION_CHARS]
