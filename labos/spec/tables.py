"""Drivers with a configuration table: for example, the table of a PLC determines the actions of its module.

The table is below the driver's key in a module's ``config``, or in a separate file that is named there. It is
read together with the workcell, so that a workflow can be planned while the device is not there. It is stored
with the lab.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from labos.core.canonical import digest
from labos.core.counts import Counter
from labos.core.model import Description
from labos.errors import BadInput, SpecError
from labos.spec.findings import FindingList, Remarks
from labos.spec.source import MAX_BYTES, Path_, Source, SourceList, SourceMapping, make_plain, parse, read
from labos.spec.validation import validate


class Flaw(NamedTuple):
    """A fault at a path of a table in which each single part is valid."""

    path: Path_
    message: str
    remedy: str


class DriverTable(NamedTuple):
    """The configuration table of a driver. ``key`` is its key in ``config``. ``flaws`` finds parts that do
    not fit together. ``describe`` returns the module's description (only for a table without faults)."""

    key: str
    model: type[BaseModel]
    flaws: Callable[[Any], Iterable[Flaw]]
    describe: Callable[[Any], Description]


class Descriptions(dict[str, Description]):
    """The descriptions of all drivers. ``tables`` has the drivers with a configuration table. ``counters``
    has functions that read from a file how much of a resource an action uses up, by resource. ``broken`` has
    the reasons why other installed drivers cannot be used."""

    def __init__(
        self,
        known: Mapping[str, Description],
        tables: Mapping[str, DriverTable],
        counters: Mapping[str, Mapping[str, Counter]] | None = None,
        broken: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(known)
        self.tables = dict(tables)
        self.counters = dict(counters or {})
        self.broken = dict(broken or {})


def find_table(driver: str, descriptions: Mapping[str, Description]) -> DriverTable | None:
    """The configuration table of a driver, if it has one."""
    return descriptions.tables.get(driver) if isinstance(descriptions, Descriptions) else None


def find_counter(driver: str, resource: str, descriptions: Mapping[str, Description]) -> Counter | None:
    """The function that counts the amount of a resource that a driver's actions use up, if there is one."""
    if not isinstance(descriptions, Descriptions):
        return None
    return descriptions.counters.get(driver, {}).get(resource)


def explain_broken(driver: str, descriptions: Mapping[str, Description]) -> str:
    """Why an installed driver cannot be used; empty if no reason is known."""
    return descriptions.broken.get(driver, "") if isinstance(descriptions, Descriptions) else ""


def check_table(kind: DriverTable, source: Source, report: FindingList) -> Any:
    """A table in the form of the driver's model; None, with errors in the report, if it does not fit."""
    table = validate(kind.model, source, report)
    if table is None:
        return None
    before, remarks = report.errors, Remarks(source, report)
    for flaw in kind.flaws(table):
        remarks.error(flaw.message, flaw.path, flaw.remedy)
    return table if report.errors == before else None


def read_source(written: Any, beside: Source, sent: Mapping[str, bytes] | None = None) -> Source:
    """The source of a table: the workcell file itself, or a file that it names. If files were ``sent`` along
    with the workcell file, the table is one of these, and no disk is read. Raises SpecError."""
    if isinstance(written, SourceMapping):
        return Source(beside.file, written, beside.digest, beside.folder)
    if not isinstance(written, str) or not written:
        raise SpecError("It is neither a table nor the name of a file.", remedy="Write either of them.")
    if sent is not None:
        if written not in sent:
            raise SpecError(
                f"The file {written!r} was not sent along.",
                remedy="Send it with the workcell, as `labos workcell apply` does, or write the table itself "
                "here.",
            )
        return parse(sent[written], str(Path(beside.file).parent / written))
    if beside.folder is None and not Path(written).is_absolute():
        raise SpecError(
            f"The file {written!r} cannot be found: this workcell was not loaded from a folder.",
            remedy="Write the table itself here.",
        )
    return read((beside.folder or Path()) / written)


def read_table_files(source: Source, descriptions: Mapping[str, Description]) -> dict[str, bytes]:
    """The contents of the table files that a workcell file names, by these names. A client sends them along
    with its text. Files that cannot be read are left out; the compiler of the workcell reports them."""
    keys = {kind.key for kind in getattr(descriptions, "tables", {}).values()}
    modules = source.data.get("modules")
    found: dict[str, bytes] = {}
    for module in modules if isinstance(modules, list) else ():
        config = module.get("config") if isinstance(module, Mapping) else None
        for key, written in config.items() if isinstance(config, Mapping) else ():
            if key not in keys:
                continue
            if isinstance(written, str) and written:
                try:
                    with ((source.folder or Path()) / written).open("rb") as stream:
                        found[written] = stream.read(MAX_BYTES + 1)
                except (OSError, ValueError):
                    continue
    return found


def read_table(kind: DriverTable, written: Any) -> Any:
    """The driver's model of a table that a node has received, or of the file of that name. Raises BadInput,
    SpecError, SpecErrors."""
    if isinstance(written, str):
        source = read(written)
    elif isinstance(written, Mapping):
        source = Source(f"`{kind.key}:`", _strip_places(written), digest(b""))
    else:
        raise BadInput(
            f"`{kind.key}:` is neither a table nor the name of a file.",
            remedy="Write either of them below `config:`.",
        )
    report = FindingList(source.file)
    table = check_table(kind, source, report)
    report.raise_if_failed()
    return table


def _strip_places(value: Any) -> Any:
    """Plain data in containers without places."""
    if isinstance(value, Mapping):
        return SourceMapping(values={str(key): _strip_places(item) for key, item in value.items()})
    if isinstance(value, list | tuple):
        row = SourceList()
        for item in value:
            row.put(_strip_places(item))
        return row
    return value


def make_plain_table(source: Source) -> dict[str, Any]:
    """A table in plain containers, as it is stored with the lab."""
    table: dict[str, Any] = make_plain(source.data)
    return table
