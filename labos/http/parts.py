"""The parts that the service of a lab uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from labos.clock import Clock
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.ports import BlobStore, Bus
from labos.runtime.followed import FollowedKernel
from labos.runtime.kernel import Kernel
from labos.runtime.log_check import LogCheck
from labos.runtime.registry import Registry
from labos.services.log import Log

if TYPE_CHECKING:
    from labos.http.recorded import RecordedKernel

LabKernel: TypeAlias = "Kernel | FollowedKernel | RecordedKernel"
"""The kernel as operations see it: in this process, in another one whose log is followed here, or as it was
before a repeated request."""


class Supervised(Protocol):
    @property
    def nodes(self) -> Mapping[str, Any]: ...


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
