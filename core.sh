#!/usr/bin/env bash
# SPDX-License-Identifier: BSD-3-Clause
# The one entry of CORE for ROS 1: sets a machine up once, then routes to the programs of the packages.
set -euo pipefail

here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")    # the same place, whatever link it is called by
venv=$here/.venv
state=$here/.core
noetic=/opt/ros/noetic/setup.bash

usage() {
  cat <<'EOT'
CORE for ROS 1: contextual safety for robots, in a PyBullet world.

  ./core.sh demo [name:=value …]  walk a quadruped up to a line of cones and see it stop
        method:=none              the same walk without the filter
        task:=open_aisle          a safe task, to see that nothing stops it
        --view                    with RViz;   gui:=true  with PyBullet's window
        --seeds N                 N seeds and a count of the outcomes
        --help                    every argument
  ./core.sh evaluate [--help]     the tasks of the paper and ours, with every method: trials, table, report.html
  ./core.sh gallery [--help]      pictures of every model and world
  ./core.sh test [NAME …]         every test: lint unit python38 cpp ros (or only the named kinds)
  ./core.sh bench NAME [--help]   measure something against its bar; JSON in the last line: filter filter_fuzz grounding
                                  grounding-ros hazard_memory map_truth memory model_faults reasoning render sanitize soundness
  ./core.sh lint                  style, formatting, budgets, catkin_lint, spelling
  ./core.sh install [DIR]         catkin install space (default: install/)
  ./core.sh setup                 only install what is missing and build
  ./core.sh run CMD …             one command in the workspace's environment
  ./core.sh shell                 a shell in which roslaunch, rostopic and rosrun work
  . <(./core.sh env)              the same environment in your own shell

The first call installs Debian packages (apt-packages.txt), a Python venv (requirements.txt) and builds the workspace;
later calls start at once and touch no network. Results go to results/.
EOT
}

say() { printf 'core.sh: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

# ---- set-up, each step idempotent -------------------------------------------------------------------------------------------

missing_packages() {
  local wanted
  if [ -f "$noetic" ]; then return; fi    # a ROS Noetic machine brings its own packages
  command -v dpkg-query >/dev/null || fail "this is neither Debian 12 nor a machine with ROS Noetic; see README, Limits"
  wanted=$(sed -e 's/#.*//' -e '/^[[:space:]]*$/d' "$here/apt-packages.txt")
  # shellcheck disable=SC2086
  comm -23 <(printf '%s\n' $wanted | sort) \
    <(dpkg-query -W -f '${Package} ${db:Status-Status}\n' $wanted 2>/dev/null | awk '$2 == "installed" {print $1}' | sort)
}

ensure_packages() {
  local missing
  missing=$(missing_packages | tr '\n' ' ')
  [ -n "${missing// /}" ] || return 0
  local as_root=()
  if [ "$(id -u)" -ne 0 ]; then
    if ! sudo -n true 2>/dev/null && ! { [ -t 0 ] && command -v sudo >/dev/null && sudo -v; }; then
      fail "neither root nor sudo; please ask an administrator for these packages: $missing"
    fi
    as_root=(sudo -n)
  fi
  say "installing Debian packages (about a minute or two): $missing"
  mkdir -p "$state"
  # shellcheck disable=SC2086
  { "${as_root[@]}" apt-get update -qq &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing; } \
    >"$state/apt.log" 2>&1 || { tail -n 20 "$state/apt.log" >&2; fail "apt-get failed; its output is in .core/apt.log"; }
}

venv_stamp() {
  cat "$here/requirements.txt" <(/usr/bin/python3 --version) <(printf '%s' "$here") | sha256sum | cut -d' ' -f1
}

venv_is_current() { [ "$(cat "$state/venv.stamp" 2>/dev/null)" = "$(venv_stamp)" ]; }

ensure_venv() {
  if venv_is_current; then return 0; fi
  say "making the Python environment .venv (about half a minute)"
  mkdir -p "$state"
  {
    rm -rf "$venv" && /usr/bin/python3 -m venv --system-site-packages "$venv" &&
      "$venv/bin/python3" -m pip install -q --disable-pip-version-check -r "$here/requirements.txt"
  } >"$state/pip.log" 2>&1 || { tail -n 20 "$state/pip.log" >&2; fail "pip failed; its output is in .core/pip.log"; }
  venv_stamp >"$state/venv.stamp"
}

# What a build depends on: the names of all files in the packages, and the newest change of those that are compiled or configured.
build_stamp() {
  (
    cd "$here"
    printf '%s\n' "$here"
    find src -not -name '*.pyc' -not -name __pycache__ -not -path src/CMakeLists.txt | LC_ALL=C sort
    find src -type f \( -name '*.cpp' -o -name '*.h' -o -name '*.msg' -o -name '*.srv' -o -name CMakeLists.txt -o -name package.xml \
      -o -name setup.py -o -path '*/scripts/*' \) -not -path src/CMakeLists.txt -print0 | LC_ALL=C sort -z | xargs -0 sha256sum
  ) | sha256sum | cut -d' ' -f1
}

workspace_make() {
  local ignored=""
  # A system that packages octomap_msgs is asked first; ours has the same definitions and steps aside.
  if [ -d /opt/ros/noetic/share/octomap_msgs ] || [ -d /usr/share/octomap_msgs ]; then ignored=octomap_msgs; fi
  (cd "$here" && catkin_make -DCMAKE_BUILD_TYPE=Release "-DPYTHON_EXECUTABLE=$venv/bin/python3" \
    "-DCATKIN_BLACKLIST_PACKAGES=$ignored" "$@")
}

build_is_current() { [ "$(cat "$state/build.stamp" 2>/dev/null)" = "$(build_stamp)" ]; }

ensure_build() {
  local stamp
  stamp=$(build_stamp)
  if build_is_current; then return 0; fi
  say "building the catkin workspace (about two minutes the first time)"
  workspace_make >"$state/build.log" 2>&1 || { tail -n 40 "$state/build.log" >&2; fail "the build failed; its output is in .core/build.log"; }
  printf '%s' "$stamp" >"$state/build.stamp"
}

is_set_up() { [ -z "$(missing_packages)" ] && venv_is_current && build_is_current; }

setup() {
  case $here in *[[:space:]]*) fail "catkin cannot build in a path with a space: $here; move the checkout" ;; esac
  if ! is_set_up; then
    # Two calls at once: the second waits for what the first installs and builds.
    if ! { mkdir -p "$state" && touch "$state/lock"; } 2>/dev/null; then
      fail "something is missing, and $state cannot be written; its owner must run ./core.sh setup"
    fi
    exec 9>"$state/lock"
    flock -n 9 || { say "waiting for another call that is setting up"; flock 9; }
    ensure_packages
    ensure_venv
    load_tools
    ensure_build
    exec 9>&-
  fi
  load_workspace
}

# ---- environment --------------------------------------------------------------------------------------------------------------

environment() {    # shell code on stdout
  # The set-up files of ROS read variables that are not set.
  cat <<EOT
case \$- in *u*) core_nounset=1; set +u ;; *) core_nounset= ;; esac
if [ -f $noetic ]; then . $noetic; fi
. "$here/devel/setup.bash"
if [ -n "\$core_nounset" ]; then set -u; fi
unset core_nounset
export PATH="$venv/bin:\$PATH" VIRTUAL_ENV="$venv"
export ROS_HOSTNAME="\${ROS_HOSTNAME:-localhost}" ROS_MASTER_URI="\${ROS_MASTER_URI:-http://localhost:11311}"
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
EOT
}

load_tools() {
  set +u
  # shellcheck disable=SC1090
  if [ -f "$noetic" ]; then . "$noetic"; fi
  set -u
  export PATH="$venv/bin:$PATH" VIRTUAL_ENV=$venv
}

load_workspace() {
  set +u
  # shellcheck disable=SC1090
  . <(environment)
  set -u
}

# ---- commands -----------------------------------------------------------------------------------------------------------------

command=${1:-help}
[ $# -eq 0 ] || shift
case $command in
  help | -h | --help) usage ;;
  setup) setup; say "ready" ;;
  demo | evaluate | gallery) setup; exec python3 "$here/src/core_bringup/scripts/$command" "$@" ;;
  test) setup; exec "$here/test/run_tests" "$@" ;;
  bench)
    name=${1:-}
    if ! [ -f "$here/test/bench/$name.py" ]; then
      say "bench: got '$name', allowed $(cd "$here/test/bench" && ls ./*.py | sed 's|^./||; s|[.]py$||' | tr '\n' ' ')"
      exit 2
    fi
    setup; exec python3 "$here/test/bench/$name.py" "${@:2}" ;;
  lint) setup; exec "$here/test/run_tests" lint ;;
  install)
    setup
    target=$(realpath -m "${1:-$here/install}")
    workspace_make -DCMAKE_INSTALL_PREFIX="$target" install
    say "installed; in a new shell: . $target/setup.bash; PATH=$venv/bin:\$PATH    # the Python libraries are in the venv" ;;
  run) setup; exec "$@" ;;
  shell) setup; exec bash --rcfile <(printf '[ -f ~/.bashrc ] && . ~/.bashrc\n'; environment; printf 'PS1="(core) $PS1"\n') -i ;;
  env) setup >&2; environment ;;
  *) say "unknown command '$command'"; usage >&2; exit 2 ;;
esac
