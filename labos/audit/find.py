"""Finds experiments, runs, samples, images, files, results and publications by words, with facets.

An entry must contain all words of a query; ``colo*`` matches all words with this beginning. Entries with the
words in their name come first, then the newest. SQLite uses FTS5, PostgreSQL its full text search. Because
LabOS divides texts into words (``labos.audit.words``), both find the same.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import msgspec

from labos.audit._ddl import words_name, write_vector
from labos.audit._entry_tables import ENTRIES, KINDS
from labos.audit.query import ReadConnection
from labos.audit.words import words_of
from labos.errors import BadInput

FACETS = ("kind", "user", "workcell", "workflow", "experiment", "status", "keyword", "month")
MOST_VALUES = 20
"""The number of values of a facet that are counted, the most frequent ones."""
MOST_FOUND = 200
MOST_ASKED = 30
"""The largest number of words in a query."""

_REMEDY = "Use words of letters and digits, such as: labos find color plate*"
_WORD_AND_STAR = re.compile(r"\S+")


class SearchQuery(msgspec.Struct, frozen=True):
    """A query: all ``words`` (none: everything) and every filter that is not empty, with one value of each
    list. ``since`` and ``until`` are UTC nanoseconds; 0: no limit. The first ``offset`` entries are skipped,
    and at most ``limit`` are returned. ``facets``: count the entries by user, workcell and so on. Entries of
    the campaigns ``hidden`` are not found."""

    words: str = ""
    kind: tuple[str, ...] = ()
    user: tuple[str, ...] = ()
    workcell: tuple[str, ...] = ()
    workflow: tuple[str, ...] = ()
    experiment: tuple[str, ...] = ()
    run: tuple[str, ...] = ()
    status: tuple[str, ...] = ()
    keyword: tuple[str, ...] = ()
    since: int = 0
    until: int = 0
    limit: int = 20
    offset: int = 0
    facets: bool = False
    hidden: tuple[str, ...] = ()


class FoundFile(msgspec.Struct, frozen=True):
    """A file, which ``GET /files/{sha256}`` returns."""

    file: str
    sha256: str
    bytes: int


class SearchEntry(msgspec.Struct, frozen=True):
    """An entry. ``name`` is its name in other commands: E1, R1, a sample's well ``P7/B7``, the result of a
    step ``R1#3``, the SHA-256 of a file or image, ``E1@2041`` for a publication of E1 at that position of the
    log. ``at`` is the time at which it started, was registered, returned or published (UTC, ISO 8601)."""

    kind: str
    name: str
    title: str
    about: str
    at: str
    user: str
    workcell: str
    workflow: str
    experiment: str
    run: str
    module: str
    status: str
    keywords: list[str]
    creators: list[str]
    files: list[FoundFile]


class FacetValue(msgspec.Struct, frozen=True):
    value: str
    count: int


class SearchResult(msgspec.Struct, frozen=True):
    """``total`` is the number of matching entries; ``entries`` is the requested part of them. ``facets``
    count the entries for each value, the most frequent first. The search index covers the log up to
    ``position``; ``behind`` is the number of later events that were in the log when the query came."""

    entries: list[SearchEntry]
    total: int
    facets: dict[str, list[FacetValue]]
    position: int
    behind: int = 0


_COLUMNS = (
    *("kind", "name", "title", "about", "at", "user_id", "workcell", "workflow", "experiment", "run"),
    *("module", "status", "keywords", "creators", "files"),
)
_JSON = ("keywords", "creators", "files")


def find(asker: ReadConnection, question: SearchQuery, log_position: int = 0) -> SearchResult:
    """Answer a query from the present search index. ``log_position`` is the position of the log when the
    query came. Raises BadInput for an invalid query."""
    where, values = _write_conditions(asker, question)
    position = asker.fetch("SELECT position FROM projection")[0][0]
    total = asker.fetch(f"SELECT count(*) FROM entries WHERE {where}", *values)[0][0]
    rows = asker.fetch(
        f"SELECT {', '.join(_COLUMNS)} FROM entries WHERE {where} "
        "ORDER BY CASE WHEN lower(name) = ? THEN 0 ELSE 1 END, at_s DESC, number DESC LIMIT ? OFFSET ?",
        *(*values, question.words.strip().lower(), min(question.limit, MOST_FOUND), question.offset),
    )
    facets = _count_facets(asker, where, values) if question.facets else {}
    behind = max(log_position - position, 0)
    return SearchResult([_make_entry(row) for row in rows], total, facets, position, behind)


def _make_entry(row: Any) -> SearchEntry:
    fields = dict(zip(_COLUMNS, row, strict=True))
    fields["user"] = fields.pop("user_id")
    for name in _JSON:
        fields[name] = msgspec.json.decode(fields[name])
    return msgspec.convert(fields, SearchEntry)


def _write_conditions(asker: ReadConnection, question: SearchQuery) -> tuple[str, list[Any]]:
    """The conditions after WHERE, and their values."""
    for kind in question.kind:
        if kind not in KINDS:
            raise BadInput(f"There is no kind of entry {kind!r}.", remedy=f"Use one of {', '.join(KINDS)}.")
    parts: list[tuple[str, Sequence[Any]]] = []
    terms = _split_terms(question.words)
    if terms and asker.dialect == "postgresql":
        wanted = " & ".join(f"'{word}'{':*' if begins else ''}" for word, begins in terms)
        parts.append((f"{write_vector(ENTRIES)} @@ ?::tsquery", [wanted]))
    elif terms:
        index = words_name(ENTRIES)
        bare = index.strip('"')
        wanted = " AND ".join(f'"{word}"{" *" if begins else ""}' for word, begins in terms)
        parts.append((f"number IN (SELECT rowid FROM labos.{index} WHERE {bare} MATCH ?)", [wanted]))
    for name in ("kind", "user", "workcell", "workflow", "experiment", "run", "status"):
        if one_of := getattr(question, name):
            parts.append((f"{'user_id' if name == 'user' else name} IN ({_write_marks(one_of)})", one_of))
    if question.keyword:
        is_one = f"{_KEYWORD} IN ({_write_marks(question.keyword)})"
        parts.append((f"EXISTS (SELECT 1 FROM {_write_keywords(asker)} WHERE {is_one})", question.keyword))
    if question.since:
        parts.append(("at_s >= ?", [question.since / 1e9]))
    if question.until:
        parts.append(("at_s < ?", [question.until / 1e9]))
    if question.hidden:
        hidden = f"SELECT run FROM runs WHERE campaign IN ({_write_marks(question.hidden)})"
        parts.append((f"run NOT IN ({hidden})", question.hidden))
    values = [value for _, own in parts for value in own]
    return " AND ".join(condition for condition, _ in parts) or "1 = 1", values


def _write_marks(values: Sequence[Any]) -> str:
    return ", ".join("?" * len(values))


def _split_terms(text: str) -> list[tuple[str, bool]]:
    """The words of a query, and whether each is only the beginning of a word. Raises BadInput."""
    found: dict[tuple[str, bool], bool] = {}
    for piece in _WORD_AND_STAR.findall(text):
        words = words_of(piece)
        for word in words:
            found[word, piece.endswith("*") and word == words[-1]] = True
    if text.strip() and not found:
        raise BadInput(f"{text!r} contains no word to search for.", remedy=_REMEDY)
    if len(found) > MOST_ASKED:
        raise BadInput(f"A search can have at most {MOST_ASKED} words.", remedy="Leave some of them out.")
    return list(found)


_KEYWORD = "one.value"


def _write_keywords(asker: ReadConnection) -> str:
    """The keywords of an entry, one in each row, as ``one.value``."""
    if asker.dialect == "postgresql":
        return "json_array_elements_text(keywords) AS one(value)"
    return "json_each(keywords) AS one"


def _count_facets(asker: ReadConnection, where: str, values: list[Any]) -> dict[str, list[FacetValue]]:
    """The count of each value among all matching entries."""
    month = (
        "to_char(at, 'YYYY-MM')" if asker.dialect == "postgresql" else "strftime('%Y-%m', at_s, 'unixepoch')"
    )
    expressions = {"user": "user_id", "month": month, "keyword": _KEYWORD}
    found: dict[str, list[FacetValue]] = {}
    for facet in FACETS:
        value = expressions.get(facet, facet)
        source = f"entries, {_write_keywords(asker)}" if facet == "keyword" else "entries"
        rows = asker.fetch(
            f"SELECT {value}, count(*) FROM {source} WHERE ({where}) AND {value} <> '' "
            f"GROUP BY 1 ORDER BY 2 DESC, 1 LIMIT {MOST_VALUES}",
            *values,
        )
        found[facet] = [FacetValue(str(name), count) for name, count in rows]
    return found


# -- messages between the kernel's process and the process that answers (labos.audit.find_process)


class LogPlace(msgspec.Struct, frozen=True):
    """The address of the log and its blobs. It is not given on a command line, because a URL may contain a
    password."""

    database: str
    blobs: str
    home: str


class Refusal(msgspec.Struct, frozen=True):
    """The text of an error, and whether the query was invalid."""

    message: str
    remedy: str
    misasked: bool


class SearchReply(msgspec.Struct, frozen=True):
    found: SearchResult | None = None
    refusal: Refusal | None = None
