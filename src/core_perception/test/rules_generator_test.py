# SPDX-License-Identifier: BSD-3-Clause
"""A language model writes the rules file of the static reasoner: what is asked, kept, refused and written."""

import dataclasses
import json

import pytest
import yaml
from fakes.fake_model_server import FakeModelServer

from core_perception.exceptions import PerceptionError, ReplyError
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Evidence
from core_perception.reasoners.fixed_reasoner import load_rules
from core_perception.reasoners.wire import ModelReply
from core_perception.reply_parser import reply_schema
from core_perception.rules_generator import GeneratedRules, generate_rules, main, write_rules

ANSWER = {
    "safety_logic": "Cones: keep out, even from 'between' them. #1",
    "classes": ["safety_cone", "floor"],
    "unsafe_regions": [
        "NEAR(safety_cone)",
        "BETWEEN(safety_cone)",
        "ON(stairs)",
        "AROUND(reactor_core)",
        "ON(unicorn)",
    ],
    "safe_regions": ["ON(ground)", "BETWEEN(door)", "ON(grass)", "ON(glass_bridge)", "NEAR(table)", "NEAR(floor)"],
}
KEPT = [
    "NEAR(traffic_cone)=unsafe",
    "BETWEEN(traffic_cone)=unsafe",
    "ON(stairs)=unsafe",
    "AROUND(reactor_core)=unsafe",
    "ON(unicorn)=unsafe",
    "ON(floor)=safe",
]
DROPPED = ["BETWEEN(door)=safe", "ON(grass)=safe", "ON(glass_bridge)=safe", "NEAR(table)=safe", "NEAR(floor)=safe"]


class Model:
    """Says one thing and remembers what it was asked."""

    def __init__(self, answer):
        self.answer, self.asked = answer, None

    def ask(self, *question):
        self.asked = question
        return ModelReply(self.answer if isinstance(self.answer, str) else json.dumps(self.answer))


@pytest.fixture(scope="module")
def template(config_dir):
    return PromptTemplate.load(config_dir / "prompt.yaml")


@pytest.fixture()
def server():
    with FakeModelServer(answer=lambda chat: json.dumps(ANSWER)) as running:
        yield running


def texts(predicates):
    return [str(p) for p in predicates]


def test_the_model_is_asked_by_the_whole_prompt_without_a_picture(template, ontology):
    model = Model(ANSWER)
    generate_rules(model, template, ontology, ("Keep out of the cold store.",), 7)
    system, user, picture, schema, seed, temperature = model.asked
    assert (system, user) == (
        template.compose(["Keep out of the cold store."], picture=False).system,
        template.compose(picture=False).user,
    )
    assert "Keep out of the cold store." in system
    assert "There is no picture" in user
    assert (picture, schema, seed, temperature) == (None, reply_schema(True), 7, None)


def test_safe_is_only_what_the_ontology_lists_as_navigable(template, ontology):
    rules = generate_rules(Model(ANSWER), template, ontology, (), 0)
    assert texts(rules.kept) == KEPT
    assert texts(rules.dropped) == DROPPED
    assert rules.justification == ANSWER["safety_logic"]


def test_a_surface_that_is_navigable_without_being_listed_is_not_safe(template, ontology):
    class Guessing:
        canonical = staticmethod(ontology.canonical)

        @staticmethod
        def look_up(name):
            return dataclasses.replace(ontology.look_up(name), listed=False)

    rules = generate_rules(Model(ANSWER), template, Guessing, (), 0)
    assert texts(rules.kept) == KEPT[:-1]
    assert texts(rules.dropped) == ["ON(floor)=safe", *DROPPED]


@pytest.mark.parametrize(
    "answer, cause",
    [
        ("I would rather talk about it.", "not_json"),
        ({**ANSWER, "unsafe_regions": ["ON(table)"]}, "on_object"),
        ({**ANSWER, "unsafe_regions": [], "safe_regions": ["ON(grass)"]}, "empty"),
        ({**ANSWER, "unsafe_regions": [], "safe_regions": []}, "empty"),
    ],
)
def test_a_malformed_or_empty_reply_gives_no_rules(template, ontology, answer, cause):
    with pytest.raises(ReplyError) as refused:
        generate_rules(Model(answer), template, ontology, (), 0)
    assert refused.value.cause == cause


def test_the_file_reads_as_the_same_rules_and_says_where_they_come_from(tmp_path, template, ontology, config_dir):
    path = tmp_path / "rules.yaml"
    rules = generate_rules(Model(ANSWER), template, ontology, (), 0)
    write_rules(path, rules, "gemma3:27b", force=False)
    assert [p.name for p in tmp_path.iterdir()] == ["rules.yaml"]
    constraints = load_rules(path).reason(Evidence(5)).constraints
    assert texts(constraints.predicates) == KEPT
    assert "gemma3:27b" in constraints.justification
    assert constraints.justification.endswith(ANSWER["safety_logic"])
    comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    for text in DROPPED:
        assert any(text in line for line in comments)
    assert set(yaml.safe_load(path.read_text())) == set(yaml.safe_load((config_dir / "static_rules.yaml").read_text()))


def test_a_file_is_overwritten_only_by_force_and_never_half(tmp_path, template, ontology):
    path = tmp_path / "rules.yaml"
    path.write_text("mine")
    rules = generate_rules(Model(ANSWER), template, ontology, (), 0)
    with pytest.raises(PerceptionError, match="is there already"):
        write_rules(path, rules, "m", force=False)
    assert path.read_text() == "mine"
    (tmp_path / "rules.yaml.part").mkdir()
    with pytest.raises(PerceptionError, match="cannot be written"):
        write_rules(path, rules, "m", force=True)
    assert path.read_text() == "mine"
    (tmp_path / "rules.yaml.part").rmdir()
    write_rules(path, rules, "m", force=True)
    assert texts(load_rules(path).reason(Evidence(0)).constraints.predicates) == KEPT


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(PerceptionError, match="allowed a file in a folder that exists"):
        write_rules(tmp_path / "none" / "rules.yaml", GeneratedRules((), (), ""), "m", force=False)
    with pytest.raises(PerceptionError, match="allowed a file in a folder that exists"):
        write_rules(tmp_path, GeneratedRules((), (), ""), "m", force=True)


@pytest.mark.parametrize("api", ["ollama", "openai"])
def test_the_command_asks_a_server_and_writes_the_file(tmp_path, config_dir, server, api, capsys):
    path, sentences = tmp_path / "rules.yaml", tmp_path / "guidelines.txt"
    sentences.write_text("# of the foreman\n\nNobody walks under loads.  # ever\n")
    arguments = [str(path), "--api", api, "--url", server.url, "--model", "gemma3:27b", "--guidelines-file"]
    assert main([*arguments, str(sentences), "--guideline", "Keep out of the cold store."], config_dir) == 0
    assert texts(load_rules(path).reason(Evidence(0)).constraints.predicates) == KEPT
    printed = capsys.readouterr().out.splitlines()
    assert [line.rpartition(" ")[2] for line in printed[:-1]] == DROPPED
    assert printed[-1].startswith(f"{path}: 6 rules")
    assert len(server.chats()) == 1


def test_the_guidelines_reach_the_server_and_no_image_does(tmp_path, config_dir):
    chats = []

    def answer(chat):
        chats.append(chat)
        return json.dumps(ANSWER)

    sentences = tmp_path / "guidelines.txt"
    sentences.write_text("# of the foreman\n\nNobody walks under loads.  # ever\n")
    with FakeModelServer(answer=answer) as server:
        arguments = [str(tmp_path / "rules.yaml"), "--url", server.url, "--model", "gemma3:27b"]
        arguments += ["--guideline", "Keep out of the cold store.", "--guidelines-file", str(sentences)]
        assert main(arguments, config_dir) == 0
    assert len(chats) == 1
    assert "- Keep out of the cold store.\n- Nobody walks under loads.\n" in chats[0].system
    assert "foreman" not in chats[0].system
    assert "ever" not in chats[0].system.split("Nobody walks under loads.")[1].splitlines()[0]
    assert chats[0].images == ()


def test_an_existing_file_is_refused_before_the_server_is_asked(tmp_path, config_dir, server, capsys):
    path = tmp_path / "rules.yaml"
    path.write_text("mine")
    arguments = [str(path), "--url", server.url, "--model", "gemma3:27b"]
    assert main(arguments, config_dir) == 2
    assert server.log() == []
    assert capsys.readouterr().err == f"generate_rules: {path}: is there already, allowed a new file, or --force\n"
    assert main([*arguments, "--force"], config_dir) == 0
    assert path.read_text() != "mine"


def test_a_server_or_model_that_fails_gives_status_1_one_line_and_no_file(tmp_path, config_dir, server, capsys):
    arguments = [str(tmp_path / "rules.yaml"), "--url", server.url, "--model"]
    assert main([*arguments, "llama:1"], config_dir) == 1
    server.set_fault("500")
    assert main([*arguments, "gemma3:27b"], config_dir) == 1
    server.set_fault("garbage")
    assert main([*arguments, "gemma3:27b"], config_dir) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[:2] for line in lines][:2] == [
        ["generate_rules", "model_missing"],
        ["generate_rules", "http_5xx"],
    ]
    assert len(lines) == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments, message",
    [
        ([], "required: output"),
        (["OUT", "--model", "m", "--speed", "3"], "unrecognized arguments: --speed 3"),
        (["OUT"], "model: got ''"),
        (["OUT", "--model", "m", "--api", "soap"], "invalid choice: 'soap'"),
        (["OUT", "--model", "m", "--deadline-s", "0"], "deadline_s: got 0.0"),
        (["OUT", "--model", "m", "--guideline", " "], "guidelines: got"),
        (["OUT", "--model", "m", "--guidelines-file", "/nothing"], "/nothing: cannot be read"),
        (["OUT", "--model", "m", "--url", "http://example.com:1"], "not on this machine"),
        (
            ["OUT", "--model", "m", "--url", "http://example.com:1", "--allow-remote"],
            "not in the list of allowed hosts",
        ),
    ],
)
def test_bad_input_gives_status_2_and_one_line(tmp_path, config_dir, capsys, arguments, message):
    arguments = [str(tmp_path / "rules.yaml") if word == "OUT" else word for word in arguments]
    assert main(arguments, config_dir) == 2
    error = capsys.readouterr().err
    assert error.startswith("generate_rules: ")
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
