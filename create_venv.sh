#!/bin/sh
# Usage: create_venv.sh FOLDER GOAL. Creates the environment FOLDER for `make GOAL`; keeps one that fits.
#
# PyBullet 3.2.7 has one wheel that fits: Python 3.11 on Linux x86_64. Elsewhere pip compiles it for minutes, or fails
# without a compiler. Hence Python 3.11 is preferred, and compiling needs COMPILE_PYBULLET=1. PYTHON names an interpreter.
set -eu
venv=$1 goal=$2
PYTHON=${PYTHON:-} COMPILE_PYBULLET=${COMPILE_PYBULLET:-}

# exit status 0 means yes
has_wheel='import platform, sys
sys.exit((sys.version_info[:2], sys.platform, platform.machine()) != ((3, 11), "linux", "x86_64"))'
is_recent='import sys
sys.exit(sys.version_info < (3, 11))'
has_headers='import os, sys, sysconfig
sys.exit(not os.path.isfile(os.path.join(sysconfig.get_path("include"), "Python.h")))'
describe='import platform
print("Python", platform.python_version(), "on", platform.system(), platform.machine())'

stop() {
  printf '%s\n' "$1" >&2
  exit 1
}

stop_without_python() {
  stop "$1
PyBullet 3.2.7 has a wheel for Python 3.11 on Linux x86_64 only. Install Python 3.11 there and run the command again:
  Debian 12                  sudo apt install python3.11-venv && make $goal
  Debian 13, Ubuntu          sudo apt install pipx && pipx install uv && PATH=\"\$HOME/.local/bin:\$PATH\" make $goal
  another installation       make PYTHON=/path/to/python3.11 $goal
Or compile PyBullet with Python 3.11 or newer (about 6 minutes of CPU time):
  Debian 12+, Ubuntu 24.04+  sudo apt install g++ python3-dev python3-venv && make COMPILE_PYBULLET=1 $goal
  macOS                      xcode-select --install; brew install python@3.11 && make COMPILE_PYBULLET=1 $goal"
}

# Candidates are run, not only looked up: pyenv puts a python3.11 on PATH that fails while that version is not active.
if [ -n "$COMPILE_PYBULLET" ]; then fits=$is_recent; else fits=$has_wheel; fi
found='' others=''
for candidate in ${PYTHON:-"$venv/bin/python" python3.11 python3}; do
  command -v "$candidate" >/dev/null || continue
  if "$candidate" -c "$fits" 2>/dev/null; then
    found=$candidate
    break
  fi
  others="$others
  $candidate is $("$candidate" -c "$describe" 2>/dev/null || echo "a command that fails")"
done

if [ -n "$found" ] && ! "$found" -c "$has_wheel"; then
  if ! command -v c++ >/dev/null || ! command -v cc >/dev/null || ! "$found" -c "$has_headers"; then
    stop "Compiling PyBullet needs a C++ compiler and Python's headers; on Debian and Ubuntu: sudo apt install g++ python3-dev"
  fi
  echo "PyBullet will be compiled for $("$found" -V): about 6 minutes of CPU time."
fi

if [ -n "$found" ]; then
  "$found" -c 'import ensurepip, venv' 2>/dev/null || \
    stop "$found lacks the venv module; on Debian and Ubuntu: sudo apt install ${found##*/}-venv"
  # An environment of another version would keep its old interpreter without --clear.
  if "$venv/bin/python" -c 'import pip' 2>/dev/null && [ "$("$venv/bin/python" -V)" = "$("$found" -V)" ]; then
    exit
  fi
  "$found" -m venv --clear "$venv"
elif [ -z "$PYTHON" ] && [ "$(uname -sm)" = "Linux x86_64" ] && command -v uv >/dev/null; then
  # uv downloads Python 3.11; without a network it would retry for 10 seconds.
  UV_HTTP_RETRIES=0 uv venv --seed --clear --python 3.11 "$venv" || \
    stop_without_python "uv could not create an environment of Python 3.11.$others"
else
  stop_without_python "No suitable Python.${others:-
  ${PYTHON:-python3.11 or python3} was not found}"
fi
