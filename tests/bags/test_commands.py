# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The commands on bags: whatever is wrong is said in one line that tells what to do, before any long work."""

import numpy as np
import pytest
from std_msgs.msg import Float64

from ros2_deepc.bags import BagWriter
from ros2_deepc.bags.convert import to_cdr

READING = {
    "report": ("report", "--out", "r.html"),
    "export": ("export", "--out", "r.csv"),
    "layout": ("layout", "--out", "r.json"),
    "recompute": ("replay", "--recompute", "all"),
    "republish": ("replay",),
}


@pytest.fixture
def bad(record, make, tmp_path, monkeypatch):
    """A folder with all sorts of bags that are none, or not what is needed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "zero.mcap").touch()
    (tmp_path / "folder").mkdir()
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/grid/outputs", "deepc_msgs/msg/Sample")
    with BagWriter(tmp_path / "foreign") as bag:
        for name in ("/pump", "/level"):
            bag.add_topic(name, "std_msgs/msg/Float64")
            bag.write(name, to_cdr(Float64(data=1.0)), 1)
    with BagWriter(tmp_path / "two") as bag:
        for zone in ("/a", "/b"):
            bag.add_topic(f"{zone}/outputs", "deepc_msgs/msg/Sample")
            bag.write(f"{zone}/outputs", to_cdr(make.sample(0, [1.0])), 1)
    record(K=20, collect=10, name="good")
    return tmp_path


def one_line(seen, hint):
    code, _, err = seen
    assert code == 1
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert hint in err


@pytest.mark.parametrize("command", READING)
@pytest.mark.parametrize(
    ("bag", "hint"),
    [
        ("nowhere", "no bag at nowhere: name the folder of a run or of a bag"),
        ("folder", "bag folder has no file that ends in .mcap"),
        ("text.mcap", "nothing can be read of bag text.mcap: text.mcap: 5 bytes lost at byte 0: not an MCAP file"),
        ("zero.mcap", "nothing can be read of bag zero.mcap: zero.mcap: not an MCAP file"),
        ("empty", "bag empty holds no message: nothing was recorded"),
    ],
)
def test_what_is_no_bag(deepc, bad, command, bag, hint):
    name, *options = READING[command]
    one_line(deepc(name, bag, *options), hint)
    assert not list(bad.glob("r.*"))


@pytest.mark.parametrize("command", [name for name in READING if name != "republish"])
@pytest.mark.parametrize(
    ("bag", "options", "hint"),
    [
        (
            "foreign",
            (),
            "bag foreign has no plant, that is no topic .../outputs of deepc_msgs/msg/Sample; it has /level, ",
        ),
        ("two", (), "bag two has 2 plants: name one of /a, /b as --namespace"),
        ("good", ("--namespace", "/moon"), "bag good has no plant '/moon'; it has /grid"),
    ],
)
def test_plants_that_are_not_there(deepc, bad, command, bag, options, hint):
    name, *more = READING[command]
    one_line(deepc(name, bag, *more, *options), hint)
    assert not list(bad.glob("r.*"))


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("report", "good", "--out", "none/r.html"), "there is no folder none; make it first"),
        (("report", "good", "--out", "folder"), "cannot write folder: it is a folder; name a file in it"),
        (("report", "good", "--out", "/dev/full"), "cannot write /dev/full: No space left on device"),
        (("export", "good", "--out", "r.xlsx"), "the name must end in .csv, .parquet, .png, .svg, .pdf or .json"),
        (("export", "good", "--out", "none/r.csv"), "there is no folder none; make it first"),
        (("export", "good", "--out", "/proc/r.png"), "cannot write /proc/r.png"),
        (("layout", "good", "--out", "r.txt"), "end it in .json (Foxglove) or .xml (PlotJuggler)"),
        (("layout", "good", "--out", "none/r.json"), "there is no folder none; make it first"),
        (("check", "good", "--repair", "good"), "the folder is not empty; choose another name"),
        (("check", "good", "--repair", "/proc/new"), "cannot record into /proc/new"),
        (("check", "text.mcap", "--repair", "new"), "not an MCAP file"),
        (("replay", "good", "--recompute", "planets"), "--recompute planets: choose one of controller, monitor, all"),
        (("replay", "good", "--recompute", "all"), "does not hold the settings of its run: give them with --settings"),
        (("replay", "good", "--recompute", "all", "--settings", "none.yaml"), "cannot read none.yaml"),
        (("replay", "good", "--what-if", "none.yaml"), "cannot read none.yaml"),
        (
            ("tune", "foreign", "--input", "/pump", "--output", "/moon"),
            "bag foreign has no topic /moon; it has /level, ",
        ),
        (("tune", "foreign", "--input", "/pump", "--output", "/level:x"), "there is no field x; the message has data"),
    ],
)
def test_bad_targets_and_options(deepc, bad, arguments, hint):
    before = sorted(path.name for path in bad.iterdir())
    one_line(deepc(*arguments), hint)
    assert sorted(path.name for path in bad.iterdir()) == before


def test_a_target_is_looked_at_before_the_bag_is_read(deepc, bad):
    one_line(deepc("report", "nowhere", "--out", "none/r.html"), "there is no folder none")
    one_line(deepc("export", "nowhere", "--out", "r.xlsx"), "must end in .csv")


def test_a_replay_that_differs_says_which_software_recorded(deepc, make, tmp_path):
    settings = {"settings.yaml": b"/**/controller: {ros__parameters: {N: 3, L: 5, terminal: none}}"}
    messages = make.run_messages(*make.simulate(60, 1, 30), 30)
    make.write_bag(tmp_path / "bag", messages, attach=settings, metadata={"version_numpy": "0.1", "seed": "1"})
    code, out, err = deepc("replay", tmp_path / "bag", "--recompute", "controller")
    assert (code, err) == (1, "")
    assert "first difference: inputs of epoch 0 k = 0: values[0] was " in out
    assert f"version_numpy: 0.1 when it was recorded, {np.__version__} now" in out


def test_a_report_of_little_and_of_much_is_summed_up_in_few_words(deepc, make, tmp_path):
    monitored = [("outputs", make.sample(k, [np.nan if k == 5 else 1.0])) for k in range(30)]
    make.write_bag(tmp_path / "monitored", monitored)
    moving = [(name, make.sample(k, [k, 0.0])) for k in range(200) for name in ("reference", "outputs")]
    make.write_bag(tmp_path / "moving", moving)
    lost = [("reference", make.sample(0, [1.0])), *monitored]
    make.write_bag(tmp_path / "lost", lost[:7])
    for name, words in (("monitored", "-"), ("moving", "0, 0, 0, 0, 0, 0 and 194 more"), ("lost", "-")):
        code, out, err = deepc("report", tmp_path / name, "--out", tmp_path / "r.html")
        assert (code, err) == (0, "")
        assert words in out
        assert "None" not in out


def test_check_says_that_there_is_nothing(deepc, bad):
    for bag, hint in (("empty", "error: empty: no messages"), ("text.mcap", "not an MCAP file")):
        code, out, err = deepc("check", bag)
        assert (code, err) == (1, "")
        assert hint in out
        assert "0 messages, see above" in out


def test_output_that_is_no_terminal_has_no_bar(deepc, bad):
    code, out, err = deepc("export", "good", "--out", "r.csv")
    assert (code, out, err) == (0, "20 samples: r.csv\n", "")
