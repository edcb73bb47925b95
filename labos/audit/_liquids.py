"""Liquids, samples and consumables as rows."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.audit._bench_tables import LABWARE_TABLE as LABWARE
from labos.audit._bench_tables import LOT_USES, RESOURCE_CHANGES, RESOURCES, SAMPLES, TRANSFERS
from labos.audit._rows import RowChanges
from labos.core import labware as b
from labos.core import resources as s
from labos.core.envelope import Envelope
from labos.core.ids import ModuleName
from labos.errors import LogDamaged, NotFound
from labos.ports import BlobStore


def on_pipetted(
    rows: RowChanges, event: b.LiquidTransferred | b.LiquidDrawn, head: Envelope, at: float
) -> None:
    kind, liquid, lots = "out", "", list[str]()
    if isinstance(event, b.LiquidTransferred):
        kind, liquid, lots = "in", event.liquid, list(event.lots)
    by = (event.module, event.run, event.action)
    for number, (well, volume) in enumerate(zip(event.wells, event.volumes_ul, strict=False)):
        what = (kind, event.labware, well, volume, liquid, lots, event.certain)
        rows.add(TRANSFERS, head.position, number, at, *what, *by)
    for number, lot in enumerate(dict.fromkeys(lots)):
        about = (lot, "liquid", event.module, liquid, event.labware, event.run, event.action)
        rows.add(LOT_USES, head.position, number, at, *about)


def on_samples_registered(
    rows: RowChanges, event: b.SamplesRegistered, head: Envelope, at: float, blobs: BlobStore | None
) -> None:
    """Add a sample sheet. A sheet that is too long for the log is a blob; if the blob is lost, its rows are
    missing."""
    samples = event.wells or _unpack(blobs, event.blob)
    rows.update(LABWARE, event.labware, samples={item.well: item.sample for item in samples})
    for number, item in enumerate({item.well: item for item in samples}.values()):
        about = (event.labware, item.well, item.sample, item.volume_ul, event.sheet, head.actor)
        rows.add(SAMPLES, head.position, at, *about)
        what: tuple[Any, ...] = ("sheet", event.labware, item.well, item.volume_ul, item.sample, [], True)
        rows.add(TRANSFERS, head.position, number, at, *what, "", event.run, "")


def _unpack(blobs: BlobStore | None, blob: str) -> tuple[b.Sample, ...]:
    if blobs is None or not blob:
        return ()
    try:
        return msgspec.json.decode(blobs.get(blob), type=tuple[b.Sample, ...])
    except (NotFound, LogDamaged, OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return ()


_LEVELS: dict[type[s.LevelSet | s.ResourceReplenished | s.ResourceConsumed], tuple[str, Any]] = {
    s.LevelSet: ("counted", s.fold_level_set),
    s.ResourceReplenished: ("replenished", s.fold_resource_replenished),
    s.ResourceConsumed: ("consumed", s.fold_resource_consumed),
}
"""The kind of each change of a level, and its fold in the lab itself."""


def on_level_changed(
    rows: RowChanges,
    event: s.LevelSet | s.ResourceReplenished | s.ResourceConsumed,
    head: Envelope,
    at: float,
) -> None:
    kind, fold = _LEVELS[type(event)]
    row = rows.change(RESOURCES, event.module, event.resource)
    if not row["module"]:
        row = rows.put(RESOURCES, event, level=None, capacity=None, lots=[])
    held = s.Resources()
    key = f"{event.module}:{event.resource}"
    if row["level"] is not None:
        lots = msgspec.convert(row["lots"], list[s.Lot])
        held.levels[key] = s.Level(row["level"], row["capacity"], lots)
    if key in held.levels or isinstance(event, s.LevelSet):
        fold(held, event, 0)
    level = held.find(ModuleName(event.module), event.resource)
    if level is not None:
        row["level"], row["capacity"] = level.level, level.capacity
        row["lots"] = msgspec.to_builtins(level.lots)
    row["changed_at_s"] = at
    amount = event.level if isinstance(event, s.LevelSet) else event.amount
    expires, run, action = (getattr(event, name, "") for name in ("expires", "run", "action"))
    what = (event.module, event.resource, kind, amount, row["level"], event.lot)
    rows.add(RESOURCE_CHANGES, head.position, at, *what, expires, run, action, head.actor)
    if event.lot:
        used = (event.lot, kind, event.module, event.resource, "", run, action)
        rows.add(LOT_USES, head.position, 0, at, *used)
