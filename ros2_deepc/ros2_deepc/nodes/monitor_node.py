# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitor: verdicts on the live data, published and logged."""

import math
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from deepc_msgs.msg import Indicator as IndicatorMsg
from deepc_msgs.msg import MonitorReport, PlantInfo, Sample
from deepc_msgs.msg import Verdict as VerdictMsg

from ..bags.convert import to_cdr
from ..bags.writer import BagWriter
from ..monitors import Finding, Prior, Report, Verdict
from ..monitors.live import PROPERTIES, Job, LiveMonitor, LiveReport
from ..ros import topics
from ..ros.convert import nanoseconds, refusal
from ..ros.diagnostics import OK, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node

PARAMETERS = (
    Param("window", 300, "outputs in the window of the tests", "samples", low=1, high=1_000_000),
    Param("period", 10, "outputs between two reports", "samples", low=1, high=1_000_000),
    Param("L", 0, "block rows of the tests; 0 = chosen by the analysis", low=0, high=1000),
    Param("noise", [0.0], "standard deviation of the output noise, one for all or shape (p,)", "output units", low=0.0),
    Param("estimate_noise", False, "estimate the noise from the data instead; verdicts then say so"),
    Param("indicator", True, "publish the margins at the modes of the data with every sample (0.6 to 1 ms each)"),
    Param("worker", False, "analyse in a thread, off the way of the samples; reports then come when they are done"),
    Param("q", 0, "prior: upper bound of the slow order; 0 = what the plant says", low=0),
    Param("s", 0, "prior: upper bound of the nilpotency index; 0 = what the plant says", low=0),
    Param("log", "", "folder of an MCAP log of the reports; empty = none"),
    Param("readers", 0, "lockstep only: subscribers of the report to wait for before publishing", low=0),
)


def make_live(parameters: Mapping[str, Any], info: PlantInfo) -> LiveMonitor:
    """The window of one run on a plant; the node and a replay make the same one."""
    given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
    D = np.reshape(info.d, (len(info.output_names), len(info.input_names))) if info.d_known else None
    prior = Prior(q=given["q"] or int(info.q), s=given["s"] or max(int(info.s), 1), n=int(info.n), D=D)
    return LiveMonitor(prior, window=given["window"], period=given["period"], noise=_noise(given), L=given["L"] or None)


def _noise(given: Mapping[str, Any]) -> Any:
    if given["estimate_noise"]:
        return None
    return given["noise"][0] if len(given["noise"]) == 1 else given["noise"]


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
        self._report = self.advertise(topics.REPORT, readers=self.p["readers"])
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        self._indicator = self.advertise(topics.INDICATOR) if self.p["indicator"] else None
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
        self._live = make_live(self.p, info)
        if fresh:
            self.subscribe(topics.INPUTS, self._on_inputs, lockstep=bool(info.lockstep))
            self.subscribe(topics.OUTPUTS, self._on_outputs, lockstep=bool(info.lockstep))

    def _on_inputs(self, msg: Sample) -> None:
        if self._accepts(msg, len(self._info.input_names)):
            assert self._live is not None
            self._analyse(self._live.input(int(msg.k), msg.values))

    def _on_outputs(self, msg: Sample) -> None:
        if self._accepts(msg, len(self._info.output_names)):
            assert self._live is not None
            self._stamps.append((int(msg.k), msg.header.stamp))
            self._analyse(self._live.output(int(msg.k), msg.values, int(msg.held)))
            if self._indicator is not None:
                self._indicate(msg)

    def _accepts(self, msg: Sample, size: int) -> bool:
        reason = refusal(msg, size)
        if not reason and msg.epoch != self._info.epoch:
            reason = f"epoch {msg.epoch} instead of {self._info.epoch}"
        if reason:
            self.refused += 1
            self.get_logger().warning(f"sample {msg.k} refused: {reason}", throttle_duration_sec=5.0)
        return not reason

    def _analyse(self, jobs: list[Job]) -> None:
        live = self._live
        assert live is not None
        for job in jobs:
            if self._worker is None:
                self._publish(live.analyse(job))
            elif self._busy is None or self._busy.done():  # one at a time; the next period brings newer data
                self._busy = self._worker.submit(lambda job=job: self._publish(live.analyse(job)))

    def _publish(self, live: LiveReport) -> None:
        msg = self._message(live)
        self._report.publish(msg)
        if self._log is not None:
            stamp = nanoseconds(msg.header.stamp)
            self._log.write(self._log_topic, to_cdr(msg), stamp, stamp)
        self._note_changes(live.report)

    def _indicate(self, outputs: Sample) -> None:
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

    def _message(self, live: LiveReport) -> MonitorReport:
        msg = report_message(live)
        msg.epoch = self._info.epoch
        msg.header.frame_id = self._info.name
        msg.header.stamp = dict(self._stamps)[live.k]
        now = self.get_clock().now().nanoseconds
        msg.data_age = max(0.0, (now - nanoseconds(msg.header.stamp)) / 1e9)
        return msg

    def _note_changes(self, report: Report) -> None:
        verdicts = {name: getattr(report, name).verdict for name in PROPERTIES}
        if verdicts == self._verdicts:
            return
        self._verdicts = verdicts
        text = ", ".join(f"{name} {verdict.name}" for name, verdict in verdicts.items())
        self.get_logger().info(text)
        level = WARN if Verdict.PRIOR_VIOLATED in verdicts.values() else OK
        self._diagnostics.report(level, text, {name: getattr(report, name).reason for name in PROPERTIES})


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
