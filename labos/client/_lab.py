"""A lab, over HTTP."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labos.client._answers import LabUnreachable as LabUnreachable
from labos.client._answers import answer_of
from labos.client._bench import BenchCalls
from labos.client._calls import API as API
from labos.client._calls import LONG_POLL_S, in_path
from labos.client._campaigns import CampaignCalls
from labos.client._files import workflow_text
from labos.client._runs import RunCalls
from labos.client._tables import rows_of
from labos.core.canonical import digest
from labos.errors import BadInput, LogDamaged

if TYPE_CHECKING:
    from PIL.Image import Image

    from labos.services.results import Readings

_SHA256 = re.compile("[0-9a-f]{64}")


class LabClient(RunCalls, BenchCalls, CampaignCalls):
    """A lab, over HTTP. Give its ``url``, or its ``home`` folder on this machine.

    Requests are repeated while the lab does not answer, for ``patience_s`` in all, for example during a
    restart of its kernel. Submissions have an idempotency key, so that nothing is done twice. Every call
    raises the LabosError that the lab reports, and LabUnreachable if no lab answers.

    In a lab with users it sends a ``token``: the given one, else that of LABOS_TOKEN or of the file that
    LABOS_TOKEN_FILE names, else the one that `labos login` has stored. A service account may act on
    ``behalf`` of a person.
    """

    # -- queries -----------------------------------------------------------------------------

    def ask_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, str]]:
        """The present answers of the nodes of these modules, or of all: ``name``, ``answer`` (IDLE, BUSY,
        ERROR, silent, frozen, refused, out, absent) and ``why``."""
        return self._list_nodes(module=modules)

    def check_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, Any]]:
        """As ``ask_nodes``; each that answers also has ``checked``: its ``driver`` with ``version``, its
        ``labos`` and ``protocol``, whether it is ``simulated``, the ``unit`` (serial number) to which it is
        pinned, and its device's observations (``sees``), or the reason why there are none (``sees_nothing``).
        Nothing moves."""
        return self._list_nodes(module=modules, check=True)

    def file(self, file: str | Mapping[str, Any], *, first: int = 0, last: int | None = None) -> bytes:
        """The content of a file that a step has returned: for example ``result["picture"]``, or its SHA-256.
        With ``first`` and ``last``, the bytes from ``first`` to ``last``, both counted from 0 and included.
        Raises NotFound, BadInput, LogDamaged if the whole content does not have its SHA-256."""
        name = str(file.get("sha256", "") if isinstance(file, Mapping) else file)
        if not _SHA256.fullmatch(name):
            raise BadInput(
                f"{name[:80]!r} is not a file.",
                remedy="Give the value from a result, or 64 hexadecimal digits.",
            )
        part = bool(first) or last is not None
        headers = {"range": f"bytes={first}-{'' if last is None else last}"} if part else {}
        response = self._request("GET", f"/files/{in_path(name)}", repeat=True, headers=headers)
        if response.status_code == 416:
            raise BadInput(f"The file {name} has no bytes {first} to {'its end' if last is None else last}.")
        if response.status_code >= 400:
            answer_of(response.status_code, response.content)
        if not part and digest(response.content) != name:
            raise LogDamaged(f"The lab sent another content for the file {name}.", position=0)
        return bytes(response.content)

    def image(self, file: str | Mapping[str, Any]) -> Image:
        """An image that a step has returned (``result.result("Take picture")``), as an image of Pillow.
        Raises as ``file``, and BadInput for a file that is not an image."""
        from PIL import Image, UnidentifiedImageError

        content = self.file(file)
        try:
            image = Image.open(io.BytesIO(content))
            image.load()
        except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
            raise BadInput(f"{_show_file(file)} is not a picture ({error}).", remedy="Use file(…).") from None
        return image

    def table(self, file: str | Mapping[str, Any]) -> list[dict[str, Any]]:
        """The rows of a table that a step has returned (CSV, separated by comma, semicolon or tab, with the
        names of the columns in the first line); numbers are converted. Raises as ``file``, and BadInput for a
        file that is not such a table."""
        try:
            return rows_of(self.file(file).decode("utf-8-sig"))
        except (UnicodeDecodeError, ValueError) as error:
            raise BadInput(f"{_show_file(file)} is not a table ({error}).", remedy="Use file(…).") from None

    def events(
        self, after: int = 0, *, follow: bool = False, wait_s: float | None = None, **filters: Any
    ) -> Iterator[dict[str, Any]]:
        """Committed events in order; with ``follow``, without end. ``wait_s`` is how long each request waits
        for an event (default: 0, with ``follow`` ``LONG_POLL_S``). Filters: type, stream, correlation, actor,
        mentions."""
        for page in self._iterate_pages_of_events(after, follow=follow, wait_s=wait_s, **filters):
            yield from page

    def _iterate_pages_of_events(
        self, after: int, *, follow: bool, wait_s: float | None, **filters: Any
    ) -> Iterator[list[dict[str, Any]]]:
        usual_s = LONG_POLL_S if follow else 0.0
        while True:
            page = self._get("/events", after=after, wait=usual_s if wait_s is None else wait_s, **filters)
            yield page["events"]
            if page["position"] <= after and not follow:
                return
            after = max(page["position"], after)

    def readings(self, run: str) -> Readings:
        """The values that a run measured, well by well, each with the sample that was in its well; as a table
        by ``to_frame()`` (pandas) and ``to_csv()``. Raises NotFound."""
        from labos.client._log import LabFiles, LabLog
        from labos.services.results import read_readings

        return read_readings(LabLog(self), LabFiles(self), run)

    def page_of_events(self, asked: Mapping[str, Any]) -> bytes:
        """A page of events as the lab sends it, with the position at which the next page begins."""
        return self._fetch("/events", **asked)

    # -- experiments -------------------------------------------------------------------------

    def start_experiment(
        self,
        name: str,
        user: str,
        *,
        closing: str | Path | None = None,
        payload: Mapping[str, Any] | None = None,
        workcell: str = "",
        priority: int = 0,
        parking: Sequence[str] = (),
        propose: bool = False,
        request: str = "",
    ) -> str:
        """Prefer ``Experiment``. After 30 s without a heartbeat, LabOS asks a person about the experiment.
        The same ``request`` twice is one experiment."""
        answer = self._start_experiment(
            name,
            user,
            closing=None if closing is None else workflow_text(closing, payload),
            payload=payload,
            workcell=workcell,
            priority=priority,
            parking=parking,
            propose=propose,
            request=request,
        )
        self.warnings = []
        self._note_approval(answer)
        return str(answer["experiment"])


def _show_file(file: str | Mapping[str, Any]) -> str:
    return str(file.get("file", file.get("sha256", ""))) if isinstance(file, Mapping) else file
