"""Which well of an assay plate holds what, and the protocols that make it so.

Columns 1 and 2 hold no drug, columns 3 to 12 a dose each, falling by half. Rows A to D hold cells (four
replicates of each dose), rows E to H the same without cells (their blanks). Run by itself, it writes the
protocol of each workcell anew:

    python specs/apps/growth_assay/growth_layout.py
"""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent
REPLICATES, BLANKS = "ABCD", "EFGH"
COLUMNS = range(1, 13)
WELL_UL, CELLS_UL = 200.0, 100.0
DRUG = "tetracycline"
STRONG, WEAK = 64.0, 2.0
"""Stock solutions of the drug, in mg/L."""

SERIES_UL = (100.0, 50.0, 25.0, 12.5, 6.25)
"""Of each stock solution: halves, down to what a pipette takes."""

_NO_DRUG = (0.0, 0.0)
STOCK_UL = (_NO_DRUG, _NO_DRUG, *((ul, 0.0) for ul in SERIES_UL), *((0.0, ul) for ul in SERIES_UL))
"""Of the strong and of the weak stock solution, by column (µL)."""

LIQUIDS = ("medium", "strong", "weak", "cells")
"""In the order in which they are pipetted: cells come last, so that no tip brings them elsewhere."""

COLUMNS_AT_ONCE = 2
"""That the SOLO serves with one stroke: more steps than 69 crash its program."""

END = "!@#$"


def doses() -> dict[int, float]:
    """mg/L of the drug in each column."""
    return {
        column: (strong * STRONG + weak * WEAK) / WELL_UL
        for column, (strong, weak) in zip(COLUMNS, STOCK_UL, strict=True)
    }


def volumes(liquid: str) -> dict[str, float]:
    """µL of a liquid in each well."""
    found = {}
    for row in REPLICATES + BLANKS:
        for column, (strong, weak) in zip(COLUMNS, STOCK_UL, strict=True):
            cells = CELLS_UL if row in REPLICATES else 0.0
            amounts = {"strong": strong, "weak": weak, "cells": cells}
            amounts["medium"] = WELL_UL - sum(amounts.values())
            found[f"{row}{column}"] = amounts[liquid]
    return found


def for_ot2() -> str:
    """A protocol for the OT-2, as YAML."""
    wells = dict(zip(LIQUIDS, ("A1", "A3", "A4", "A2"), strict=True))
    lines = [
        "# Written by growth_layout.py: medium, drug and cells of an assay plate.",
        "metadata:",
        "  protocolName: Growth assay plate",
        '  apiLevel: "2.12"',
        "",
        "# A fresh tip of each size for each liquid.",
        "resources: {tips: 8}",
        "",
        "equipment:",
        '  - {name: corning_96_wellplate_360ul_flat, location: "2", alias: plate}',
        '  - {name: nest_12_reservoir_15ml, location: "3", alias: reservoir}',
        '  - {name: opentrons_96_tiprack_300ul, location: "8"}',
        '  - {name: opentrons_96_tiprack_20ul, location: "9"}',
        "  - {name: p300_single_gen2, mount: right}",
        "  - {name: p20_single_gen2, mount: left}",
        "",
        "commands:",
    ]
    for liquid in LIQUIDS:
        used = {well: ul for well, ul in volumes(liquid).items() if ul}
        lines += [
            f"  - {{name: Fresh tips for {liquid}, replace_tip: true}}",
            f"  - name: {liquid.capitalize()}",
            f'    source: "reservoir:{wells[liquid]}"',
            "    destination: [" + ", ".join(f'"plate:{well}"' for well in used) + "]",
            "    volume: [" + ", ".join(f"{ul:g}" for ul in used.values()) + "]",
            "    drop_tip: false",
        ]
    return "\n".join(lines) + "\n"


def for_solo() -> str:
    """A protocol for the SOLO (``.hso``): what stands at each position, then the steps."""
    places = dict(zip(LIQUIDS, ("Position1", "Position5", "Position6", "Position2"), strict=True))
    deck = ["12 Channel Reservoir", "12 Channel Reservoir", "TipBox.50uL.Axygen", "Corning 3383"]
    deck += ["12 Channel Reservoir", "12 Channel Reservoir", "Empty", "Empty"]
    lines = list(deck)
    for liquid in LIQUIDS:
        amounts = volumes(liquid)
        lines += _get_tips()
        for first in COLUMNS[::COLUMNS_AT_ONCE]:
            some = range(first, first + COLUMNS_AT_ONCE)
            part = {well: ul for well, ul in amounts.items() if ul and int(well[1:]) in some}
            if part:
                lines += _aspirate(places[liquid], part) + _dispense("Position4", part)
    return "\r\n".join(lines) + "\r\n"


def _get_tips() -> list[str]:
    return ["GetTip", "Position3", "TipDisposal", "8", "False", "0", "False", END]


def _aspirate(position: str, column: dict[str, float]) -> list[str]:
    return [
        *("Aspirate", position, "0", "2", "100", "0", "False", "True", "True", "False", ""),
        *("0", "0", "0.5", "False", "0", "0", "0", "", "8", "0", "0", "False", "0", "0", "a", "0", "0"),
        *("1", "0", *_matrix(column), "0", "False", "5", "False", "0", "False", "0", "0", "0", END),
    ]


def _dispense(position: str, column: dict[str, float]) -> list[str]:
    return [
        *("Dispense", position, "0", "2", "100", "0", "False", "True", "True", "False", ""),
        *("0", "0", "0.5", "False", "0", "0", "0", "", "8", "0", "0", "False", "0", "0", "a", "1", "0"),
        *(*_matrix(column), "False", "False", "0", "0", "0", END),
    ]


def _matrix(column: dict[str, float]) -> list[str]:
    rows = REPLICATES + BLANKS
    return [",".join(f"{column.get(f'{row}{number}', 0.0):g}" for number in COLUMNS) for row in rows]


def write_protocols(folder: Path = HERE) -> None:
    """Write the protocol of each workcell into its folder."""
    for name, text in (
        ("rpl/protocols/assay_plate.yaml", for_ot2()),
        ("bio/protocols/assay_plate.hso", for_solo()),
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(text.encode())


if __name__ == "__main__":
    write_protocols()
