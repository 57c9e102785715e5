# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc plants`: what there is to control."""

from importlib.metadata import entry_points
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from ..nodes.config import node_class


def plants(
    name: Annotated[str, typer.Argument(help="A registered plant, or the path of a plant's YAML file.")] = "",
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", help="Option of the plant, e.g. variant=full; repeatable.")
    ] = None,
) -> None:
    """List the plants with their structure, or print the numbers of one.

    Examples:
      ros2-deepc plants
      ros2-deepc plants net3 -o hour=2
      ros2-deepc plants my_grid.yaml
    """
    console = Console()
    node = node_class("plant")
    if name:
        parameters = {"plant": name, "options": option or [""]}
        console.print(node.describe(parameters), soft_wrap=True, highlight=False, markup=False)  # type: ignore[attr-defined]
        return
    table = Table("plant", "n", "q", "r", "s", "inputs", "outputs", "Ts", box=None, padding=(0, 1))
    described = []
    for each in sorted(entry.name for entry in entry_points(group="ros2_deepc.plants")):
        plant = node.plant_of({"plant": each})  # type: ignore[attr-defined]
        structure = ("-" if value == 0 and plant.system is None else str(value) for value in plant.prior)
        inputs, outputs = ", ".join(plant.input_names), ", ".join(plant.output_names)
        table.add_row(each, *structure, inputs, outputs, f"{plant.sample_time:g} s")
        described.append(f"{each}: {plant.description}")
    console.print(table)
    console.print("\n" + "\n".join(described), highlight=False, markup=False)
