# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitor: verdicts on the live data, published and logged."""

import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from deepc_msgs.msg import Change, MonitorReport, PlantInfo
from deepc_msgs.msg import Indicator as IndicatorMsg
from deepc_msgs.msg import Verdict as VerdictMsg

from ..bags.convert import to_cdr
from ..bags.errors import BagError
from ..bags.writer import BagWriter
from ..monitors import Finding, Prior, Verdict
from ..monitors.live import ENTER, PROPERTIES, Job, LiveMonitor, LiveReport
from ..ros import topics
from ..ros.convert import nanoseconds, refusal
from ..ros.deferred import Deferred
from ..ros.diagnostics import OK, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.live import LiveParameters
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node
from ..ros.wire import Reading

_SHARE = 0.25  # of the period, after which a loop in the same process has been closed
PARAMETERS_CHANGED = "parameters"
PARAMETERS = (
    Param("window", 300, "outputs in the window of the tests", "samples", low=1, high=1_000_000, live=True),
    Param("period", 10, "outputs between two reports", "samples", low=1, high=1_000_000, live=True),
    Param(
        "form",
        "absolute",
        "what is analysed: values, or their changes (plants around an operating point that nobody knows)",
        choices=("absolute", "incremental"),
    ),
    Param("L", 0, "block rows of the tests; 0 = chosen by the analysis", low=0, high=1000, live=True),
    Param(
        "noise",
        [0.0],
        "standard deviation of the output noise, one for all or shape (p,)",
        "output units",
        low=0.0,
        live=True,
    ),
    Param("estimate_noise", False, "estimate the noise from the data instead; verdicts then say so", live=True),
    Param(
        "enter", ENTER, "margin from which a property counts as proved; it is kept down to 0", "dB", low=0.0, live=True
    ),
    Param("indicator", True, "publish the margins at the modes of the data with every sample (0.6 to 1 ms each)"),
    Param("worker", False, "analyse in a thread, off the way of the samples; reports then come when they are done"),
    Param(
        "q",
        0,
        "prior: upper bound of the slow order; 0 = what the plant says. One too small is noticed always in exact data, "
        "in 94 % of plants at 60 dB",
        low=0,
    ),
    Param(
        "s",
        0,
        "prior: upper bound of the nilpotency index; 0 = what the plant says. One too small is noticed as for q (96 %)",
        low=0,
    ),
    Param("log", "", "folder of an MCAP log of the reports; empty = none"),
    Param("readers", 0, "lockstep only: subscribers of the report to wait for before publishing", low=0),
)


def make_live(parameters: Mapping[str, Any], info: PlantInfo) -> LiveMonitor:
    """The window of one run on a plant; the node and a replay make the same one."""
    given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
    p = len(info.output_names)
    D = np.reshape(info.d, (p, len(info.input_names))) if info.d_known else None
    prior = Prior(q=given["q"] or int(info.q), s=given["s"] or max(int(info.s), 1), n=int(info.n), D=D)
    return LiveMonitor(prior, form=given["form"], lockstep=bool(info.lockstep), **_settings(given, p))


def change_live(live: LiveMonitor, k: int, parameters: Mapping[str, Any], info: PlantInfo) -> None:
    """Brings parameters that may change while running into force from outputs k on; the node and a replay alike."""
    given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
    live.change(k, **_settings(given, len(info.output_names)))


def _settings(given: Mapping[str, Any], p: int) -> dict[str, Any]:
    """The parameters as settings of a `LiveMonitor`.

    Raises:
        ValueError: if the noise is given for another number of outputs.
    """
    noise = given["noise"]
    if len(noise) not in (1, p):
        raise ValueError(f"noise has {len(noise)} entries, the plant {p} outputs: give one for all or one for each")
    level = None if given["estimate_noise"] else noise[0] if len(noise) == 1 else noise
    same = {name: given[name] for name in ("window", "period", "enter")}
    return same | {"noise": level, "L": given["L"] or None}


class MonitorNode(ManagedNode):
    """Pairs inputs and outputs, tests the newest stretch every few samples, publishes and logs the report."""

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("monitor", **kwargs)
        self.refused = 0
        self._log: BagWriter | None = None

    @classmethod
    def check(cls, parameters: Mapping[str, Any], info: PlantInfo) -> None:
        """Whether the prior can be that of the plant."""
        try:
            make_live(parameters, info)
        except ValueError as error:
            raise ConfigError(f"monitor: {error}") from None

    def configure(self) -> None:
        """Opens the log and makes the topics that do not depend on the plant."""
        self._live: LiveMonitor | None = None
        self._after: Deferred | None = None
        self._report = self.advertise(topics.REPORT, readers=self.p["readers"])
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        self._indicator = self.advertise(topics.INDICATOR) if self.p["indicator"] else None
        self._record = self.advertise(topics.MONITOR_CHANGES)
        self._changed = LiveParameters(self, self._check_changes)
        self._worker = ThreadPoolExecutor(1, "monitor") if self.p["worker"] else None
        self._busy: Future[None] | None = None
        if self._worker is not None:
            self.resources.callback(self._worker.shutdown)
        if self.p["log"]:
            self._log = BagWriter(Path(self.p["log"]))
            self._log_topic = self.resolve_topic_name(topics.REPORT.name)
            self._log.add_topic(self._log_topic, topics.REPORT.type_name)
            self.resources.callback(self._close_log)
        self.subscribe(topics.PLANT_INFO, self._on_plant)

    def _close_log(self) -> None:
        if self._log is not None:
            self._log.close()
            self._log = None

    def _on_plant(self, info: PlantInfo) -> None:
        """A plant or a new epoch of it: a fresh window."""
        fresh, self._info = self._live is None, info
        self._stamps: deque[tuple[int, Any]] = deque(maxlen=1000)
        self._verdicts: dict[str, Verdict] = {}
        self._follows = 0  # whom the plant follows, as far as it has said
        self._live = make_live(self.p, info)
        if fresh:
            for topic, take in ((topics.INPUTS, self._on_inputs), (topics.OUTPUTS, self._on_outputs)):
                self.subscribe(topic, take if info.lockstep else self._after_the_loop(take), lockstep=info.lockstep)

    def _after_the_loop(self, take: Callable[[Reading], None]) -> Callable[[Reading], None]:
        """In real time a controller and a plant in the same process go first; the order of the samples stays."""
        if self._after is None:
            self._after = Deferred(self, _SHARE * self._info.sample_time / (self._info.speed or 1.0))
        after = self._after
        return lambda msg: after(lambda: take(msg))

    def _check_changes(self, parameters: dict[str, Any]) -> None:
        if self._live is not None:
            make_live(parameters, self._info)

    def _apply_changes(self, k: int) -> None:
        """Brings what was asked for into force from outputs k on, and leaves a note in the bag."""
        wanted = self._changed.take()
        if not wanted:
            return
        assert self._live is not None
        self.p |= wanted
        change_live(self._live, k, self.p, self._info)
        note = Change(epoch=self._info.epoch, k=k, name=PARAMETERS_CHANGED, value=json.dumps(wanted))
        note.header.stamp = self.get_clock().now().to_msg()
        note.header.frame_id = self._info.name
        self._record.publish(note)
        self.get_logger().info(f"from outputs {k} on: " + ", ".join(f"{name} = {wanted[name]}" for name in wanted))

    def _on_inputs(self, msg: Reading) -> None:
        if self._follows and msg.sender not in (0, self._follows):
            return  # of a controller that the plant does not follow
        if self._accepts(msg, len(self._info.input_names)):
            assert self._live is not None
            self._analyse(self._live.input(int(msg.k), msg.values))

    def _on_outputs(self, msg: Reading) -> None:
        assert self._live is not None
        if self._accepts(msg, len(self._info.output_names), self._live.newest):
            self._follows = int(msg.sender) or self._follows
            self._apply_changes(int(msg.k))
            self._stamps.append((int(msg.k), msg.header.stamp))
            self._analyse(self._live.output(int(msg.k), msg.values, int(msg.held)))
            if self._indicator is not None:
                self._indicate(msg)

    def _accepts(self, msg: Reading, size: int, newest: int = -1) -> bool:
        reason = refusal(msg, size)
        if not reason and msg.epoch != self._info.epoch:
            reason = f"epoch {msg.epoch} instead of {self._info.epoch}"
        if not reason and msg.k <= newest:
            reason = f"again or too late, {newest} were the last"
        if reason:
            self.refused += 1
            self.get_logger().warning(f"sample {msg.k} refused: {reason}", throttle_duration_sec=5.0)
        return not reason

    def _analyse(self, jobs: list[Job]) -> None:
        live = self._live
        assert live is not None
        for job in jobs:
            stamp = dict(self._stamps)[job.k]
            if self._worker is None:
                self._publish(live.analyse(job), stamp)
            elif self._busy is None or self._busy.done():  # one at a time; the next period brings newer data
                if self._busy is not None:
                    self._busy.result()  # raises what went wrong in the thread
                self._busy = self._worker.submit(lambda job=job, at=stamp: self._publish(live.analyse(job), at))

    def _publish(self, live: LiveReport, stamp: Time) -> None:
        msg = self._message(live, stamp)
        self._report.publish(msg)
        if self._log is not None:
            at = nanoseconds(stamp)
            try:
                self._log.write(self._log_topic, to_cdr(msg), at, at)
            except BagError as error:  # a full disk ends the log, not the monitor
                self.get_logger().error(f"no log of verdicts any more: {error}")
                self._close_log()
        self._tell(live)

    def _indicate(self, outputs: Reading) -> None:
        assert self._live is not None
        started = time.process_time()
        seen = self._live.indicator()
        if seen is None:
            return
        msg = IndicatorMsg(header=outputs.header, epoch=outputs.epoch, k=outputs.k)
        msg.r_controllability, msg.r_observability = float(seen.controllability), float(seen.observability)
        msg.lambda_star_re, msg.lambda_star_im = float(seen.lambda_star.real), float(seen.lambda_star.imag)
        msg.compute_time = time.process_time() - started
        self._indicator.publish(msg)

    def _message(self, live: LiveReport, stamp: Time) -> MonitorReport:
        msg = report_message(live)
        msg.epoch = self._info.epoch
        msg.header.frame_id = self._info.name
        msg.header.stamp = stamp
        now = self.get_clock().now().nanoseconds
        msg.data_age = max(0.0, (now - nanoseconds(msg.header.stamp)) / 1e9)
        return msg

    def _tell(self, live: LiveReport) -> None:
        """Verdict changes in the log; verdicts, reasons and what they rest on in the diagnostics."""
        report = live.report
        verdicts = {name: getattr(report, name).verdict for name in PROPERTIES}
        text = ", ".join(f"{name} {verdict.name}" for name, verdict in verdicts.items())
        if verdicts != self._verdicts:
            self._verdicts = verdicts
            self.get_logger().info(f"from outputs {live.k} on: {text}")
        level = WARN if Verdict.PRIOR_VIOLATED in verdicts.values() else OK
        if self._diagnostics.due(level, text):
            facts = {
                "k": live.k,
                "samples": live.samples,
                "rank": f"{report.rank} of {report.rank_need}",
                "excitation": f"{report.excitation_order} of {report.excitation_need}",
                "noise": report.noise_source,
                "refused": self.refused,
            }
            reasons = {name: getattr(report, name).reason for name in PROPERTIES}
            self._diagnostics.report(level, text, reasons | facts)


def verdict_message(finding: Finding) -> VerdictMsg:
    """A finding as a message."""
    return VerdictMsg(
        verdict=int(finding.verdict),
        reason=finding.reason,
        theorem=finding.theorem,
        rank=int(finding.rank),
        required=int(finding.required),
        margin=float(finding.margin),
        noise_bound=float(finding.noise_bound),
        lambda_star_re=float(finding.lambda_star.real),
        lambda_star_im=float(finding.lambda_star.imag),
        gap=float(finding.gap),
    )


def report_message(live: LiveReport) -> MonitorReport:
    """A report as a message, without its header."""
    report = live.report
    msg = MonitorReport(k=live.k, compute_time=live.compute_time, data_age=math.nan)
    for name in PROPERTIES:
        setattr(msg, name, verdict_message(getattr(report, name)))
    msg.excitation, msg.excitation_need = int(report.excitation_order), int(report.excitation_need)
    msg.rank, msg.rank_need = int(report.rank), int(report.rank_need)
    msg.window, msg.depth = live.samples, int(report.L)
    estimate = report.estimate
    msg.estimated_q, msg.estimated_s, msg.estimated_lag = int(estimate.q), int(estimate.s), int(estimate.lag)
    msg.modes_re = [float(mode.lambda_.real) for mode in report.modes]
    msg.modes_im = [float(mode.lambda_.imag) for mode in report.modes]
    msg.modes_strength = [float(mode.strength) for mode in report.modes]
    return msg


def main() -> int:
    """Console script: runs the monitor node."""
    return run_node(MonitorNode)


if __name__ == "__main__":
    raise SystemExit(main())
