"""The common part of all dialects: it reads tables and lists with places, and reports unused fields."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import PurePath
from typing import Any

from labos.spec.findings import Remarks
from labos.spec.source import Path_, Source, SourceList, SourceMapping


class Reader(Remarks):
    """Converts one file to LabOS' form, with a warning for each assumption."""

    def ignore(self, path: Path_, why: str = "is not used by LabOS") -> None:
        message = f"The key {path[-1]!r} {why}."
        self.add_warning(message, path, "It is ignored; remove it if you can.", key=True)

    def ignore_others(self, table: Iterable[str], known: Collection[str], path: Path_ = ()) -> None:
        """Report the keys of a table that are not known."""
        for key in table:
            if key not in known:
                self.ignore((*path, key))

    def expect_table(self, value: Any, path: Path_, what: str) -> SourceMapping:
        """The value as a table; an empty value counts as an empty table."""
        if isinstance(value, SourceMapping):
            return value
        if value is None:
            return SourceMapping(self.source.place(path))
        raise self.source.error(
            f"{what} must be a table of keys and values.", path, remedy="Write `key: value`."
        )

    def expect_row(self, key: str, what: str) -> SourceList:
        """A list at the top level, which must be there."""
        if key not in self.source.data:
            raise self.source.error(f"`{key}` is missing.", (key,), remedy=f"Write `{key}:` and {what}.")
        return self.expect_sequence(self.source.data[key], (key,), what)

    def expect_sequence(self, value: Any, path: Path_, what: str) -> SourceList:
        """The value as a list."""
        if isinstance(value, SourceList):
            return value
        remedy = f"Write {what} below it, each with a dash."
        raise self.source.error(f"`{path[-1]}` must be a list.", path, remedy=remedy)

    def take_name(self, out: SourceMapping, metadata: SourceMapping) -> None:
        """Set the name from the root, from the metadata, or from the file's name."""
        if isinstance(self.source.data.get("name"), str):
            out.take(self.source.data, "name")
        elif isinstance(metadata.get("name"), str):
            out.take(metadata, "name")
        else:
            out.put("name", PurePath(self.source.file).stem or "unnamed")

    def iterate_entries(self, value: Any, path: Path_, what: str) -> Iterator[tuple[str, Any, Path_]]:
        """The entries of a table that may be missing: key, value, path."""
        for key, item in self.expect_table(value, path, what).items():
            yield key, item, (*path, key)

    def finish(self, out: SourceMapping) -> Source:
        return Source(self.source.file, out, self.source.digest, self.source.folder)


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
