# SPDX-License-Identifier: BSD-3-Clause
"""Has a language model write the rules file of the static reasoner, before anything is seen.

The model gets the same prompt as the one that looks, with the operator's guidelines and without a picture. A person
should read the file before a robot obeys it.

Source: [CORE] experimental results, baseline No Context. Differs: what is safe is limited to surfaces that the ontology
    lists as navigable.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Iterable, Sequence, Tuple

import yaml

from core_perception.exceptions import ParameterError, PerceptionError, ReplyError, ServerError
from core_perception.ontology import Ontology
from core_perception.params import ReasonerParams
from core_perception.predicates import Operator, Predicate, Verdict
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.factory import make_client
from core_perception.reply_parser import parse_reply, reply_schema

DEADLINE_S = 300.0


@dataclass(frozen=True)
class GeneratedRules:
    """What a model wrote.

    Attributes:
        kept: rules for the file, in the order of the reply.
        dropped: safe regions that no model may grant.
        justification: the model's own words.
    """

    kept: Tuple[Predicate, ...]
    dropped: Tuple[Predicate, ...]
    justification: str


def generate_rules(client, template: PromptTemplate, ontology: Ontology, guidelines: Sequence[str], seed: int):
    """Ask a model for rules.

    Args:
        client: has ``ask`` as VlmClient.
        template: the prompt.
        ontology: canonical names; which classes are objects, which are navigable.
        guidelines: sentences of the operator.
        seed: of the sampler.

    Returns:
        GeneratedRules, kept not empty.

    Raises:
        ServerError: no reply.
        ReplyError: a reply that is malformed, or that states no rule.
    """
    prompt = template.compose(guidelines, picture=False)
    answer = client.ask(prompt.system, prompt.user, None, reply_schema(template.chain_of_thought), seed, None)
    reply = parse_reply(answer.text, answer.thinking, lambda name: ontology.look_up(name).is_object, ontology.canonical)
    kept = tuple(p for p in reply.predicates if _may_be_stated(p, ontology))
    if not kept:
        raise ReplyError("empty", "the model stated no rule that may be kept")
    dropped = tuple(p for p in reply.predicates if p not in kept)
    return GeneratedRules(kept, dropped, reply.justification)


def _may_be_stated(predicate: Predicate, ontology: Ontology) -> bool:
    is_navigable = ontology.look_up(predicate.class_name).is_navigable
    return predicate.verdict == Verdict.UNSAFE or (predicate.operator == Operator.ON and is_navigable)


def write_rules(path: Path, rules: GeneratedRules, model: str, force: bool) -> None:
    """Write a file that load_rules reads as the same rules; all of it or nothing.

    Raises:
        PerceptionError: the file is there and force is false, or it cannot be written.
    """
    check_may_be_written(path, force)
    header = [
        f"# Rules of the static reasoner, written by the language model {model} before anything was seen.",
        "# To be read by a person before a robot obeys them.",
        *(f"# Left out, a model may not grant it: {predicate}" for predicate in rules.dropped),
    ]
    justification = f"Rules written before deployment by the language model {model}. {rules.justification}".strip()
    content = {"justification": justification, "rules": [str(predicate) for predicate in rules.kept]}
    text = "\n".join(header) + "\n" + yaml.safe_dump(content, sort_keys=False, width=120)
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise PerceptionError(f"{path}: cannot be written: {error.strerror}") from error


def check_may_be_written(path: Path, force: bool) -> None:
    """Refuse a file that is there, unless forced, and a folder that is not.

    Raises:
        PerceptionError: one of the two.
    """
    if path.exists() and not force:
        raise PerceptionError(f"{path}: is there already, allowed a new file, or --force")
    if not path.parent.is_dir() or path.is_dir():
        raise PerceptionError(f"{path}: allowed a file in a folder that exists")


class _OneLineParser(argparse.ArgumentParser):
    def error(self, message: str) -> None:
        raise ParameterError("options", message, "those of generate_rules --help")


def _parse_options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = _OneLineParser(prog="generate_rules", description="Have a language model write a rules file.")
    parser.add_argument("output", type=Path, help="file to write, for the parameter rules_file of safety_reasoner")
    parser.add_argument("--guideline", action="append", default=[], help="a sentence of the operator; may be repeated")
    parser.add_argument("--guidelines-file", type=Path, help="a sentence a line; # starts a comment")
    parser.add_argument("--api", choices=("ollama", "openai"), default="ollama")
    parser.add_argument("--model", default="", help="such as gemma3:27b")
    parser.add_argument("--url", default="", help="address of the server; empty: the usual one on this machine")
    parser.add_argument("--allowed-hosts-file", default="", help="list of other hosts that may be asked")
    parser.add_argument("--allow-remote", action="store_true", help="the prompt may leave this machine")
    parser.add_argument("--api-key-env", default="", help="environment variable that holds the key")
    parser.add_argument("--max-tokens", type=int, default=2000)
    parser.add_argument(
        "--deadline-s", type=float, default=DEADLINE_S, help="of the reply, after the model is loaded [s]"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--force", action="store_true", help="overwrite the file")
    return parser.parse_args(arguments)


def _read_guidelines(options) -> Iterable[str]:
    yield from options.guideline
    if options.guidelines_file is None:
        return
    try:
        lines = options.guidelines_file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PerceptionError(f"{options.guidelines_file}: cannot be read ({type(error).__name__})") from error
    for line in lines:
        sentence = line.split("#")[0].strip()
        if sentence:
            yield sentence


def _run(options, config_dir: Path) -> None:
    params = ReasonerParams.from_dict(
        {
            "reasoner": options.api,
            "guidelines": list(_read_guidelines(options)),
            "model": options.model,
            "server_url": options.url,
            "allowed_hosts_file": options.allowed_hosts_file,
            "allow_remote_images": options.allow_remote,
            "api_key_env": options.api_key_env,
            "max_tokens": options.max_tokens,
            "deadline_s": options.deadline_s,
            "seed": options.seed,
        }
    )
    check_may_be_written(options.output, options.force)
    client = make_client(params)
    client.preload()
    template, ontology = PromptTemplate.load(config_dir / "prompt.yaml"), Ontology.load(config_dir / "ontology.yaml")
    rules = generate_rules(client, template, ontology, params.guidelines, params.seed)
    write_rules(options.output, rules, params.model or "of the server", options.force)
    for predicate in rules.dropped:
        print(f"left out, a model may not grant it: {predicate}")
    print(f"{options.output}: {len(rules.kept)} rules; read them before a robot obeys them")


def main(arguments: Sequence[str], config_dir: Path) -> int:
    """Run the command; return 0, 1 for a server or model that did not do it, 2 for bad input."""
    try:
        _run(_parse_options(arguments), config_dir)
    except PerceptionError as error:
        sys.stderr.write(f"generate_rules: {error}\n")
        return 1 if isinstance(error, (ServerError, ReplyError)) else 2
    return 0
