# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The command line `ros2-deepc`."""

import importlib
import sys

import typer

app = typer.Typer(
    help="Online data-enabled predictive control and proofs from data, on ROS 2.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

# In the order of --help; by module, so that a command pays only for what it imports.
COMMANDS = {
    "demo": "demo",
    "run": "run",
    "record": "record",
    "plants": "plants",
    "analyze": "analyze",
    "replay": "replay",
    "report": "bags",
    "check": "bags",
    "export": "bags",
    "layout": "bags",
    "tune": "tune",
    "gateway": "gateway",
    "field": "gateway",
    "ask": "ask",
}


def _register() -> None:
    """Registers the command that is asked for; all of them when it is none of them (for the list in --help)."""
    asked = [name for name in COMMANDS if name in sys.argv[1:2]]
    for name in asked or COMMANDS:
        app.command(name)(getattr(importlib.import_module(f"ros2_deepc.commands.{COMMANDS[name]}"), name))
    if asked:
        app.callback()(_top)


def _top() -> None:
    """Keeps a single command a subcommand."""


def main() -> int:
    """Console script; every expected error is one line on stderr and exit code 1 (2 for wrong usage)."""
    _register()
    try:
        code = app(standalone_mode=False)  # a command that raised typer.Exit gives its code here
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201
        return 1
    except Exception as error:
        show = getattr(error, "show", None)  # usage errors explain themselves
        if show is None:
            raise
        show()
        return int(getattr(error, "exit_code", 2))
    return code if isinstance(code, int) else 0
