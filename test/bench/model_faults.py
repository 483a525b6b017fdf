#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench model_faults: the filter while a model server fails in eight ways, in a running graph.

Runs test/model_faults_slow_and_stop_robot.test and prints its figures; the last line on stdout is one JSON object:

    faults             per fault: oldest_moving_s, age of the constraints under the last motion (<= ttl + 0.2),
                       and recovery_s
    constraints_ttl_s  the limit in that test
    loop_p99_ratio     99th percentile of the time between two commands, while failing over before (unchanged: about 1)
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEST = "model_faults_slow_and_stop_robot"


def main():
    if len(sys.argv) > 1:
        print(__doc__, end="")
        return 0 if sys.argv[1] in ("-h", "--help") else 2
    with tempfile.TemporaryDirectory() as folder:
        command = ["rostest", "--text", "--pkgdir", str(ROOT / "src" / "core_bringup"), "--package", "core_bringup"]
        environment = {**os.environ, "CORE_TEST_RESULTS": folder}
        print("eight faults of about ten seconds each", file=sys.stderr)
        status = subprocess.call(
            [*command, str(ROOT / "test" / (TEST + ".test"))], stdout=sys.stderr, env=environment, cwd=str(ROOT)
        )
        if status != 0:
            print("model_faults: the test failed, see above", file=sys.stderr)
            return 1
        figures = json.loads((Path(folder) / TEST / "faults.json").read_text())
    ratio = figures["loop_p99_faulty_s"] / figures["loop_p99_healthy_s"]
    print(json.dumps({"bench": "model_faults", **figures, "loop_p99_ratio": round(ratio, 3)}, sort_keys=True))
    return 0


if __name__ == "__main__":
    sys.exit(main())
