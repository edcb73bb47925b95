"""Calls of a client about the bench that are more than one request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labos.client._generated import GeneratedCalls
from labos.errors import BadInput


class BenchCalls(GeneratedCalls):
    """Workcells, access, samples."""

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
        return self._change_workcell(text, by, name=file, dry_run=dry_run, labware=labware, files=files)

    def leave(self, workcell: str, by: str, changed: Sequence[tuple[str, str]] = (), note: str = "") -> None:
        """Report that no person is in the workcell any more, and the present content of changed stations:
        ``empty``, labware by its id, or a labware type."""
        changes = [{"station": station, "what": what} for station, what in changed]
        self._end_workcell_access(workcell, by, note=note, changed=changes)

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
        where = {"labware": labware, "station": station}
        return self._register_sheet(_text_of(path), by, name=str(path), replace=replace, **where)


def _text_of(path: Path) -> str:
    """The text of a file. Raises BadInput."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"The file {path} cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise BadInput(f"The file {path} is not text.", remedy="Save it as CSV in UTF-8.") from None
