# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

# Installs the checkout into a virtual environment, editable. Usage: install.sh VENV
#
# The messages are C extensions and need Python.h. Where it is not installed (Debian keeps it in python3-dev), Debian's
# package is unpacked inside the environment; nothing on the system changes.
set -e
venv=$1
python="$venv/bin/python"
headers="$venv/python-headers"

# Runs a command; its output is shown only if it fails.
quietly() {
    "$@" >"$venv/last-command.log" 2>&1 || { cat "$venv/last-command.log" >&2; return 1; }
}

unpack_headers() {
    package="lib$("$python" -c 'import sys; print("python%d.%d-dev" % sys.version_info[:2])')"
    echo "Python.h is not installed: unpacking Debian's $package into $headers"
    rm -rf "$headers" && mkdir -p "$headers"
    [ -n "$(find /var/lib/apt/lists -name '*_Packages*' 2>/dev/null | head -n 1)" ] || quietly apt-get update
    (cd "$headers" && apt-get download -qq "$package" 2>/dev/null && dpkg -x "$package"*.deb . && rm -f -- *.deb)
}

if ! "$python" -c 'import os, sysconfig; raise SystemExit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))'; then
    if [ ! -d "$headers/usr/include" ]; then
        command -v apt-get >/dev/null && unpack_headers || {
            echo "error: no Python.h here: install the development files of your Python (Debian: apt install python3-dev)" >&2
            exit 1
        }
    fi
    version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
    root=$(cd "$headers/usr" && pwd)
    export CPATH="$root/include/$version:$root/include"
    library=$(find "$root/lib" -name "lib$version.a" | head -n 1)
    export SKBUILD_CMAKE_DEFINE="Python3_INCLUDE_DIR=$root/include/$version;Python3_LIBRARY=$library"
fi
pip() { "$python" -m pip install --quiet --disable-pip-version-check "$@"; }
pip -e .

# EPANET has no wheel for Python 3.13: it is compiled from source, which needs SWIG (from PyPI, too).
if ! "$python" -c 'import epanet' 2>/dev/null; then
    pip swig
    swig=$("$python" -c 'import pathlib, swig; print(pathlib.Path(swig.__file__).parent / "data")')
    PATH="$(cd "$swig" && pwd)/bin:$PATH" SWIG_LIB=$(echo "$swig"/share/swig/*) pip "owa-epanet>=2.3,<2.4"
fi
