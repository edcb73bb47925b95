"""What a campaign of many rows costs in memory, beside one of few."""

from __future__ import annotations

import tracemalloc

import msgspec

from labos.core.campaigns import Campaign, Campaigns, CampaignSubmitted, fold_campaign_submitted
from labos.core.ids import CampaignId
from labos.http.campaign_rows import RowTable
from tests.benchmarks.figures import Figure, Report

MOST_MB = 20.0


def _table(rows: int) -> bytes:
    return b"\n".join(msgspec.json.encode({"seal": {"time": n / 10}, "volume": n}) for n in range(rows))


def _state(rows: int) -> Campaign:
    campaigns = Campaigns()
    name = CampaignId("C1")
    event = CampaignSubmitted(name, "screen", "ada", "pcr", "rpl", rows, "d", "d")
    fold_campaign_submitted(campaigns, event, 0)
    return campaigns.open[name]


def _measure(rows: int) -> Report:
    data = _table(rows)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    table = RowTable(data)
    index = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert len(table) == rows
    assert table.read_row(rows - 1)["volume"] == rows - 1
    few, many = (len(msgspec.msgpack.encode(_state(count))) for count in (10, rows))
    whole = (len(data) + index) / 1e6
    return Report(
        [
            Figure(
                f"memory of a campaign of {rows:,} rows: table and index",
                f"{whole:.1f} MB",
                must=f"≤ {MOST_MB:g} MB",
                ok=whole <= MOST_MB,
            ),
            Figure(
                f"state of a campaign of {rows:,} rows, more than one of 10",
                f"{many - few} bytes",
                must="≤ 16 bytes",
                ok=many - few <= 16,
            ),
        ],
        [f"blob {len(data) / 1e6:.1f} MB, index {index / 1e6:.1f} MB"],
    )


def measure() -> Report:
    return _measure(100_000)


def smoke() -> Report:
    return _measure(1_000)
