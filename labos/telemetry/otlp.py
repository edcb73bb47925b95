"""Sends spans to an OpenTelemetry receiver (OTLP over HTTP), with OpenTelemetry's own library. A thread of
that library sends them from a bounded queue. If the receiver is slow or away, spans are lost, but the lab
does not wait. Headers and certificates are read by the library from its usual variables
(``OTEL_EXPORTER_OTLP_HEADERS``, ``OTEL_EXPORTER_OTLP_CERTIFICATE``).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import urlsplit

from labos.errors import BadInput
from labos.telemetry.spans import Span

QUEUE = 20_000
"""The largest number of spans that wait for the receiver; above it, new ones are lost."""

BATCH = 512
SEND_EVERY_S = 1.0
TIMEOUT_S = 5.0
CLOSE_S = 3.0
PATH = "/v1/traces"


def check_receiver(url: str) -> None:
    """Raises BadInput if this is not an address such as ``http://127.0.0.1:4318``, or if the package's extra
    is missing."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise BadInput(
            f"{url!r} is not an address of a receiver of traces.",
            remedy="Give it as http://HOST:4318 (--otlp, LABOS_OTLP).",
        )
    try:
        import opentelemetry.exporter.otlp.proto.http.trace_exporter
        import opentelemetry.sdk.trace.export  # noqa: F401
    except ImportError as error:
        raise BadInput(
            "Traces need the package's extra otel.", remedy='Run: pip install "labos-sdl[otel]"'
        ) from error


class OtlpSender:
    """``counts`` are the numbers of spans that were offered and that the receiver has accepted."""

    def __init__(self, url: str, attributes: Mapping[str, str]) -> None:
        """``url`` is the receiver, ``attributes`` name the lab. Raises BadInput as ``check_receiver``."""
        check_receiver(url)
        from opentelemetry import trace
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import ReadableSpan
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
        from opentelemetry.sdk.util.instrumentation import InstrumentationScope

        # For a receiver that is away, the library would write a traceback each second.
        logging.getLogger("opentelemetry").setLevel(logging.CRITICAL)
        self.offered = self.taken = 0
        self._trace, self._span, self._resource = trace, ReadableSpan, Resource.create(dict(attributes))
        self._scope = InstrumentationScope("labos")
        endpoint = url.rstrip("/").removesuffix(PATH) + PATH
        sender = self

        class Counted(OTLPSpanExporter):
            """Counts the spans which the receiver has accepted."""

            def export(self, spans: Sequence[Any]) -> Any:
                result = super().export(spans)
                if result.name == "SUCCESS":
                    sender.taken += len(spans)
                return result

        self._processor = BatchSpanProcessor(
            Counted(endpoint=endpoint, timeout=TIMEOUT_S),
            max_queue_size=QUEUE,
            max_export_batch_size=BATCH,
            schedule_delay_millis=SEND_EVERY_S * 1000,
        )

    def send(self, span: Span) -> None:
        """Put a span into the queue."""
        self.offered += 1
        trace = self._trace
        flags = trace.TraceFlags(trace.TraceFlags.SAMPLED)

        def context(id_: int) -> Any:
            return trace.SpanContext(span.trace, id_, is_remote=False, trace_flags=flags)

        code = trace.StatusCode.ERROR if span.error else trace.StatusCode.UNSET
        self._processor.on_end(
            self._span(
                span.name,
                context=context(span.id),
                parent=context(span.parent) if span.parent else None,
                resource=self._resource,
                attributes=span.attributes,
                kind=trace.SpanKind.INTERNAL,
                status=trace.Status(code, span.error or None),
                start_time=span.start,
                end_time=span.end,
                instrumentation_scope=self._scope,
            )
        )

    def close(self) -> None:
        """Send the waiting spans, and end. Waits at most CLOSE_S for the receiver."""
        ending = threading.Thread(target=self._processor.shutdown, name="otlp-end", daemon=True)
        ending.start()
        ending.join(CLOSE_S)
