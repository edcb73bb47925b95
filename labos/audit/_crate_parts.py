"""The parts of a crate: entities of its metadata, and the files that they describe."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

import msgspec

from labos.ports import BlobReader

METADATA = "ro-crate-metadata.json"
VERSION = "https://w3id.org/ro/crate/1.1"
CONTEXT = [f"{VERSION}/context", {"sha256": "https://w3id.org/ro/terms/workflow-run#sha256"}]
"""``sha256`` is a term of the run crates that is missing in the context of RO-Crate 1.1."""

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")

Entity = dict[str, Any]


class Crate:
    """Entities by id, and the content of files: bytes, or the digest of a blob that is read when the crate is
    written."""

    def __init__(self) -> None:
        self._entities: dict[str, Entity] = {}
        self._files: dict[str, bytes | str] = {}
        self._paths: dict[str, str] = {}

    def add(self, kind: str | list[str], id_: str, **properties: Any) -> str:
        """Add the description of a thing, unless it exists; returns its id. Empty properties are left out."""
        if id_ not in self._entities:
            self._entities[id_] = {"@id": id_, "@type": kind}
            self.add_properties(id_, **properties)
        return id_

    def add_properties(self, id_: str, **properties: Any) -> None:
        """Add properties to a described thing."""
        filled = {name: value for name, value in properties.items() if value not in (None, "", [], {})}
        self._entities[id_].update(filled)

    def extend(self, id_: str, name: str, *ids: str) -> None:
        """Add references to a property of a described thing."""
        known = self._entities[id_].get(name, [])
        before = [each["@id"] for each in (known if isinstance(known, list) else [known])]
        self._entities[id_][name] = make_link(*before, *ids)

    def add_user(self, user: str) -> str:
        """Add a user, who is known only by the id; returns the id of the entry."""
        return self.add("Person", make_local_id("user", user), name=user, identifier=user)

    def put(self, path: str, content: bytes, **properties: Any) -> str:
        """Add a file with this content; returns its id."""
        digest = hashlib.sha256(content).hexdigest()
        return self._add_file(path, digest, content, {"contentSize": str(len(content)), **properties})

    def put_blob(self, path: str, digest: str, size: int | None, **properties: Any) -> str:
        """Add a file whose content is a blob; returns its id. A blob is added only once, also with different
        names."""
        full = {"contentSize": None if size is None else str(size), **properties}
        return self._add_file(path, digest, digest, full)

    def _add_file(self, path: str, digest: str, content: bytes | str, properties: Entity) -> str:
        known = self._paths.setdefault(digest, path)
        if known in self._files and self._entities[known].get("sha256") != digest:
            head = PurePosixPath(path)
            known = self._paths[digest] = str(head.with_name(f"{digest[:12]}-{head.name}"))
        self._files[known] = content
        kind = properties.pop("kind", "File")
        return self.add(kind, known, sha256=digest, **properties)

    def encode_metadata(self) -> bytes:
        """``ro-crate-metadata.json``; the root lists all present files."""
        self.add_properties("./", hasPart=make_link(*self._files))
        graph = {"@context": CONTEXT, "@graph": list(self._entities.values())}
        return msgspec.json.format(msgspec.json.encode(graph), indent=2) + b"\n"

    def read_contents(self, blobs: BlobReader) -> Iterator[tuple[str, bytes]]:
        """Path and content of each file, one at a time. The metadata are last, so that an incomplete file is
        not a crate. Raises NotFound, LogDamaged for a missing or wrong blob."""
        for path, content in self._files.items():
            yield path, content if isinstance(content, bytes) else blobs.get(content)
        yield METADATA, self.encode_metadata()


def make_link(*ids: str) -> Any:
    """References to other things: one, or a list; None for none."""
    each = [{"@id": id_} for id_ in dict.fromkeys(ids) if id_]
    return each[0] if len(each) == 1 else each or None


def make_local_id(kind: str, name: str) -> str:
    """The id of a thing that is not a file: ``#user-ada``."""
    return f"#{kind}-{quote(name, safe='')}"


def safe_name(name: str) -> str:
    """The last part of a file's name, with characters that are safe on every disk and in every URL."""
    return _UNSAFE.sub("_", re.split(r"[/\\]", name)[-1]).lstrip(".") or "file"


def with_offset(at: str | None) -> str | None:
    """A time of a view in the form for the profiles: with ``+00:00`` instead of ``Z``."""
    return at.removesuffix("Z") + "+00:00" if at else None
