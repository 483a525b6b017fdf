# SPDX-License-Identifier: BSD-3-Clause
"""Fuzzed replies through reader and memory, judged by a model that knows only what was said and what was seen.

run(cases, seed) plays episodes: a world of objects that come, go and leave the view; a talker that repeats itself,
forgets and exaggerates; replies rendered in many spellings and damaged grammar-aware or byte by byte.
"""

import json
import random
from collections import Counter
from pathlib import Path

from core_perception.asking import Findings
from core_perception.constraint_memory import ConstraintMemory
from core_perception.exceptions import ReplyError
from core_perception.ontology import Ontology
from core_perception.predicates import Constraints, Operator, Severity, Verdict
from core_perception.reasoners.base import Answer, Evidence, HeldInstance
from core_perception.reply_parser import VOID_CAUSES, parse_reply

CONFIG = Path(__file__).resolve().parents[1] / "config"
OBJECTS = ("traffic_cone", "person", "forklift", "chair", "odd_thing")
SPELLINGS = {
    "traffic_cone": ("safety cone", "Traffic-Cone", "cone"),
    "person": ("worker", "persons"),
    "floor": ("ground",),
}
NAVIGABLE = ("floor", "carpet")
SURFACES = (*NAVIGABLE, "grass", "odd_ground")
# Reach of AROUND where a statement gives none [m], as config/ontology.yaml says; chair and odd_thing have none there.
REACH_M = {"person": 1.0, "forklift": 1.5}
EPISODE = 40
FAULTS = ("shrinks", "unheeded", "hasty", "unearned_safe", "misread", "spoilt_but_valid", "crashes")


class Talker:
    """A reasoner that forgets, as far as Findings asks."""

    source, forgets = "fuzz", True


class World:
    """Objects and surfaces around a robot, and what segmenter and map know of them."""

    def __init__(self, rng):
        self.rng, self.next_id, self.objects, self.gone = rng, 1, {}, {}
        self.history = rng.choice([None, 1, 1, 1])

    def step(self):
        rng = self.rng
        if rng.random() < 0.25 or not self.objects:
            self.objects[self.next_id] = rng.choice(OBJECTS)
            self.next_id += 1
        if rng.random() < 0.1:
            number = rng.choice(list(self.objects))
            self.gone[number] = self.objects.pop(number)
        if self.gone and rng.random() < 0.05:
            self.objects.update([self.gone.popitem()])
        if rng.random() < 0.03:
            self.history = rng.choice([None, 1, 2, 3])

    def evidence(self, stamp_ns):
        rng, seeing = self.rng, self.rng.choice([0.0, 0.6, 1.0, 1.0])
        instances = tuple(
            HeldInstance(number, name, (0.0, 0.0), 0, rng.random() < seeing) for number, name in self.objects.items()
        )
        seen = {i.class_name for i in instances if i.in_view} | {s for s in SURFACES if rng.random() < 0.7}
        seen |= {name for name in OBJECTS if rng.random() < 0.05}
        return Evidence(stamp_ns, tuple(sorted(seen)), instances, history_start_ns=self.history)


class Speech:
    """What the talker believes, as (verdict, operator, class, radius or None, severity) with some of it left unsaid."""

    def __init__(self, rng):
        self.rng, self.belief, self.unsaid, self.lapse = rng, [], (), 0
        self.belief += [self.statement() for _ in range(4)]

    def statement(self):
        rng = self.rng
        if rng.random() < 0.35:
            return (rng.choice(list(Verdict)), Operator.ON, rng.choice(SURFACES), None, Severity.STOP)
        name = rng.choice(OBJECTS if rng.random() < 0.9 else SURFACES)
        operator = rng.choice([Operator.NEAR, Operator.AROUND, Operator.BETWEEN])
        verdict = Verdict.SAFE if rng.random() < 0.15 else Verdict.UNSAFE
        radius_m = rng.choice([None, None, 0.5, 1.04, 1.5, 1.55, 3.0]) if operator == Operator.AROUND else None
        slow = verdict == Verdict.UNSAFE and rng.random() < 0.2
        return (verdict, operator, name, radius_m, Severity.SLOW if slow else Severity.STOP)

    def next(self):
        rng = self.rng
        if rng.random() < 0.15:
            self.belief.append(self.statement())
        if rng.random() < 0.1 and self.belief:
            self.belief.remove(rng.choice(self.belief))
        self.lapse -= 1
        if self.lapse < 0:
            self.unsaid = ()
            if rng.random() < 0.3:
                self.unsaid, self.lapse = [s for s in self.belief if rng.random() < 0.6], rng.randrange(7)
        verdicts = {}
        told = [s for s in dict.fromkeys(self.belief) if s not in self.unsaid]
        return [s for s in told if verdicts.setdefault(s[1:3], s[0]) == s[0]]


def _write(rng, statement):
    _, operator, name, radius_m, severity = statement
    arguments = [rng.choice((name, name, *SPELLINGS.get(name, ())))]
    arguments += [] if radius_m is None else [str(radius_m)]
    arguments += ["slow"] if severity == Severity.SLOW else []
    word = operator.name if rng.random() < 0.9 else operator.name.lower()
    return f"{word}({', '.join(arguments)})"


def _spoil(rng, fields):
    """Break the meaning of a reply, not its form."""
    unsafe, safe, region = fields["unsafe_regions"], fields["safe_regions"], "BETWEEN(traffic_cone)"
    rng.choice(
        (
            lambda: (unsafe.append(region), safe.append(region)),
            lambda: safe.append("ON(person)"),
            lambda: unsafe.append("ON(safety cone)"),
            lambda: unsafe.insert(0, "BEHIND(forklift)"),
            lambda: unsafe.append("AROUND(person, 1e9)"),
            lambda: safe.append("ON(floor, grass)"),
            lambda: unsafe.extend(["NEAR(chair)"] * 40),
            lambda: fields["classes"].append("fl\u043eor"),
            lambda: fields.update(unsafe_regions={"NEAR": unsafe}),
            lambda: fields.update(safe_regions=None),
            lambda: fields.pop("unsafe_regions"),
            lambda: fields.update(extra=json.loads("[" * 20 + "]" * 20)),
        )
    )()
    return fields


def render(rng, said, classes, spoilt=False):
    """A reply in one of the spellings that are forgiven; spoilt: with one thing in it that is not."""
    unsafe = [_write(rng, s) for s in said if s[0] == Verdict.UNSAFE]
    safe = [_write(rng, s) for s in said if s[0] == Verdict.SAFE]
    fields = {
        "safety_logic": 'a "poster" says {go}.',
        "classes": list(classes),
        "unsafe_regions": unsafe,
        "safe_regions": safe,
    }
    if spoilt:
        return json.dumps(_spoil(rng, fields))
    form = rng.randrange(6)
    if form == 1:
        fields = {key: value if isinstance(value, str) else ", ".join(value) for key, value in fields.items()}
    if form in (2, 3):
        quote = rng.choice(["", '"'])
        lines = [f"{key}: {quote}{', '.join(value)}," for key, value in fields.items() if key != "safety_logic"]
        return "\n".join(["safety_logic: because,", *lines])
    text = json.dumps(fields, indent=rng.choice([None, 2]), ensure_ascii=rng.random() < 0.5)
    if form == 4:
        text = text[:-1].rstrip() + ",\n}"
    return f"Well:\n```json\n{text}\n```\nDone." if form == 5 else text


WORDS = "``` ON( NEAR( =safe =unsafe slow 1e999 nan null \\u0000 \\ud800 </think> unsafe_regions"
PIECES = (*'{}[]()",:;\\\n= \u0430\u200b\ufeff', *WORDS.split(), "(" * 500, "[" * 500, '"safe_regions": ["ON(grass)"]')


def damage(rng, text, other):
    """Break a reply here and there: pieces of the grammar, bytes, cuts, splices."""
    data = bytearray(text.encode("utf-8", "replace"))
    for _ in range(rng.choice([1, 1, 2, 5])):
        place, length = rng.randrange(len(data) + 1), rng.choice([1, 1, 3, 20])
        kind = rng.randrange(7)
        if kind == 0:
            data[place:place] = rng.choice(PIECES).encode("utf-8", "replace")
        elif kind == 1:
            del data[place : place + length]
        elif kind == 2:
            data[place : place + length] = bytes(rng.randrange(256) for _ in range(length))
        elif kind == 3 and place < len(data):
            data[place] ^= 1 << rng.randrange(8)
        elif kind == 4:
            del data[place:]
        elif kind == 5:
            data[place:place] = data[: rng.randrange(len(data) + 1)]
        else:
            data[place:] = other.encode("utf-8", "replace")[place:]
    return bytes(data).decode("utf-8", rng.choice(["replace", "surrogateescape", "ignore"]))


class Judge:
    """Remembers every valid reply of an episode as said and seen, and holds each statement in force against that."""

    def __init__(self, clear_after, votes, counts):
        self.clear_after, self.votes, self.counts = clear_after, votes, counts
        self.past, self.said, self.safe_since, self.last = [], set(), {}, Constraints()

    def take(self, stated, named, evidence, held_now):
        """One valid reply and what is in force after it."""
        held, view = {}, {}
        for i in evidence.instances:
            held.setdefault(i.class_name, set()).add(i.id)
            if i.in_view:
                view.setdefault(i.class_name, set()).add(i.id)
        seen = set(evidence.classes_seen) | set(view)
        knew_map = any(p["history"] is not None for p in self.past)
        now = {"stated": stated, "held": held, "view": view, "seen": seen, "named": seen | set(named)}
        now.update(history=evidence.history_start_ns, blind=evidence.history_start_ns is None and knew_map)
        self.past.append(now)
        before, self.last = self.last, held_now
        self.said |= {_atom(p) for p in stated if p.verdict == Verdict.UNSAFE}
        for atom in self.said:
            check = self._check_surface if _is_surface(atom) else self._check_object
            check(atom, before, held_now)
        self._check_safe(stated, held_now)

    def _check_object(self, atom, before, after):
        now = self.past[-1]
        same_map = len(self.past) > 1 and self.past[-2]["history"] == now["history"]
        stated_now = self._covered(now, atom)
        for number in (None, *now["held"].get(atom[1], ())):
            was = _holds(before, atom, number if same_map else None)
            is_now = _holds(after, atom, number)
            if was and not is_now:
                lawful = self._class_may_go(atom) if number is None else self._instance_may_go(atom, number)
                self.counts["cleared" if lawful else "shrinks"] += 1
            looked_at = number is None or number in now["view"].get(atom[1], ()) or was
            if stated_now and looked_at and not is_now:
                self.counts["unheeded"] += 1

    def _check_surface(self, atom, before, after):
        if _holds(before, atom) and not _holds(after, atom):
            self.counts["cleared" if self._row(lambda p: atom[1] in p["named"], atom) else "shrinks"] += 1
        needed, kept = self.votes
        window = [self._covered(p, atom) for p in self.past]
        ever = any(sum(window[max(0, end - kept) : end]) >= needed for end in range(1, len(window) + 1))
        if window[-1] and sum(window[-kept:]) >= needed and not _holds(after, atom):
            self.counts["unheeded"] += 1
        # What a stronger statement holds, it holds for this one too.
        if (
            not ever
            and not _holds(before, atom)
            and any(p.verdict == Verdict.UNSAFE and _atom(p) == atom for p in after.predicates)
        ):
            self.counts["hasty"] += 1

    def _check_safe(self, stated, after):
        unsafe = {p.class_name for p in after.predicates if p.verdict == Verdict.UNSAFE and _is_surface(_atom(p))}
        for p in stated:
            if (p.operator, p.verdict) == (Operator.ON, Verdict.SAFE):
                self.safe_since[p.class_name] = True
        for name in unsafe:
            self.safe_since.pop(name, None)
        for p in after.predicates:
            if p.verdict == Verdict.SAFE:
                earned = p.operator == Operator.ON and p.class_name in NAVIGABLE and self.safe_since.get(p.class_name)
                self.counts["unearned_safe"] += not earned

    def _instance_may_go(self, atom, number):
        """M replies had it in view, held by one map without a break, and none of them or between them covers."""
        return self._row(
            lambda p: number in p["view"].get(atom[1], ()),
            atom,
            lambda p: (
                p["history"] is not None
                and p["history"] == self.past[-1]["history"]
                and number in p["held"].get(atom[1], ())
            ),
        )

    def _class_may_go(self, atom):
        def looked(p):
            return not p["blind"] and (atom[1] in p["seen"] or not p["held"].get(atom[1]))

        return self._row(looked, atom)

    def _row(self, looked, atom, unbroken=lambda p: True):
        count = 0
        for past in reversed(self.past):
            if self._covered(past, atom) or not unbroken(past):
                return False
            count += bool(looked(past))
            if count >= self.clear_after:
                return True
        return False

    @staticmethod
    def _covered(past, atom):
        return any(p.verdict == Verdict.UNSAFE and _reaches(_atom(p), atom) for p in past["stated"])


def _atom(predicate):
    radius_m = predicate.radius_m
    if predicate.operator == Operator.AROUND and radius_m is None:
        radius_m = REACH_M.get(predicate.class_name, 1.0)
    return (predicate.operator, predicate.class_name, radius_m or 0.0, predicate.severity)


def _is_surface(atom):
    return atom[0] == Operator.ON or atom[1] in NAVIGABLE


def _reaches(atom, other):
    return atom[:2] == other[:2] and atom[2] >= other[2] and atom[3] <= other[3]


def _holds(constraints, atom, number=None):
    return any(
        p.verdict == Verdict.UNSAFE and _reaches(_atom(p), atom) and number not in constraints.exempt.get(p, ())
        for p in constraints.predicates
    )


def _episode(rng, ontology, counts, length):
    clear_after = rng.choice([1, 2, 3, 3, 3, 4])
    votes = rng.choice([(2, 3), (2, 3), (1, 1), (3, 5)])
    world, speech = World(rng), Speech(rng)
    judge = Judge(clear_after, votes, counts)
    findings = Findings(Talker, ConstraintMemory(ontology, clear_after, votes))
    text = ""

    def is_object(name):
        return ontology.look_up(name).listed and not ontology.look_up(name).is_surface

    for stamp_ns in range(1, length + 1):
        world.step()
        evidence, said, other = world.evidence(stamp_ns), speech.next(), text
        classes = [name for name in sorted(evidence.classes_seen) if rng.random() < 0.8]
        text = render(rng, said, classes)
        dice = rng.random()
        sent = text if dice < 0.6 else damage(rng, text, other) if dice < 0.92 else _noise(rng)
        sent = render(rng, said, classes, spoilt=True) if dice > 0.96 else sent
        before = findings.constraints
        try:
            reply = parse_reply(sent, "", is_object, ontology.canonical)
            answer = Answer(Constraints(reply.predicates, reply.classes, reply.justification, "fuzz", stamp_ns))
        except ReplyError as error:
            reply, answer = None, Answer(None, void_cause=error.cause, detail=str(error))
        except Exception as error:
            counts["crashes"] += 1
            counts[f"crash {type(error).__name__}: {error} in {sent!r}"] += 1
            continue
        counts["spoilt_but_valid"] += dice > 0.96 and reply is not None
        if sent is text and (reply is None or not _is_meant(reply, said, classes)):
            counts["misread"] += 1
        findings.take(answer, evidence, 0)
        if reply is None:
            counts["void"] += 1
            counts[f"void_{answer.void_cause}"] += 1
            counts["crashes"] += answer.void_cause not in VOID_CAUSES
            counts["shrinks"] += findings.constraints != before
        else:
            counts["valid"] += 1
            judge.take(reply.predicates, reply.classes, evidence, findings.constraints)


def _is_meant(reply, said, classes):
    """The reply reads as it was meant; precedence leaves AROUND out beside a BETWEEN that asks for as much."""
    between = {(s[2], s[4]) for s in said if s[:2] == (Verdict.UNSAFE, Operator.BETWEEN)}
    meant = {
        s
        for s in said
        if s[:2] != (Verdict.UNSAFE, Operator.AROUND) or not any((s[2], v) in between for v in range(s[4] + 1))
    }
    read = {(p.verdict, p.operator, p.class_name, p.radius_m, p.severity) for p in reply.predicates}
    return read == meant and list(reply.classes) == classes


def _noise(rng):
    data = bytes(rng.randrange(256) for _ in range(rng.randrange(200)))
    return data.decode("utf-8", rng.choice(["replace", "surrogateescape"]))


def run(cases: int, seed: int = 0) -> dict:
    """Send ``cases`` replies and count.

    Returns:
        cases, valid, void and void_<cause>, cleared (statements that left lawfully), and what has to be 0:
        crashes, misread (an undamaged reply read otherwise), spoilt_but_valid (a meaning that is not forgiven was),
        shrinks (an unsafe statement about an instance or a class left after a void reply or too few good ones),
        unheeded (something stated is not in force), hasty (an unsafe surface with too few votes), unearned_safe (a
        surface is safe that may not be).
    """
    ontology, counts = Ontology.load(CONFIG / "ontology.yaml"), Counter()
    done = 0
    while done < cases:
        length = min(EPISODE, cases - done)
        _episode(random.Random(seed * 1_000_003 + done), ontology, counts, length)
        done += length
    counts["cases"] = cases
    return {**dict.fromkeys((*FAULTS, "valid", "void", "cleared"), 0), **counts}
