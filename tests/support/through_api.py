"""Ask every lab of a test through an API process instead of the kernel's own HTTP interface.

``pytest -p tests.support.through_api tests/integration/http …``: a way to see what differs.
"""

from __future__ import annotations

from types import TracebackType

import msgspec

from labos.bootstrap import ApiSettings, LabThread
from tests.support.api_process import ApiThread

_enter, _exit = LabThread.__enter__, LabThread.__exit__


def enter(self: LabThread) -> LabThread:
    found = _enter(self)
    lab = msgspec.structs.replace(self.settings, http_port=None, bus=(self.runtime.bus_endpoint,))
    self._api = ApiThread(ApiSettings(lab)).__enter__()  # type: ignore[attr-defined]
    return found


def leave(
    self: LabThread,
    kind: type[BaseException] | None,
    error: BaseException | None,
    trace: TracebackType | None,
) -> None:
    self._api.__exit__()  # type: ignore[attr-defined]
    _exit(self, kind, error, trace)


LabThread.__enter__ = enter  # type: ignore[method-assign]
LabThread.__exit__ = leave  # type: ignore[method-assign]
LabThread.url = property(lambda self: self._api.url)  # type: ignore[assignment,method-assign]
