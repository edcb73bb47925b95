"""Traces of a lab's runs, sent to a receiver of OpenTelemetry if the settings name one."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from labos.runtime.kernel import Kernel
from labos.settings import Settings
from labos.telemetry.otlp import OtlpSender
from labos.telemetry.spans import SpanRecorder
from labos.version import VERSION


@asynccontextmanager
async def send_traces(settings: Settings, kernel: Kernel) -> AsyncIterator[OtlpSender | None]:
    """Send the traces of the block; traces that still wait at its end are sent then. Raises BadInput."""
    if not settings.trace_receiver:
        yield None
        return
    lab = kernel.state.lab
    sender = OtlpSender(
        settings.trace_receiver,
        {
            "service.name": "labos",
            "service.namespace": lab.name,
            "service.version": VERSION,
            "host.name": socket.gethostname(),
            "labos.lab": lab.id,
        },
    )
    recorder = SpanRecorder(lambda: kernel.state, kernel.clock.now_ns, sender.send)
    recorder.begin_with(kernel.state)
    kernel.listeners.append(recorder)
    try:
        yield sender
    finally:
        kernel.listeners.remove(recorder)
        await asyncio.to_thread(sender.close)
