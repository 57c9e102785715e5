#!/bin/sh
# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
#
# Installs what the gateway is tested against and nobody here wrote: mbpoll, libmodbus, tshark (Debian), node-opcua (npm);
# and Chromium, in which reports of runs are opened.
# peers.sh [FOLDER]     node_modules go to FOLDER, build/peers by default; tests/gateway/test_peers.py looks there.
set -eu
folder=${1:-build/peers}
mkdir -p "$folder"

packages=
want() { # want COMMAND-OR-FILE PACKAGE...: asks for the packages if it is not there
    command -v "$1" > /dev/null || [ -e "$1" ] || { shift && packages="$packages $*"; }
}
want mbpoll mbpoll
want /usr/include/modbus/modbus.h libmodbus-dev
want tshark tshark
want gcc gcc libc6-dev
command -v google-chrome > /dev/null || command -v chromium-browser > /dev/null || want chromium chromium
want node nodejs
want npm npm
if [ -n "$packages" ]; then
    sudo=
    [ "$(id -u)" = 0 ] || sudo="sudo -n"
    $sudo apt-get update -qq
    # shellcheck disable=SC2086 # one word a package
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages > /dev/null
fi
[ -d "$folder/node_modules/node-opcua" ] || npm install --silent --no-audit --no-fund --prefix "$folder" node-opcua@2
