# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc gateway` and `ros2-deepc field`: plants behind other protocols."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..gateway.commands import HEADER, FieldOptions, run_field, run_gateway
from ..gateway.commands import check as check_tags


def gateway(
    tags: Annotated[Path, typer.Argument(help="YAML with the tags of the field.")],
    check: Annotated[bool, typer.Option("--check", help="Validate, read every tag once, write nothing.")] = False,
    namespace: Annotated[str, typer.Option(help="Namespace of the zone.")] = "",
) -> None:
    """Connect a field behind ROS topics, OPC UA or Modbus/TCP to the controller. Starts in SHADOW: writes nothing.

    Examples:
      ros2-deepc gateway tags.yaml --check
      ros2-deepc gateway tags.yaml --namespace /grid
    """
    if not check:
        raise typer.Exit(run_gateway(tags, namespace))
    rows = [HEADER, *check_tags(tags, namespace)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        typer.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def field(
    plant: Annotated[str, typer.Argument(help="A registered plant, e.g. wscc9.")],
    modbus: Annotated[bool, typer.Option("--modbus", help="Serve it as a Modbus/TCP device.")] = False,
    opcua: Annotated[bool, typer.Option("--opcua", help="Serve it as an OPC UA server.")] = False,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="TCP port; 0 = 5020 for Modbus, 4840 for OPC UA.", min=0, max=65535)] = 0,
    option: Annotated[list[str] | None, typer.Option("--option", "-o", help="Option of the plant; repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the plant's randomness.", min=0)] = 0,
    speed: Annotated[float, typer.Option(help="How many times faster than its own time it runs.", min=1e-6)] = 1.0,
    pki: Annotated[Path | None, typer.Option(help="OPC UA: folder of certificates; without it, no encryption.")] = None,
    tags: Annotated[Path | None, typer.Option(help="Write a tag map that fits to this file.")] = None,
    number: Annotated[str, typer.Option("--type", help="Modbus: type of the numbers, e.g. float32.")] = "float64",
) -> None:
    """Run a plant behind a Modbus or OPC UA server until Ctrl-C, to try the whole chain at home.

    Example:
      ros2-deepc field wscc9 --modbus --tags tags.yaml
    """
    if modbus == opcua:
        raise ValueError("choose --modbus or --opcua")
    pairs = [text.partition("=") for text in option or []]
    if any(not equals for _, equals, _ in pairs):
        raise ValueError(f"-o {next(t for t, e, _ in pairs if not e)}: write KEY=VALUE, e.g. variant=full")
    options = FieldOptions(
        protocol="modbus" if modbus else "opcua",
        host=host,
        port=port,
        options={key: value for key, _, value in pairs},
        seed=seed,
        speed=speed,
        pki=pki,
        tags=tags,
        type=number,
    )
    console = Console()
    run_field(plant, options, lambda text: console.print(text, soft_wrap=True, highlight=False, markup=False))
