"""Reads labware files, including those that a workcell file names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from labos.core.model import LabwareSpec, WellGrid
from labos.core.structs import make_from
from labos.errors import SpecError
from labos.spec.dialects import convert_labware, find_kind
from labos.spec.findings import FindingList, Remarks
from labos.spec.library import SUFFIXES, find_spec, list_specs
from labos.spec.models import ANY, LabwareFile, LabwareType
from labos.spec.source import MAX_BYTES, Path_, Source, parse, read
from labos.spec.validation import expect_valid, validate

LABWARE_SUFFIXES = (*SUFFIXES, ".json")
"""The suffixes of labware files in a folder: labware of Opentrons is JSON."""


def load_labware(source: Source | str | Path) -> dict[str, LabwareType]:
    """The labware types of a file, by name. Raises SpecError or SpecErrors."""
    source = source if isinstance(source, Source) else read(source)
    report = FindingList(source.file)
    form, _ = convert_labware(source, report)
    file = expect_valid(LabwareFile, form, report)
    return dict(file.labware)


def load_packaged_labware() -> dict[str, LabwareType]:
    """The labware types that are part of LabOS, by name."""
    found: dict[str, LabwareType] = {}
    for name in list_specs("labware"):
        found |= load_labware(find_spec("labware", name))
    return found


def make_spec(name: str, kind: LabwareType) -> LabwareSpec:
    """A type in the form that is stored with the workcell."""
    wells = None if kind.wells is None else make_from(WellGrid, kind.wells)
    size = kind.footprint.model_dump()
    return make_from(LabwareSpec, kind, name=name, wells=wells, grips=tuple(kind.grips), **size)


class OwnLabware(NamedTuple):
    """The types that a workcell's labware files define, and the digests of those files."""

    types: Mapping[str, LabwareType]
    digests: tuple[str, ...]


def read_own_labware(
    written: str | list[str], remarks: Remarks, sent: Mapping[str, bytes] | None = None
) -> OwnLabware:
    """The contents of the labware files and folders that a workcell file names. They are searched beside it,
    or among the files ``sent`` along with it. Faults go to the remarks, with their places in the labware
    files."""
    reader = _Reader(remarks, sent)
    for number, entry in enumerate([written] if isinstance(written, str) else written):
        reader.read(entry, ("labware",) if isinstance(written, str) else ("labware", number))
    return OwnLabware(reader.types, tuple(reader.digests.values()))


def read_labware_files(source: Source) -> dict[str, bytes]:
    """The contents of the labware files that a workcell file names, by the names under which it finds them. A
    client sends them along with its text. Files that cannot be read are left out; the compiler of the
    workcell reports them."""
    written = source.data.get("labware", [])
    entries = [written] if isinstance(written, str) else written if isinstance(written, list) else []
    found: dict[str, bytes] = {}
    for entry in entries:
        if isinstance(entry, str):
            found |= _read_contents(entry, source.folder)
    return found


class _Reader:
    """Reads one labware file after the other; a type that two of them define is a fault."""

    def __init__(self, remarks: Remarks, sent: Mapping[str, bytes] | None) -> None:
        self.remarks, self.sent, self.beside = remarks, sent, remarks.source
        self.types: dict[str, LabwareType] = {}
        self.digests: dict[str, str] = {}
        self._by: dict[str, str] = {}

    def read(self, entry: str, path: Path_) -> None:
        """Read a file or a folder that is named at a path of the workcell file."""
        if self.sent is not None:
            under = f"{entry.rstrip('/')}/"
            found = {
                name: text for name, text in self.sent.items() if name == entry or name.startswith(under)
            }
        else:
            found = _read_contents(entry, self.beside.folder)
        if not found:
            nowhere = self.sent is None and self.beside.folder is None
            why = "this workcell was not loaded from a folder" if nowhere else "none stands there"
            remedy = "Check its path, which is relative to the workcell file's own."
            if self.sent is not None:
                why, remedy = (
                    "none was sent along",
                    "Send it with the workcell, as `labos workcell apply` does.",
                )
            self.remarks.error(f"There is no labware file {entry!r}: {why}.", path, remedy)
        for name, text in found.items():
            file = str(Path(self.beside.file).parent / name)
            if file not in self.digests:  # it may be named twice: itself, and by its folder
                self._take(file, text)

    def _take(self, file: str, text: bytes) -> None:
        report = FindingList(file)
        try:
            source = parse(text, file)
            self.digests[file] = source.digest
            if (find_kind(source) or ("",))[0] != "labware":
                raise source.error("This is no labware file.", remedy="Write its types below `labware:`.")
            form, _ = convert_labware(source, report)
        except SpecError as error:
            self.remarks.report.keep_error(error)
            return
        content = validate(LabwareFile, form, report)
        for name, kind in content.labware.items() if content is not None else ():
            if name in self.types:
                message = f"The labware type {name!r} is defined in {self._by[name]} too."
                remedy = "Remove or rename one of them."
                Remarks(form, report).error(message, ("labware", name), remedy, key=True)
            if name == ANY:
                message = f"{name!r} cannot be a labware type's name: under `locations:` it means all others."
                Remarks(form, report).error(message, ("labware", name), "Rename it.", key=True)
            self.types.setdefault(name, kind)
            self._by.setdefault(name, file)
        self.remarks.report.take(report)


def _read_contents(entry: str, folder: Path | None) -> dict[str, bytes]:
    """The file, or the labware files of the folder, by the names under which the workcell finds them."""
    if folder is None and not Path(entry).is_absolute():
        return {}
    path = (folder or Path()) / entry
    found = {entry: path}
    contents: dict[str, bytes] = {}
    try:
        if path.is_dir():
            files = sorted(file for file in path.iterdir() if file.suffix in LABWARE_SUFFIXES)
            found = {f"{entry.rstrip('/')}/{file.name}": file for file in files}
        for name, file in found.items():
            with file.open("rb") as stream:
                contents[name] = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError):  # for example a name with a NUL character
        return {}
    return contents
