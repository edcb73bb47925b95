"""The parts that the service of a lab uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from labos.clock import Clock
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.http.lab_kernel import LabKernel
from labos.http.views import Supervised
from labos.ports import BlobStore, Bus
from labos.runtime.log_check import LogCheck
from labos.runtime.registry import Registry
from labos.services.log import Log


class Metrics(Protocol):
    """The metrics for Prometheus."""

    def text(self) -> str:
        """All metrics, in Prometheus' text format."""

    def targets(self, host: str) -> list[dict[str, Any]]:
        """The addresses of the metrics of the lab's processes, in the form of Prometheus' HTTP service
        discovery; ``host`` is the name under which the requesting program reaches the kernel."""


class Parts(Protocol):
    """The parts that the service uses."""

    @property
    def kernel(self) -> LabKernel: ...

    @property
    def bus(self) -> Bus: ...

    @property
    def registry(self) -> Registry: ...

    @property
    def store(self) -> Log: ...

    @property
    def blobs(self) -> BlobStore: ...

    @property
    def clock(self) -> Clock: ...

    @property
    def descriptions(self) -> Mapping[str, Description]: ...

    @property
    def broken_drivers(self) -> Mapping[str, str]: ...

    @property
    def log_check(self) -> LogCheck | None: ...

    @property
    def supervised(self) -> Supervised | None: ...

    @property
    def metrics(self) -> Metrics: ...

    @property
    def simulated(self) -> bool: ...

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None: ...
