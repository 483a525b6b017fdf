# SPDX-License-Identifier: BSD-3-Clause
"""The parameter tables of the package READMEs agree with the shipped profiles; the paper map names real files."""

import re
from pathlib import Path

import pytest
import yaml

SRC = Path(__file__).resolve().parent.parent / "src"
NODES = [
    (package, node)
    for package in ("core_control", "core_perception")
    for node in yaml.safe_load((SRC / package / "config" / "core.yaml").read_text())
]
ROW = re.compile(r"^\| `~(\w+)` \| (.*?) \| (.*?) \|", re.MULTILINE)


def table_of(package, node):
    text = (SRC / package / "README.md").read_text()
    section = text.split("\n## %s\n" % node)[1].split("\n## ")[0]
    return {name: (default, paper) for name, default, paper in ROW.findall(section)}


def read(text):
    return "" if text == "empty" else yaml.safe_load(text)


def test_paper_map_names_files_that_exist():
    names = set(re.findall(r"`([\w/]+\.(?:py|cpp))`", (SRC.parent / "docs" / "paper_map.md").read_text()))
    assert len(names) > 20
    existing = ["/" + path.relative_to(SRC).as_posix() for path in SRC.rglob("*") if path.suffix in (".py", ".cpp")]
    assert [name for name in sorted(names) if not any(path.endswith("/" + name) for path in existing)] == []


@pytest.mark.parametrize(("package", "node"), NODES)
def test_table_lists_every_parameter_with_its_default(package, node):
    shipped = yaml.safe_load((SRC / package / "config" / "core.yaml").read_text())[node]
    table = table_of(package, node)
    assert {name: read(default) for name, (default, _) in table.items()} == shipped


@pytest.mark.parametrize(("package", "node"), NODES)
def test_table_gives_the_value_of_profile_paper_where_it_differs(package, node):
    core, paper = (
        yaml.safe_load((SRC / package / "config" / name).read_text())[node] for name in ("core.yaml", "paper.yaml")
    )
    differs = {name: value for name, value in paper.items() if value != core[name]}
    assert {name: read(value) for name, (_, value) in table_of(package, node).items() if value} == differs
