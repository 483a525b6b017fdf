# SPDX-License-Identifier: BSD-3-Clause
"""The reference depth side-car with a tiny model of random weights, in the Python that CORE_SIDECAR_PYTHON names."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from core_perception.depth_completion import CompletionLimits, DepthCompleter, Outcome
from core_perception.depth_sidecar import ask_depth
from core_perception.endpoint import Endpoint
from core_perception.exceptions import ServerError
from core_perception.sidecar_client import SidecarClient

SCRIPT = Path(__file__).resolve().parents[1] / "scripts" / "depth_sidecar"
PYTHON = os.environ.get("CORE_SIDECAR_PYTHON", "")
pytestmark = pytest.mark.skipif(not PYTHON, reason="CORE_SIDECAR_PYTHON names no Python with torch and transformers")


@pytest.fixture(scope="module")
def client():
    command = [PYTHON, str(SCRIPT), "--random-tiny", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    words = process.stdout.readline().split()
    assert "RANDOM WEIGHTS" in process.stdout.readline()
    yield SidecarClient(Endpoint.parse(words[-1]), 60.0, 1 << 26)
    process.terminate()
    process.wait(20.0)


def test_a_picture_is_answered_in_its_size_and_as_random_disparity(client):
    image = np.random.RandomState(0).randint(0, 255, (240, 320, 3)).astype(np.uint8)
    answer = ask_depth(client, image, None, 5_000_000_001, 640)
    assert answer.random_weights
    assert answer.prediction.kind == "disparity"
    assert answer.prediction.values.shape == (240, 320)
    assert np.isfinite(answer.prediction.values).all()
    # Depth that means nothing is refused by the fit.
    sensed = np.linspace(1.0, 6.0, 240 * 320, dtype=np.float32).reshape(240, 320)
    sensed[::7] = np.nan
    result = DepthCompleter(CompletionLimits()).complete(sensed, answer.prediction, 1.0)
    assert result.outcome is Outcome.PASSED
    assert np.array_equal(result.depth_m, sensed, equal_nan=True)


@pytest.mark.parametrize("value", [{}, {"stamp": 3}, {"stamp": {"secs": 1, "nsecs": 0}, "image": {"data": "AAAA"}}])
def test_a_request_that_breaks_the_contract_is_refused_and_the_next_answered(client, value):
    with pytest.raises(ServerError, match="http_4xx"):
        client.call("/v1/depth", {"version": 1, **value})
    assert client.call("/v1/capabilities")["tasks"] == ["depth"]


def test_a_model_that_is_not_there_ends_it_with_one_line_and_status_2(tmp_path):
    command = [PYTHON, str(SCRIPT), "--model", str(tmp_path / "none")]
    environment = dict(os.environ, HF_HUB_OFFLINE="1")
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("depth_sidecar: ")
