#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench sanitize [--fuzz SECONDS] [--build DIR]: the C++ tests under sanitizers, then libFuzzer.

Builds core_perception with the address and undefined-behaviour sanitizers and the assertions of libstdc++, in a folder
of its own, and runs every gtest program; one report ends a program. With --fuzz each target of src/core_perception/fuzz
runs for that many seconds of processor time under clang's libFuzzer; what it keeps stays in results/fuzz for the next
call. Progress goes to stderr; the last line on stdout is one JSON object; exit code 1 when something was found. Keys:

    programs, tests, failed   gtest programs, their tests, and programs that failed or were ended by a sanitizer
    fuzz                      per target: runs, cpu_s, corpus (inputs kept), findings (inputs that broke a promise)
    clean                     nothing failed and nothing was found
"""

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "core_perception"
RESULTS = ROOT / "results" / "fuzz"
TARGETS = ("frames", "constraints", "wire")
# A division by zero of floating point is defined and used; a cast of what does not fit an integer is not.
CHECKS = "-fsanitize=address,undefined,float-cast-overflow"
FLAGS = "-O1 -g -w -fno-omit-frame-pointer -fno-sanitize-recover=all -D_GLIBCXX_ASSERTIONS -DOCTOMAP_NODEBUGOUT"
SLOWEST_INPUT_S = 60  # wall time, on a busy machine
MOST_MEMORY_MB = 2048


def say(text):
    print("sanitize: " + text, file=sys.stderr, flush=True)


def find_clang():
    """Name of clang's C++ compiler, or None."""
    names = ["clang++", *["clang++-%d" % version for version in range(21, 9, -1)]]
    return next((name for name in names if shutil.which(name)), None)


def build(folder, targets, options):
    """Configure and build targets of the package; True unless that fails."""
    folder.mkdir(parents=True, exist_ok=True)
    configure = ["cmake", "-S", PACKAGE, "-B", folder, "-DCMAKE_BUILD_TYPE=Sanitize", *options]
    configure.append("-DPYTHON_EXECUTABLE=" + sys.executable)
    log = folder / "build.log"
    with log.open("w") as stream:
        for command in (configure, ["cmake", "--build", folder, "--", "-j%d" % (os.cpu_count() or 1), *targets]):
            if subprocess.call([str(part) for part in command], stdout=stream, stderr=subprocess.STDOUT) != 0:
                say("the build failed:\n" + "\n".join(log.read_text().splitlines()[-30:]))
                return False
    return True


def environment(folder):
    """The libraries of this build: LD_LIBRARY_PATH, which names those of the workspace, counts more than a run path."""
    paths = [str(folder / "devel" / "lib"), os.environ.get("LD_LIBRARY_PATH", "")]
    return dict(
        os.environ,
        LD_LIBRARY_PATH=":".join(path for path in paths if path),
        UBSAN_OPTIONS="print_stacktrace=1",
        ASAN_OPTIONS="detect_stack_use_after_return=1",
    )


def run(command, folder):
    """Run a program of this build; its two streams, which may hold any bytes, come back as one text."""
    return subprocess.run(
        [str(part) for part in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=environment(folder),
    )


def run_tests(folder):
    """Run the gtest programs; figures as in the module's docstring."""
    figures = {"programs": 0, "tests": 0, "failed": []}
    with tempfile.TemporaryDirectory() as scratch:
        for program in sorted((folder / "devel" / "lib" / "core_perception").glob("test_*")):
            report = Path(scratch) / (program.name + ".xml")
            command = [str(program), "--gtest_output=xml:" + str(report)]
            done = run(command, folder)
            figures["programs"] += 1
            if done.returncode == 0 and report.exists():
                figures["tests"] += int(ET.parse(str(report)).getroot().get("tests"))
                say("%s is clean" % program.name)
            else:
                figures["failed"].append(program.name)
                say("%s failed:\n%s" % (program.name, done.stdout[-6000:]))
    return figures


def children_cpu_s():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def fuzz(folder, target, seconds):
    """Run one libFuzzer target for this much processor time; figures as in the module's docstring."""
    corpus, found = RESULTS / target, RESULTS / (target + "_findings")
    found.mkdir(parents=True, exist_ok=True)
    command = [folder / "devel" / "lib" / "core_perception" / ("fuzz_" + target), corpus]
    command += ["-timeout=%d" % SLOWEST_INPUT_S, "-rss_limit_mb=%d" % MOST_MEMORY_MB, "-max_len=8192"]
    command += ["-print_final_stats=1", "-artifact_prefix=%s/" % found]
    figures = {"runs": 0, "cpu_s": 0.0, "findings": 0}
    while figures["cpu_s"] < seconds and figures["findings"] == 0:
        before_s = children_cpu_s()
        # libFuzzer counts wall time, of which a busy machine gives it only a part.
        limit = ["-max_total_time=%d" % (seconds - figures["cpu_s"] + 1)]
        done = run(command + limit, folder)
        runs = re.search(r"number_of_executed_units:\s*(\d+)", done.stdout)
        figures["runs"] += int(runs.group(1)) if runs else 0
        figures["cpu_s"] += children_cpu_s() - before_s
        if done.returncode != 0:
            figures["findings"] += 1
            say("%s ended with a finding; its input is in %s\n%s" % (target, found, done.stdout[-6000:]))
    figures["cpu_s"] = round(figures["cpu_s"], 1)
    return {**figures, "corpus": sum(1 for _ in corpus.iterdir())}


def run_fuzzers(folder, seconds):
    """Build the targets with clang and run one after the other; None when the build fails."""
    options = ["-DCMAKE_CXX_COMPILER=" + find_clang(), "-DCORE_LIBFUZZER=ON"]
    options.append("-DCMAKE_CXX_FLAGS=%s %s,fuzzer-no-link" % (FLAGS, CHECKS))
    say("building the fuzz targets with %s" % find_clang())
    if not build(folder, ["fuzz_" + target for target in TARGETS] + ["fuzz_tool"], options):
        return None
    for target in TARGETS:
        (RESULTS / target).mkdir(parents=True, exist_ok=True)
    tool = folder / "devel" / "lib" / "core_perception" / "fuzz_tool"
    subprocess.check_call([str(tool), "corpus", str(RESULTS)], env=environment(folder))
    figures = {}
    for target in TARGETS:
        say("%s: %d s of processor time" % (target, seconds))
        figures[target] = fuzz(folder, target, seconds)
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fuzz", type=int, default=0, metavar="SECONDS", help="of every target; 0: none; needs clang")
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "sanitize", metavar="DIR", help="build folder")
    arguments = parser.parse_args()
    if arguments.fuzz < 0:
        parser.error("argument --fuzz: got %d, allowed 0 or more seconds" % arguments.fuzz)
    if arguments.fuzz > 0 and find_clang() is None:
        parser.error("argument --fuzz: clang++ is missing; on Debian 12: apt-get install clang libclang-rt-14-dev")
    say("building the tests")
    if not build(arguments.build / "tests", ["tests"], ["-DCMAKE_CXX_FLAGS=%s %s" % (FLAGS, CHECKS)]):
        return 1
    figures = run_tests(arguments.build / "tests")
    if arguments.fuzz > 0:
        figures["fuzz"] = run_fuzzers(arguments.build / "fuzz", arguments.fuzz)
        if figures["fuzz"] is None:
            return 1
    found = sum(target["findings"] for target in figures.get("fuzz", {}).values())
    figures["clean"] = figures["tests"] > 0 and not figures["failed"] and found == 0
    print(json.dumps({"bench": "sanitize", **figures}, sort_keys=True))
    return 0 if figures["clean"] else 1


if __name__ == "__main__":
    sys.exit(main())
