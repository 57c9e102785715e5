# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Two hosts on one machine: network namespaces joined by a cable that can be pulled. Needs the rights of root.

By hand, a zone whose plant is on one host and whose other nodes are on the other, until Ctrl-C:

    python tests/system/hosts.py zone.yaml
"""

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

HOSTS = ("left", "right")
COMMAND = Path(sys.executable).parent / "ros2-deepc"
# Shared memory would be a way around the cable; Fast DDS tries it wherever the machine's id is the same.
_BECOME = """
set -e
mount -t tmpfs none /dev/shm
if [ -e /etc/machine-id ]; then
    echo $0 | md5sum | cut -c 1-32 > /dev/shm/machine-id
    mount --bind /dev/shm/machine-id /etc/machine-id
fi
hostname $0
ip link set lo up
echo ready
exec cat
"""  # lives until its standard input is closed


class NoRightsError(RuntimeError):
    """This machine does not let us make network namespaces; the message says why."""


class Hosts:
    """The hosts ``left`` and ``right``: own network, name and shared memory each, and a cable between them.

    Raises:
        NoRightsError: if they cannot be made.
    """

    def __init__(self):
        self._keepers = {}
        try:
            for host in HOSTS:
                self._keepers[host] = _keeper(host)
            peer = str(self._keepers["right"].pid)
            self._ip("left", "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", peer)
            for i, host in enumerate(HOSTS):
                self._ip(host, "address", "add", f"10.213.7.{i + 1}/24", "dev", "cable")
            self.cable(plugged=True)
        except (OSError, subprocess.CalledProcessError) as error:
            self.close()
            said = getattr(error, "stderr", "") or str(error)
            raise NoRightsError(f"cannot make network namespaces: {said.strip()}") from None

    def command(self, host, *words):
        """A command as it runs on a host; give it absolute paths."""
        keeper = str(self._keepers[host].pid)
        return ["nsenter", "--target", keeper, "--net", "--mount", "--ipc", "--uts", *map(str, words)]

    def cable(self, *, plugged):
        """Pulls the cable, or plugs it in; with it goes the route of multicast, by which hosts find each other."""
        for host in HOSTS:
            self._ip(host, "link", "set", "cable", "up" if plugged else "down")
        for host in HOSTS if plugged else ():
            self._ip(host, "route", "replace", "239.255.0.0/16", "dev", "cable")

    def close(self):
        """Removes the hosts; processes that still run on them stay alone."""
        for keeper in self._keepers.values():
            keeper.kill()
            keeper.communicate()

    def _ip(self, host, *words):
        subprocess.run(self.command(host, "ip", *words), check=True, capture_output=True, text=True)


def _keeper(host):
    """A process that keeps the namespaces of a host."""
    keeper = subprocess.Popen(
        ["unshare", "--net", "--mount", "--ipc", "--uts", "sh", "-c", _BECOME, host],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if keeper.stdout.readline().strip() != "ready":
        raise OSError(keeper.communicate()[1].strip())
    return keeper


def environment(domain_id):
    """Of processes on the hosts: found by multicast in their subnet."""
    here = {name: value for name, value in os.environ.items() if name != "ROS_STATIC_PEERS"}
    return here | {"ROS_DOMAIN_ID": str(domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


def main():
    """Runs a zone on two hosts."""
    config = Path(sys.argv[1]).resolve()
    hosts = Hosts()
    roles = {"left": ("plant",), "right": ("monitor", "controller", "operator")}
    try:
        children = [
            subprocess.Popen(hosts.command(host, COMMAND, "run", config, "--role", role), env=environment(0))
            for host, there in roles.items()
            for role in there
        ]
        with suppress(KeyboardInterrupt):
            for child in children:
                child.wait()
        for child in children:
            child.terminate()
            child.wait()
    finally:
        hosts.close()


if __name__ == "__main__":
    main()
