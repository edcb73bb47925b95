"""The metrics of a running lab: their sources and their addresses."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

from labos.bootstrap._unattended import UnattendedMeter
from labos.core.ids import local, workcell_of
from labos.errors import StoreError
from labos.store import find_database_file, measure_database
from labos.telemetry.kernel import KernelMetrics
from labos.telemetry.otlp import OtlpSender

if TYPE_CHECKING:
    from labos.bootstrap._runtime import LabRuntime
    from labos.runtime.writer import ThreadWriter


class LabMetrics:
    """Counts from its creation on. It decides nothing within a turn of the kernel: it listens, and computes
    metrics on request."""

    traces: OtlpSender | None = None
    """Sends traces of runs, if the settings name a receiver."""

    def __init__(self, lab: LabRuntime, writer: ThreadWriter) -> None:
        self._lab, kernel = lab, lab.kernel
        self._started_at = kernel.clock.now_ns() / 1e9
        self.all = KernelMetrics(lambda: kernel.state)
        self.all.of_events.begin_with(kernel.state)
        self.unattended = UnattendedMeter(lab.store, kernel.clock, lambda: kernel.durable)
        kernel.on_turn = self.all.of_events.turn_s.observe
        writer.on_commit = self.all.of_events.commit_s.observe
        kernel.listeners += [self.all.of_events, self.unattended]

    def text(self) -> str:
        """All metrics now, in Prometheus' text format."""
        kernel, found = self._lab.kernel, self.all
        began, now = kernel.clock.monotonic(), kernel.clock.now_ns()
        try:
            found.of_state.update(kernel.state, kernel.scheduler, now)
            self._read_process()
        except StoreError:  # the log is being read again
            found.of_state.clear()
            found.of_process.lose()
        found.of_events.update(now)
        meter = self.unattended.meter
        if meter is None:
            found.of_unattended_time.clear()
        else:
            found.of_unattended_time.update(*meter.read_totals(now), meter.causes)
        text = found.text()
        found.took_s.set(kernel.clock.monotonic() - began)
        return text

    def targets(self, host: str) -> list[dict[str, Any]]:
        """The addresses of the metrics of the lab's processes. ``host`` is the address at which the client
        reaches the kernel."""
        lab = self._lab
        state = lab.kernel.state
        name = state.lab.name
        kernel = {"targets": [host or f"{lab.settings.host}:{lab.http.port}"]}
        found: list[dict[str, Any]] = [{**kernel, "labels": {"lab": name, "process": "kernel"}}]
        for process, address in lab.desk.addresses.items():
            found.append({"targets": [address], "labels": {"lab": name, "process": "api", "api": process}})
        for module, address in lab.registry.metrics.items():
            if module not in state.modules.by_name:
                continue
            labels = {"workcell": workcell_of(module), "module": local(module)}
            found.append({"targets": [address], "labels": {"lab": name, "process": "node", **labels}})
        return found

    def _read_process(self) -> None:
        lab, kernel, database = self._lab, self._lab.kernel, self._lab.settings.database
        state, check, bus = kernel.state, lab.log_check, lab.bus.traffic
        disk = shutil.disk_usage(lab.settings.home)
        self.all.of_process.update(
            state.lab.id,
            state.lab.name,
            lab.simulated,
            pace=state.lab.pace,
            epoch=state.lab.epoch,
            started_at=self._started_at,
            suspended=bool(kernel.suspended),
            durable=kernel.durable,
            unwritten=max(state.position - kernel.durable, 0),
            checked=check.checked if check is not None else 0,
            damaged=bool(check.damage) if check is not None else False,
            # A server would have to be asked.
            store_bytes=measure_database(database) if find_database_file(database) is not None else None,
            disk_free=disk.free,
            disk_size=disk.total,
            queries=bus.queries,
            unanswered=bus.unanswered,
            published=bus.published,
            dropped=bus.dropped,
            left_out=lab.announcer.left_out,
            spans=self.traces.offered if self.traces is not None else 0,
            spans_sent=self.traces.taken if self.traces is not None else 0,
            faults=kernel.fault_count,
        )
