#!/bin/sh
# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
#
# Installs what the gateway is tested against and nobody here wrote: mbpoll and libmodbus (Debian), node-opcua (npm).
# peers.sh [FOLDER]     node_modules go to FOLDER, build/peers by default; tests/gateway/test_peers.py looks there.
set -eu
folder=${1:-build/peers}
mkdir -p "$folder"
if command -v apt-get > /dev/null; then
    sudo=$(command -v sudo || true)
    [ "$(id -u)" = 0 ] && sudo=
    $sudo apt-get update -qq
    $sudo apt-get install -y -qq --no-install-recommends mbpoll libmodbus-dev tshark nodejs npm gcc libc6-dev pkg-config
fi
[ -d "$folder/node_modules/node-opcua" ] || npm install --silent --no-audit --no-fund --prefix "$folder" node-opcua@2
