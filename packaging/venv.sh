# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

# Makes a virtual environment after checking what the build needs; every failure is one line.
# Usage: venv.sh PYTHON VENV
python=$1
venv=$2

fail() {
    echo "error: $1" >&2
    exit 1
}

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) ||
    fail "no $python here: install python3 with venv (Debian: apt install python3-venv), or name another: make PYTHON=python3.12"
case $version in
3.11 | 3.12 | 3.13) ;;
*) fail "ros2_deepc needs CPython 3.11, 3.12 or 3.13, $python is $version: name another one, e.g. make PYTHON=python3.12" ;;
esac
[ "$(uname -sm)" = "Linux x86_64" ] ||
    fail "the ROS wheels exist for Linux on x86_64 only, this is $(uname -sm): use colcon on an installed ROS 2 instead"
for tool in "${CC:-gcc}" "${CXX:-g++}"; do
    command -v "$tool" >/dev/null || fail "no compiler $tool here: install gcc and g++ (Debian: apt install gcc g++)"
done
[ -x "$venv/bin/python" ] && [ -d "$venv/include" ] && exit 0
"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "$python cannot make virtual environments: install its venv module (Debian: apt install python3-venv)"
echo "Setting up $venv (once; about 200 MB of wheels and a minute or two)"
{ "$python" -m venv "$venv" && touch "$venv/COLCON_IGNORE"; } || fail "could not make the virtual environment $venv"
