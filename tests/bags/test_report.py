# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The HTML report: self-contained, well formed, and its numbers are those of the run."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from matplotlib.image import imread
from rcl_interfaces.msg import Log

from ros2_deepc.bags import BagError, BagReader, BagWriter, load_run
from ros2_deepc.bags.convert import to_cdr, type_name
from ros2_deepc.bags.panels import page_data
from ros2_deepc.bags.report import write_report
from ros2_deepc.bags.spoken import spoken
from ros2_deepc.bags.trends import Trends

VOID = {"meta", "link", "br"}


class Page(HTMLParser):
    """Text of a page by tag; fails on tags that do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.links = [], "", []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.links += [v for k, v in attrs if k in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data if self.open and self.open[-1] not in ("style",) else ""


@pytest.fixture
def faulty(make, tmp_path):
    """A run with everything in it: modes, failures, a missing input, and names that must be escaped."""
    u, y, ref = make.simulate(120, 2, 60)
    messages = make.run_messages(u, y, ref, 60)
    for name, message in messages:
        if name == "plant_info":
            message.output_names = ["a<b>", "x & </script> y"]
        if name == "controller/state" and message.k >= 110:
            message.mode, message.failures = ControllerState.FALLBACK, message.k - 109
    messages = [m for m in messages if not (m[0] == "inputs" and m[1].k == 70)]
    settings = {"settings.yaml": b"/**/controller: {ros__parameters: {horizon: 3}}"}
    make.write_bag(tmp_path / "bag", messages, attach=settings, metadata={"seed": "2"})
    return tmp_path / "bag"


def test_page_is_well_formed_and_alone(faulty, tmp_path):
    write_report(faulty, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    page = Page(text)
    assert page.links == ["data:,"]
    assert not re.search(r"https?://|url\(|import\(|fetch\(", text)
    for words in (
        "bench · two", "a<b>", "x & </script> y", "not proved", "mode fallback", "optimisation failed, 1 in all",
        "input not recorded", "reference changes", "one mode is out of reach", "horizon",
    ):  # fmt: skip
        assert words in page.text, words
    assert "samples missing: 1 before epoch 0 k = 71" in page.text
    assert load_run(faulty).loop_hash in page.text


def test_data_in_the_page_is_the_run(faulty, tmp_path):
    write_report(faulty, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)[1])
    run = load_run(faulty)
    assert data == json.loads(json.dumps(page_data(Trends.of(run))))
    y = next(line for line in data["panels"][0]["lines"] if line["name"] == "a<b>")
    np.testing.assert_allclose(y["y"], run.y[:, 0], rtol=1e-6, atol=1e-12)
    inputs = next(p for p in data["panels"] if p["title"].startswith("inputs"))
    assert inputs["lines"][0]["y"][70] is None
    assert inputs["limits"] == [-1, 1]
    strips = next(p for p in data["panels"] if "strips" in p)["strips"]
    assert [s["name"] for s in strips] == ["mode", "R-ctrl.", "C-ctrl.", "R-obs.", "C-obs."]
    assert strips[0]["parts"][-1][2] == "FALLBACK"


def test_events_are_in_order_and_where_they_happened(faulty):
    found = Trends.of(load_run(faulty)).events.first
    assert [k for _, k, _, _ in found] == sorted(k for _, k, _, _ in found)
    assert (0, 60, pytest.approx(6.0), "mode controlling") in found
    assert (0, 90, pytest.approx(9.0), "reference changes") in found
    assert (0, 70, pytest.approx(7.0), "input not recorded") in found
    assert (0, 110, pytest.approx(11.0), "mode fallback") in found
    failures = [event for event in found if "optimisation" in event[3]]
    assert failures == [(0, 110, pytest.approx(11.0), "optimisation failed, 1 in all")]  # and at each sample after that


def test_what_nodes_complained_about_is_in_the_report(record, tmp_path):
    bag = record(K=30, collect=20)
    said = [
        (
            "/diagnostics",
            DiagnosticArray(status=[DiagnosticStatus(name="zone/controller", level=b"\x01", message="late")]),
        ),
        ("/rosout", Log(name="zone.plant", level=30, msg="a sample <twice>")),
        ("/rosout", Log(name="zone.plant", level=30, msg="a sample <twice>")),
        ("/rosout", Log(name="zone.plant", level=20, msg="all is well")),
        (
            "/diagnostics",
            DiagnosticArray(status=[DiagnosticStatus(name="zone/controller", level=b"\x00", message="fine")]),
        ),
        (
            "/diagnostics",
            DiagnosticArray(status=[DiagnosticStatus(name="zone/controller", level=b"\x02", message="late")]),
        ),
    ]
    with BagWriter(tmp_path / "more") as more:
        for raw in BagReader(bag.folder).messages():
            more.add_topic(raw.topic, raw.type)
            more.write(raw.topic, raw.data, raw.log_time)
        last = raw.log_time
        for i, (topic, message) in enumerate(said, 1):
            more.add_topic(topic, type_name(type(message)))
            more.write(topic, to_cdr(message), last + i * 10**9)
    reader = BagReader(tmp_path / "more")
    start = 1e-9 * (last - reader.start)
    expected = [(1, "zone/controller", "warn", "late"), (2, "zone.plant", "warn", "a sample <twice>"),
                (6, "zone/controller", "error", "late")]  # fmt: skip
    found = spoken(reader, 10)
    assert [(round(t - start), *rest) for t, *rest in found] == expected
    assert spoken(reader, 1) == found[:1]
    write_report(tmp_path / "more", tmp_path / "r.html")
    page = Page((tmp_path / "r.html").read_text())
    assert "a sample <twice>" in page.text
    assert "all is well" not in page.text


def test_damage_is_said_in_the_report(record, tmp_path):
    bag = record(K=200)
    (bag.folder / "metadata.yaml").unlink()
    (bag.folder / "INCOMPLETE").touch()
    write_report(bag.folder, tmp_path / "r.html")
    assert "the recording was not closed" in (tmp_path / "r.html").read_text()


def test_monitor_only_has_a_report(make, tmp_path):
    make.write_bag(tmp_path / "bag", [("outputs", make.sample(k, [1.0])) for k in range(5)])
    write_report(tmp_path / "bag", tmp_path / "r.html")
    Page((tmp_path / "r.html").read_text())


def test_folder_that_is_not_there(record, tmp_path):
    with pytest.raises(BagError, match="cannot write"):
        write_report(record(K=20, collect=10).folder, tmp_path / "none" / "r.html")


def test_browser_draws_it_without_a_word_on_the_console(faulty, tmp_path, in_browser):
    page = tmp_path / "r.html"
    write_report(faulty, page)
    panels = page_data(Trends.of(load_run(faulty)))["panels"]
    looks = {seen["name"]: seen for seen in in_browser(page)}
    assert set(looks) == {"light", "dark", "narrow"}
    for name, seen in looks.items():
        assert seen["said"] == []
        assert seen["asked"] == [f"file://{page}"]  # nothing of the network
        assert len(seen["canvases"]) == len(panels)
        assert min(seen["canvases"]) > 50, "a panel is empty"  # colours, with those between them at the edges of lines
        assert not seen["wide"], f"{name}: the page is wider than the window"
        assert (seen["points"], seen["zooms"], seen["returns"]) == (True, True, True)
        assert "x & </script> y" in seen["text"]
        assert imread(tmp_path / f"{name}.png").shape[1] == (420 if name == "narrow" else 1280)
    assert looks["dark"]["paper"] != looks["light"]["paper"]


def test_the_browser_would_tell(faulty, tmp_path, in_browser):
    """What the test above must not see, it can see."""
    page = tmp_path / "r.html"
    write_report(faulty, page)
    script = "new Image().src = 'r.html'; console.warn('look'); undefinedThing();"
    broken = f"<script>{script}</script><div style='width:3000px'>.</div>"
    page.write_text(page.read_text().replace("</body>", f"{broken}</body>"))
    for seen in in_browser(page):
        assert seen["said"] == ["warning: look", "error: undefinedThing is not defined"]
        assert len(seen["asked"]) == 2
        assert seen["wide"]
