# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc replay`: a recorded run again, over topics or through today's code."""

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..bags.errors import check_target
from ..bags.figure import draw
from ..bags.provenance import facts
from ..bags.reader import BagReader
from ..bags.recording import Recording, find_namespace
from ..bags.replay import replay as compare
from ..bags.whatif import what_if
from ..bags.writer import RUN_METADATA
from ..control import DeepcController
from ..demo import SETTINGS
from ..nodes.config import Parameters, load, parse
from ..nodes.controller_settings import settings_for
from ..nodes.player import Player
from ..nodes.replaying import cores
from ..ros.parameters import ConfigError
from ..ros.run import ros
from .bar import bar

_PARTS = ("controller", "monitor", "all")
_SECONDS = 2.0  # to let readers find the player


def replay(
    bag: Annotated[Path, typer.Argument(help="Folder of the bag, or one .mcap file.")],
    recompute: Annotated[
        str, typer.Option(help="Feed the samples through today's code and compare: controller, monitor or all.")
    ] = "",
    settings: Annotated[Path | None, typer.Option(help="YAML of the run, if the bag does not hold its own.")] = None,
    try_settings: Annotated[
        Path | None, typer.Option("--what-if", help="YAML with other controller settings: what would they have done?")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="With --what-if: picture of both, e.g. both.png.")] = None,
    rate: Annotated[
        float, typer.Option(help="Republish at this multiple of real time; 0 = as fast as possible.", min=0)
    ] = 1.0,
    max_pause: Annotated[
        float, typer.Option(help="Longest silence of the bag that is kept when it is republished [s].", min=0)
    ] = math.inf,
    step: Annotated[bool, typer.Option("--step", help="Republish sample by sample, at each press of Enter.")] = False,
    namespace: Annotated[str | None, typer.Option(help="Namespace of the plant, if the bag holds several.")] = None,
) -> None:
    """Replay a bag: republish it, or recompute it and compare to the bit.

    With --recompute the exit code says whether all commands and verdicts came out the same; if not, the first sample
    that differs is named, with the field and by how much.

    Examples:
      ros2-deepc replay runs/today/bag --rate 10 --max-pause 2
      ros2-deepc replay runs/today/bag --recompute all
      ros2-deepc replay runs/today/bag --what-if other.yaml
    """
    console = Console()
    if recompute:
        _recompute(console, bag, recompute, settings, namespace)
    elif try_settings is not None:
        _what_if(console, bag, load(try_settings), namespace, out)
    else:
        _republish(console, bag, rate, max_pause, step)


def _settings(bag: Path, given: Path | None) -> Parameters:
    if given is not None:
        return load(given)
    for attachment in BagReader(bag).attachments():
        if attachment.name == SETTINGS:
            return parse(attachment.data.decode(), f"{bag}:{SETTINGS}")
    raise ConfigError(f"bag {bag} does not hold the settings of its run: give them with --settings FILE")


def _recompute(console: Console, bag: Path, part: str, settings: Path | None, namespace: str | None) -> None:
    if part not in _PARTS:
        raise ConfigError(f"--recompute {part}: choose one of {', '.join(_PARTS)}")
    find_namespace(BagReader(bag), namespace)
    makers = cores(_settings(bag, settings))
    chosen = makers if part == "all" else {part: makers[part]}
    with bar(console, "replaying") as progress:
        result = compare(bag, chosen, namespace=namespace, progress=progress)
    for topic, count in result.compared.items():
        console.print(f"  {topic}: {count} compared")
    for difference in result.differences:
        console.print(f"  first difference: {difference}", soft_wrap=True, highlight=False, markup=False)
    for topic, count in result.unmatched.items():
        if count:
            console.print(f"  {topic}: {count} recorded or computed only")
    if result.loop_hash:
        console.print(f"  loop_hash {result.loop_hash}")
    console.print("the same to the bit" if result.same else "NOT the same")
    if not result.same:
        for name, then, now in _changed(BagReader(bag)):
            console.print(f"  {name}: {then} when it was recorded, {now} now", soft_wrap=True, highlight=False)
        raise typer.Exit(1)


def _changed(reader: BagReader) -> list[tuple[str, str, str]]:
    """What is another software than the one that recorded: name, then, now."""
    then, now = reader.metadata.get(RUN_METADATA, {}), facts()
    return [(name, then[name], now[name]) for name in now if then.get(name, now[name]) != now[name]]


def _what_if(console: Console, bag: Path, parameters: Parameters, namespace: str | None, out: Path | None) -> None:
    if out is not None:
        check_target(out)
    reader = BagReader(bag)
    plants = reader.decoded([f"{find_namespace(reader, namespace)}/plant_info"])
    info = next((message for _, message in plants), None)
    if info is None:
        raise ConfigError(f"bag {bag} has no plant_info: nothing says what the plant is")
    with bar(console, "reading") as progress:
        recording = Recording(reader, namespace, progress=progress)
    with recording, bar(console, "asking") as progress:
        head = next(recording.stretches(1))
        controller = DeepcController(head.u.shape[1], head.y.shape[1], settings_for(parameters["controller"], info))
        answer = what_if(recording, controller, progress=progress)
        if answer.missing:
            raise ConfigError(f"these settings never gave an answer on this run: {answer.missing}")
        if out is not None:
            draw(recording, out, what_if=answer.u)
    console.print(f"  {answer.solved} solved, {answer.failed} not; first answer for k = {answer.first_k}")
    if out is not None:
        console.print(f"  picture: {out}", soft_wrap=True)
    for name, unit, furthest in zip(head.input_names, head.input_units, answer.furthest, strict=True):
        console.print(f"  {name}: at most {furthest:.4g} {unit} from what was applied")


def _republish(console: Console, bag: Path, rate: float, max_pause: float, step: bool) -> None:
    reader = BagReader(bag)
    reader.must_hold_something()

    def wait_for_enter() -> None:
        input("Enter for the next sample ")

    with ros([]) as context:
        speed, gate = (0.0, wait_for_enter) if step else (rate, None)
        player = Player(reader, speed, pause=max_pause, gate=gate, context=context, use_global_arguments=False)
        player.wait_for_readers(_SECONDS)
        if step:
            count = player.play()
        else:
            with bar(console, "publishing") as progress:
                count = player.play(progress)
        player.destroy_node()
    console.print(f"  {count} messages published")
