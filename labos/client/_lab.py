"""A lab, over HTTP."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labos.client._answers import LabUnreachable as LabUnreachable
from labos.client._answers import answer_of
from labos.client._calls import API as API
from labos.client._calls import LONG_POLL_S, in_path
from labos.client._files import campaign_text, workflow_text
from labos.client._runs import RunCalls
from labos.core.canonical import digest
from labos.errors import BadInput, LogDamaged

if TYPE_CHECKING:
    from PIL.Image import Image

    from labos.services.results import Readings

PAGE = 500
"""The number of proposals in an answer."""

CHECKED_S = 900.0
"""How long the lab may take to check all rows of a campaign."""

_SHA256 = re.compile("[0-9a-f]{64}")


class LabClient(RunCalls):
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
        return self._list_nodes(modules, check=False)

    def check_nodes(self, modules: Sequence[str] = ()) -> list[dict[str, Any]]:
        """As ``ask_nodes``; each that answers also has ``checked``: its ``driver`` with ``version``, its
        ``labos`` and ``protocol``, whether it is ``simulated``, the ``unit`` (serial number) to which it is
        pinned, and its device's observations (``sees``), or the reason why there are none (``sees_nothing``).
        Nothing moves."""
        return self._list_nodes(modules, check=True)

    def _list_nodes(self, modules: Sequence[str], *, check: bool) -> list[dict[str, Any]]:
        return list(self._get("/nodes", {"module": modules, "check": check})["modules"])

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
            asked = {"after": after, "wait": usual_s if wait_s is None else wait_s, **filters}
            page = self._get("/events", asked)
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
        return self._fetch("/events", asked)

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
        asked = locals() | {
            "closing": None if closing is None else workflow_text(closing, payload),
            "payload": payload or {},
        }
        answer = self._post("/experiments", asked, once=True)
        self.warnings = []
        self._note_approval(answer)
        return str(answer["experiment"])

    # -- the bench ---------------------------------------------------------------------------

    def apply_workcell(
        self,
        text: str,
        file: str,
        by: str,
        *,
        dry_run: bool = False,
        labware: Mapping[str, bytes] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> dict[str, Any]:
        """Change a workcell to the content of its file. With ``dry_run``, only return the changes and the
        obstacles. ``labware`` contains the labware files that the workcell file names, ``files`` the other
        files, such as tables of drivers: the lab reads no other files."""
        asked = {"text": text, "by": by, "name": file, "dry_run": dry_run}
        sent = {"labware": labware or {}, "files": files or {}}
        return self._post("/workcells", {**asked, **sent}, repeat=True)

    def leave(self, workcell: str, by: str, changed: Sequence[tuple[str, str]] = (), note: str = "") -> None:
        """Report that no person is in the workcell any more, and the present content of changed stations:
        ``empty``, labware by its id, or a labware type."""
        changes = [{"station": station, "what": what} for station, what in changed]
        asked = {"workcell": workcell, "by": by, "note": note, "changed": changes}
        self._post("/workcells/{workcell}/access/end", asked)

    def load_samples(
        self,
        sheet: str | Path,
        by: str,
        *,
        labware: str = "",
        station: str = "",
        replace: bool = False,
    ) -> dict[str, int]:
        """Register the samples in the wells of plates, from a CSV file; ``labware`` or ``station`` names the
        plate if the sheet does not. Returns the number of samples in each plate."""
        path = Path(sheet)
        asked = {"text": _text_of(path), "by": by, "name": str(path), "replace": replace}
        where = {"labware": labware, "station": station}
        return dict(self._post("/samples", {**asked, **where}, repeat=True)["plates"])

    # -- campaigns and approvals -------------------------------------------------------------

    def submit_campaign(
        self,
        campaign: str | Path | Mapping[str, Any],
        *,
        user: str,
        dry_run: bool = False,
        request: str = "",
        propose: bool = False,
    ) -> dict[str, Any]:
        """Check a campaign file with its table and workflow, row by row, and submit it. Returns its id as
        ``campaign`` (empty if only checked, with ``dry_run``) and its needs as ``estimate``. The same
        ``request`` twice is one campaign. With ``propose`` it waits for an approval; ``approval`` of the
        answer is the reason. Instead of a file, give a mapping with its ``text`` and its ``workflow``."""
        options = {"user": user, "dry_run": dry_run, "request": request, "propose": propose}
        asked = {**campaign_text(campaign), **options}
        return self._post("/campaigns", asked, once=True, timeout_s=CHECKED_S)

    def forecast_campaign(self, campaign: str | Path | Mapping[str, Any], *, user: str) -> dict[str, Any]:
        """Check a campaign file as ``submit_campaign`` does, and submit nothing. Returns its needs as
        ``estimate``, and its expected times and the delays of others as ``forecast``."""
        asked = {**campaign_text(campaign), "user": user}
        return self._post("/campaigns/forecast", asked, repeat=True, timeout_s=CHECKED_S)

    def amend_campaign(self, campaign: str, by: str, **changes: Any) -> dict[str, Any]:
        """Change the terms of a campaign. Returns the terms in force: a change that waits for an approval
        (see ``approval`` of the client) is not among them. Changes: ``priority``, ``deadline``, ``runs``,
        ``lab_time_s``, ``consumables``, ``tags``, ``until``, ``stop_after``."""
        found = self._amend_campaign(campaign, by, **changes)
        self.approval = str(found.get("approval", ""))
        return dict(found["terms"])

    def clone_campaign(self, campaign: str, by: str, *, request: str = "", **changes: Any) -> dict[str, Any]:
        """Submit a copy of a campaign, also of one that has ended; returns as ``submit_campaign``. Changes:
        ``name``, ``visibility``, ``dry_run``, ``propose``, and those of ``amend_campaign``."""
        return self._clone_a_campaign(campaign, by, request=request, **changes)

    def approvals(self) -> list[dict[str, Any]]:
        """The submissions that wait for an approval, the oldest first: ``subject``, ``digest``, ``why`` and
        further fields."""
        found: list[dict[str, Any]] = []
        more = True
        while more:
            after = found[-1]["subject"] if found else ""
            page = self._get("/approvals", {"after": after, "limit": PAGE})
            found += page["approvals"]
            more = page["more"] and bool(page["approvals"])
        return found


def _show_file(file: str | Mapping[str, Any]) -> str:
    return str(file.get("file", file.get("sha256", ""))) if isinstance(file, Mapping) else file


def rows_of(text: str) -> list[dict[str, Any]]:
    """The rows of a CSV file by the names in its first line; numbers are converted. Raises ValueError for a
    text without such a line, and for a row that has more values than it names."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    comma = max(",;\t", key=first.count)
    lines = csv.reader(io.StringIO(text.lstrip("\r\n")), delimiter=comma)
    names = [name.strip() for name in next(lines, [])]
    if not any(names) or len(set(names)) < len(names):
        raise ValueError("its first line does not name each column once")
    rows = []
    for number, values in enumerate(lines, 2):
        if not any(value.strip() for value in values):
            continue
        if len(values) > len(names):
            raise ValueError(f"line {number} has {len(values)} values for {len(names)} columns")
        rows.append(dict(zip(names, [_value(value.strip(), comma) for value in values], strict=False)))
    return rows


def _value(text: str, comma: str) -> Any:
    """A comma that does not separate columns may be a decimal separator."""
    for convert in (int, float) if "_" not in text else ():
        try:
            return convert(text.replace(",", ".") if comma != "," else text)
        except ValueError:
            continue
    return text


def _text_of(path: Path) -> str:
    """The text of a file. Raises BadInput."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"The file {path} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise BadInput(f"The file {path} is not text.", remedy="Save it as CSV in UTF-8.") from None
