"""A simulated OT-2."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from labos.node import Setup
from labos_drivers._deck import Deck, make_facts

SLOTS = (*(f"deck{number}" for number in range(1, 12)), "deck1_cooler")

RUN_S, HOMES_S = 600.0, 45.0
"""How long a usual run takes, and what the gantry needs besides pipetting."""

COLUMN = 8
"""Tips that the pipette picks up at once."""


class OT2Simulator(Deck):
    """A simulated gantry. It loses its runs when the power is lost. ``dose_s`` of its configuration is the
    time to bring one volume into one well (s). Without it, each run takes as long as a usual run."""

    drawers = SLOTS

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.runs = 0

    async def run_protocol(
        self,
        protocol: str,
        volumes: dict[str, list[float]],
        wells: list[str],
        drawn: dict[str, float],
        variables: dict[str, Any],
    ) -> dict[str, Any]:
        """Run the protocol; returns the robot's own name for the run, and its status."""
        if (liquids := self.config.get("liquids")) and not volumes:
            facts = make_facts(find_dispensed(protocol, liquids))
            volumes, wells = facts.get("volumes", volumes), facts.get("wells", wells)
        tips = min(len(wells), COLUMN)  # work outside the given wells is not simulated
        facts = {
            "protocol": _sha256(protocol),
            "volumes": volumes,
            "wells": wells,
            "drawn": drawn,
            "values": variables,
        }
        for liquid, doses in volumes.items():
            if self.world.find_level(self.name, liquid) is not None:
                self.world.use(self.name, liquid, sum(doses))
        await self.pipette(self._nominal_s(volumes), tips=tips, **facts)
        self.runs += 1
        return {"run": f"{self.name}-{self.runs}", "status": "succeeded"}

    def _nominal_s(self, volumes: Mapping[str, list[float]]) -> float:
        dose_s = float(self.config.get("dose_s", 0.0))
        doses = sum(1 for each in volumes.values() for ul in each if ul)
        return HOMES_S + dose_s * doses if dose_s and doses else RUN_S

    async def resume_run(self) -> None:
        """Raises DeviceError: a run of the simulated gantry never waits."""
        raise self.make_refusal("no run waits")


def find_dispensed(protocol: str, liquids: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """The volumes that a YAML protocol dispenses into wells (µL by liquid and well), from its commands with a
    list of volumes. ``liquids`` gives the liquid of each source well, which is written as ``reservoir:A1``.
    Empty for a file that is not YAML."""
    path, found = Path(protocol), dict[str, dict[str, float]]()
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return found
    for command in yaml.safe_load(path.read_text("utf-8")).get("commands", ()):
        liquid, volumes = liquids.get(str(command.get("source"))), command.get("volume")
        if liquid and isinstance(volumes, list):
            doses = found.setdefault(liquid, {})
            for place, ul in zip(command["destination"], volumes, strict=True):
                well = str(place).rpartition(":")[2]
                doses[well] = doses.get(well, 0.0) + float(ul)
    return found


def _sha256(protocol: str) -> str:
    """The SHA-256 of the protocol file. A protocol that is only a name is returned unchanged."""
    path = Path(protocol)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else protocol
