# SPDX-License-Identifier: BSD-3-Clause
"""Bad requests are refused in one line that names the key and what is allowed."""

import re
from pathlib import Path

import pytest

from core_bringup.evaluation import preflight
from core_bringup.evaluation.monitor_params import MonitorParams
from core_bringup.exceptions import ConfigError

BAD_WORDS = [
    ("methods:=core", "methods: unknown argument; allowed: world, task, method"),
    ("method=core", "not of the form name:=value"),
    ("cone_line", "not of the form name:=value"),
    ("", "not of the form name:=value"),
    ("method:=", "method: got ''; allowed: core, oracle, no_context, geometric, none"),
    ("method:=metric", "allowed: core, oracle"),
    ("method:=CORE", "allowed: core, oracle"),
    ("profile:=fast", "profile: got 'fast'; allowed: core, paper"),
    ("backend:=gazebo", "backend: got 'gazebo'; allowed: pybullet, kinematic"),
    ("reasoner:=gpt", "reasoner: got 'gpt'; allowed: ontology, auto, ollama"),
    ("reasoner:=scripted", "reasoner: got 'scripted'; allowed: ontology, auto"),
    ("pictures:=sometimes", "pictures: got 'sometimes'; allowed: always, failed, never"),
    ("bag:=true", "bag: got 'true'; allowed: always, failed, never"),
    ("overrides:=", "overrides: got ''; allowed: a name or a path"),
    ("renderer:=opengl", "renderer: got 'opengl'; allowed: tiny, egl"),
    ("seed:=-1", "seed: got '-1'; allowed: a whole number from 0"),
    ("seed:=1.5", "seed: got '1.5'"),
    ("seed:=one", "seed: got 'one'"),
    ("seed:=\u0663", "seed: got"),
    ("seed:=99999999999999", "seed: got"),
    ("rtf:=nan", "rtf: got 'nan'; allowed: a number from 0"),
    ("rtf:=-1", "rtf: got '-1'"),
    ("lockstep:=yes", "lockstep: got 'yes'; allowed: true, false"),
    ("gui:=2", "gui: got '2'; allowed: true, false"),
    ("view:=", "view: got ''; allowed: true, false"),
    ("results:=", "results: got ''; allowed: a name or a path"),
    ("results:=$(env HOME)", "results: got"),
    ("world:=a\nb", "world: got"),
]


@pytest.mark.parametrize("word, text", BAD_WORDS)
def test_a_bad_word_is_refused_in_one_line(word, text):
    with pytest.raises(ConfigError) as caught:
        preflight.parse_arguments([word])
    assert text in str(caught.value) and "\n" not in str(caught.value)


def test_a_name_given_twice_is_refused():
    with pytest.raises(ConfigError, match="seed: given twice"):
        preflight.parse_arguments(["seed:=1", "seed:=1"])


@pytest.mark.parametrize(
    "words, text",
    [
        (["world:=moon"], "no world 'moon'; allowed: .*warehouse"),
        (["world:=/nowhere/a.yaml"], "/nowhere/a.yaml: world: no such file"),
        (["task:=swim"], "no task 'swim'; allowed: .*cone_line"),
        (["robot:=tank"], "no robot 'tank'; allowed: .*spot_like"),
        (["robot:=/nowhere/robot.yaml"], "/nowhere/robot.yaml"),
        (["results:=/proc/no_such_folder"], "results: /proc/no_such_folder: .*; allowed: a folder that can be written"),
        (["backend:=kinematic", "gui:=true"], "gui: .*false with backend kinematic"),
        (["method:=oracle", "reasoner:=ontology"], "reasoner: got 'ontology' with method oracle; allowed: oracle"),
        (["method:=geometric", "reasoner:=ontology"], "reasoner: .*; allowed: none"),
        (["reasoner:=none"], "reasoner: got 'none' with method core; allowed: ontology"),
        (["method:=geometric", "profile:=paper"], "profile: got 'paper' with method geometric; allowed: core"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(words, text, tmp_path):
    words = words if any(word.startswith("results") for word in words) else [*words, f"results:={tmp_path}"]
    with pytest.raises(ConfigError) as caught:
        preflight.check_request(preflight.parse_arguments(words))
    assert re.search(text, str(caught.value)) and "\n" not in str(caught.value)


def test_a_world_with_a_nan_is_refused_with_file_and_key(tmp_path):
    world = preflight.load_world("warehouse").path
    broken = tmp_path / "broken.yaml"
    broken.write_text(world.read_text().replace("start_pose: [0.0, 0.0, 0.0]", "start_pose: [.nan, 0.0, 0.0]"))
    with pytest.raises(ConfigError, match=r"broken.yaml:\d+: tasks.cone_line.start_pose"):
        preflight.check_request(preflight.parse_arguments([f"world:={broken}", f"results:={tmp_path}"]))


@pytest.mark.parametrize("profile", preflight.PROFILES)
@pytest.mark.parametrize("task", ["cone_line", "open_aisle"])
def test_the_shipped_requests_pass(profile, task, tmp_path):
    request = preflight.parse_arguments([f"profile:={profile}", f"task:={task}", f"results:={tmp_path}"])
    assert preflight.check_request(request) > 0
    assert list(tmp_path.iterdir()) == []


def test_defaults_are_the_demo_of_the_readme():
    request = preflight.parse_arguments([])
    assert (request.world, request.task, request.method, request.profile) == ("warehouse", "cone_line", "core", "core")
    assert request.lockstep and not request.view and request.results == "results/demo"


def test_launch_arguments_are_those_demo_launch_declares(tmp_path):
    request = preflight.parse_arguments([f"results:={tmp_path}", "gui:=true"])
    words = dict(word.split(":=") for word in request.launch_arguments())
    assert words["gui"] == "true" and words["lockstep"] == "true" and words["seed"] == "0"
    assert Path(words["robot"]).is_file() and words["results"] == str(tmp_path)
    launch = (preflight.find_package_folder("core_bringup") / "launch" / "demo.launch").read_text()
    declared = set(re.findall(r'<arg name="(\w+)"\s+default', launch))
    assert set(words) <= declared


@pytest.mark.parametrize(
    "words, rtf",
    [([], "0.0"), (["view:=true"], "1.0"), (["gui:=true"], "1.0"), (["lockstep:=false"], "1.0"), (["rtf:=2"], "2.0")],
)
def test_a_run_nobody_watches_is_as_fast_as_possible(words, rtf):
    assert f"rtf:={rtf}" in preflight.parse_arguments(words).launch_arguments()


@pytest.mark.parametrize(
    "words, message",
    [
        (["reasoner:=ollama"], "model: got '', allowed the name of a model"),
        (["reasoner:=replay"], "replay_dir: got ''"),
        (["reasoner_params:=missing.yaml"], "missing.yaml"),
        (["reasoner_params:={folder}/params.yaml"], "deadlin_s: got 3, allowed only"),
    ],
)
def test_what_the_reasoner_would_refuse_is_refused_before_anything_starts(tmp_path, words, message):
    (tmp_path / "params.yaml").write_text("deadlin_s: 3\n")
    words = [word.format(folder=tmp_path) for word in words]
    request = preflight.parse_arguments([*words, f"results:={tmp_path}/results"])
    with pytest.raises(ConfigError, match=re.escape(message)):
        preflight.check_request(request)


def test_files_of_the_reasoner_reach_the_launch_file_as_absolute_paths():
    words = ["reasoner:=replay", "replay_dir:=recording", "reasoner_params:=a.yaml", "overrides:=b.yaml"]
    arguments = preflight.parse_arguments(words).launch_arguments()
    assert f"replay_dir:={Path('recording').resolve()}" in arguments
    assert f"reasoner_params:={Path('a.yaml').resolve()}" in arguments
    assert f"overrides:={Path('b.yaml').resolve()}" in arguments
    assert "record_dir:=" in arguments


@pytest.mark.parametrize(
    ("method", "reasoner"),
    [("core", "ontology"), ("oracle", "oracle"), ("no_context", "static"), ("geometric", "none"), ("none", "ontology")],
)
def test_every_method_has_its_usual_reasoner_and_passes(method, reasoner, tmp_path):
    request = preflight.parse_arguments([f"method:={method}", f"results:={tmp_path}"])
    assert request.reasoner == reasoner and f"reasoner:={reasoner}" in request.launch_arguments()
    assert preflight.check_request(request) > 0


@pytest.mark.parametrize(
    "values, text",
    [
        ({"tsk": "cone_line"}, "~tsk: got 'cone_line'; allowed: only world, task"),
        ({"seed": -1}, "~seed: got -1; allowed: a whole number >= 0"),
        ({"seed": True}, "~seed"),
        ({"seed": "0"}, "~seed"),
        ({"lockstep": 1}, "~lockstep: got 1; allowed: true or false"),
        ({"method": "magic"}, "~method: got 'magic'; allowed: core, oracle"),
        ({"stall_timeout_s": 0}, "~stall_timeout_s"),
        ({"stall_timeout_s": float("nan")}, "~stall_timeout_s"),
        ({"results": ""}, "~results"),
        ({"world": 3}, "~world"),
    ],
)
def test_bad_monitor_parameters_are_refused(values, text):
    with pytest.raises(ConfigError) as caught:
        MonitorParams.from_dict(values)
    assert f"trial_monitor: {text}" in str(caught.value)


def test_monitor_parameters_take_their_defaults():
    assert MonitorParams.from_dict({}) == MonitorParams()
    assert MonitorParams.from_dict({"seed": 3, "stall_timeout_s": 5}).stall_timeout_s == 5
