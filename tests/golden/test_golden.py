"""Logs of earlier versions fold as they did; logs of later ones, and downgrades, are refused."""

from __future__ import annotations

import asyncio
import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from alembic.script import ScriptDirectory
from click.testing import CliRunner
from msgspec import structs
from sqlalchemy import create_engine, text

from labos.cli.app import group
from labos.clock import SystemClock, Uuid7Ids
from labos.core.canonical import digest, encode_canonical
from labos.core.envelope import GENESIS, Record, check_chain, seal
from labos.core.ids import LabId
from labos.errors import LogTooNew
from labos.ports import Head
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.writer import ThreadWriter
from labos.store import find_first_damage, migrate, open_store, read_segment, restore_log
from tests.golden.make import MAKERS, views

FOLDER = Path(__file__).parent
NAMES = sorted(path.name.removesuffix(".jsonl.gz") for path in FOLDER.glob("*.jsonl.gz"))


def log(name: str) -> list[Record]:
    return list(check_chain(read_segment(FOLDER / f"{name}.jsonl.gz")))


def test_every_maker_has_made_its_log() -> None:
    assert set(MAKERS) <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_it_folds_to_what_it_folded_to_then(name: str) -> None:
    """If the fold was meant to change: ``python -m tests.golden.make --view NAME``, and say in the
    changelog what changes for labs that exist."""
    then = json.loads(gzip.decompress((FOLDER / f"{name}.views.json.gz").read_bytes()))
    now = views(log(name))
    assert len(now) == len(then)
    for before, found in zip(then, now, strict=True):
        assert _differences(f"at {before['position']}", before, found) == []
        assert encode_canonical(found) == encode_canonical(before)


def _differences(path: str, then: Any, now: Any) -> list[str]:
    if isinstance(then, dict) and isinstance(now, dict):
        keys = sorted({*then, *now})
        return [d for key in keys for d in _differences(f"{path}.{key}", then.get(key), now.get(key))]
    return [] if then == now else [f"{path}: {then!r} then, {now!r} now"]


def test_a_golden_log_holds_faults_questions_and_both_kinds_of_work() -> None:
    types = {record.head.type for name in NAMES for record in log(name)}
    assert types >= {
        "action.unknown",
        "action.reconciled",
        "intervention.resolved",
        "experiment.ended",
        "run.cancelled",
        "module.taken_out",
        "kernel.started",
        "resource.consumed",
        "labware.removed",
    }


def test_the_views_see_every_kind_of_thing() -> None:
    """Of each part of the view there is something to compare, in some log at some moment."""
    seen: set[str] = set()
    for name in NAMES:
        for view in views(log(name)):
            seen |= {part for part, found in view.items() if found}
            for run in view["runs"].values():
                seen |= {step["status"] for step in run["steps"]} | {key for s in run["steps"] for key in s}
    assert seen >= {
        *("places", "labware", "modules", "runs", "actions", "resources", "questions", "experiments"),
        *("pending", "in flight", "done", "unknown", "skipped", "ended_at", "result", "breached", "trouble"),
    }


def test_a_difference_is_seen_and_named() -> None:
    view = next(view for view in views(log("real-1")) if view["labware"])
    other = json.loads(json.dumps(view))
    name = next(name for name, place in other["places"].items() if place["labware"])
    other["places"][name]["labware"].append("P99")
    assert _differences("", other, other) == []
    assert [path.partition(":")[0] for path in _differences("", view, other)] == [f".places.{name}.labware"]


# -- what a later version wrote ----------------------------------------------------------------


def newer(records: list[Record], kind: str, schema: int, payload: dict[str, Any]) -> Record:
    """One more record, as a later version of LabOS would write it."""
    last = records[-1].head
    body = encode_canonical(payload)
    head = structs.replace(
        last,
        position=last.position + 1,
        id=Uuid7Ids().new(),
        stream="later",
        version=1,
        type=kind,
        schema=schema,
        digest=digest(body),
    )
    return seal(records[-1].hash, head, body)


async def _open_and_refuse(url: str, named: str) -> None:
    store = open_store(url)
    kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
    try:
        with pytest.raises(LogTooNew, match=named) as caught:
            await kernel.open()
        assert "newer LabOS" in caught.value.remedy
    finally:
        await kernel.close()
        store.close()


@pytest.mark.parametrize(
    ("kind", "schema", "payload", "named"),
    [
        ("lab.teleported", 1, {"where": "Mars"}, "lab.teleported"),
        ("kernel.started", 99, {"epoch": 1}, "kernel.started"),
        ("kernel.started", 1, {"epoch": 10**9, "version": "9", "mood": "good"}, "mood"),
    ],
)
def test_an_old_program_refuses_a_newer_log_by_name_and_writes_nothing(
    tmp_path: Path, kind: str, schema: int, payload: dict[str, Any], named: str
) -> None:
    records = log("real-1")
    records.append(newer(records, kind, schema, payload))
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    restore_log(url, records, records[0].head.lab, 10**8)
    asyncio.run(_open_and_refuse(url, named))
    told = CliRunner().invoke(group, ["replay", str(tmp_path / "labos.db"), "--hash"])
    assert isinstance(told.exception, LogTooNew)
    assert named in str(told.exception)
    store = open_store(url, read_only=True)
    assert store.head().position == len(records)
    assert find_first_damage(store) is None
    store.close()


# -- migrations --------------------------------------------------------------------------------


def revisions() -> list[str]:
    from labos.store._migrate import alembic_config

    scripts = list(ScriptDirectory.from_config(alembic_config()).walk_revisions())
    return [script.revision for script in reversed(scripts)]


@pytest.mark.parametrize("revision", revisions())
@pytest.mark.parametrize("database", ["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def test_a_log_of_any_revision_is_brought_to_the_newest_one(
    tmp_path: Path,
    database: str,
    revision: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With the golden log in it, written by plain SQL as that revision's tables were."""
    from labos.store._migrate import alembic_config
    from labos.store._url import parse_url

    if database == "sqlite":
        url = f"sqlite:///{tmp_path / 'labos.db'}"
    else:
        url = request.getfixturevalue("postgres_url")
    monkeypatch.setenv("LABOS_DATABASE_URL", url)
    command.upgrade(alembic_config(), revision)
    records = log("real-1")
    engine = create_engine(parse_url(url))
    with engine.begin() as connection:
        columns = [row.strip() for row in FIRST_COLUMNS.split(",")]
        values = ", ".join(f":{column}" for column in columns)
        insert = text(f"INSERT INTO event ({FIRST_COLUMNS}) VALUES ({values})")
        connection.execute(insert, [_row(record) for record in records])
        connection.execute(
            text(
                "UPDATE head SET lab = :lab, position = :position, hash = :hash, recorded_at = :at, epoch = 9"
            ),
            {
                "lab": records[0].head.lab,
                "position": len(records),
                "hash": records[-1].hash,
                "at": records[-1].head.recorded_at,
            },
        )
    engine.dispose()
    migrate(url)
    store = open_store(url)
    assert list(store.read()) == records
    assert find_first_damage(store) is None
    head = store.claim(LabId("x"), "kernel", 30.0)
    last = records[-1]
    assert head == Head(LabId(last.head.lab), len(records), last.hash, 10, last.head.recorded_at)
    store.close()


FIRST_COLUMNS = (
    "position, id, stream, version, type, schema, recorded_at, actor, correlation, causation, "
    "digest, envelope, payload, hash"
)


def _row(record: Record) -> dict[str, Any]:
    head = {name: getattr(record.head, name) for name in record.head.__struct_fields__ if name != "lab"}
    return {**head, "envelope": record.envelope, "payload": record.payload, "hash": record.hash}


def test_the_chain_of_a_golden_log_begins_at_its_beginning() -> None:
    for name in NAMES:
        first = log(name)[0]
        assert seal(GENESIS, first.head, first.payload).hash == first.hash
