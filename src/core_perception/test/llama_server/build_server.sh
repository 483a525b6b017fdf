#!/usr/bin/env bash
# SPDX-License-Identifier: BSD-3-Clause
# Builds llama.cpp's llama-server for the release test, once, and prints where it is (the last line of stdout).
#
#   build_server.sh          builds when missing (10 to 20 minutes on two cores), otherwise answers at once, without network
#   build_server.sh --check  prints the place when it is built, ends with 1 when not; never builds
#
# Sources: the sdist of llama-cpp-python from PyPI, which carries all of llama.cpp. The GGUF writer comes from PyPI as well.
# Result: .core/llama_server/{bin/llama-server, python/gguf, stamp}, outside of git.
set -euo pipefail

sdist_version=0.3.36
gguf_version=0.17.1
jobs=2

here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
workspace=$(readlink -f "$here/../../../..")
cache=${CORE_LLAMA_CACHE:-$workspace/.core/llama_server}
python=$workspace/.venv/bin/python3

say() { printf 'build_server.sh: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

# Versions and recipe, so that a change of either builds again and a change of a comment does not.
wanted_stamp() { { printf '%s\n' "$sdist_version" "$gguf_version"; declare -f download compile; } | sha256sum | cut -d' ' -f1; }

is_built() {
  [ "$(cat "$cache/stamp" 2>/dev/null)" = "$(wanted_stamp)" ] && [ -x "$cache/bin/llama-server" ] && [ -d "$cache/python/gguf" ]
}

download() {
  rm -rf "$cache/source" "$cache/python" && mkdir -p "$cache/source" &&
    "$python" -m pip download -q --disable-pip-version-check --no-deps --no-binary llama-cpp-python \
      "llama-cpp-python==$sdist_version" -d "$cache/sdist" &&
    "$python" -m pip install -q --disable-pip-version-check --no-deps --target "$cache/python" "gguf==$gguf_version" &&
    tar -xzf "$cache/sdist/llama_cpp_python-$sdist_version.tar.gz" -C "$cache/source" --strip-components=1
}

# No web page (its build would download), no TLS (the test speaks to loopback), no tests and examples; one file, no shared libraries.
compile() {
  cmake -S "$cache/source/vendor/llama.cpp" -B "$cache/build" -DCMAKE_BUILD_TYPE=Release -DBUILD_SHARED_LIBS=OFF \
    -DLLAMA_BUILD_UI=OFF -DLLAMA_USE_PREBUILT_UI=OFF -DLLAMA_OPENSSL=OFF -DLLAMA_BUILD_TESTS=OFF \
    -DLLAMA_BUILD_EXAMPLES=OFF -DLLAMA_BUILD_APP=OFF &&
    nice -n 10 cmake --build "$cache/build" --target llama-server -j "$jobs" &&
    mkdir -p "$cache/bin" && cp "$cache/build/bin/llama-server" "$cache/bin/"
}

build() {
  [ -x "$python" ] || fail "the workspace is not set up; run ./core.sh setup first"
  command -v cmake >/dev/null || fail "cmake is missing"
  mkdir -p "$cache"
  exec 9>"$cache/lock"
  flock 9    # two calls at once: the second waits for what the first builds
  if is_built; then return; fi
  say "building llama-server $sdist_version (10 to 20 minutes; log: $cache/build.log)"
  rm -f "$cache/stamp"
  { download && compile; } >"$cache/build.log" 2>&1 || { tail -n 20 "$cache/build.log" >&2; fail "the build failed"; }
  rm -rf "$cache/build" "$cache/source" "$cache/sdist"    # half a gigabyte that nothing needs any more
  wanted_stamp >"$cache/stamp"
}

main() {
  if ! is_built; then
    [ "${1:-}" != --check ] || exit 1
    build
  fi
  printf '%s\n' "$cache"
}

main "$@"
exit
