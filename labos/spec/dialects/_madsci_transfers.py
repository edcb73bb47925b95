"""MADSci's transfer capabilities, as the transfers in a workcell's file.

Its location manager plans with templates, and uses the one with the least ``cost_weight``. Templates for a
pair of locations take precedence, then those for the source, then those for the target, then all others
(``madsci.location_manager.transfer_planner``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.spec.dialects._reader import Reader, is_number
from labos.spec.source import Path_, SourceList, SourceMapping

KEYS = ("location_transfer_capabilities", "transfer_capabilities")
OVERRIDES = "override_transfer_templates"
OF_TARGETS = ("target_overrides", "destination_overrides")


class TransferTemplates:
    """Reads the templates. ``modules`` are the nodes by MADSci's names; ``places`` are the stations by the
    names and ids of locations."""

    def __init__(
        self, reader: Reader, modules: Mapping[str, SourceMapping], places: Mapping[str, str]
    ) -> None:
        self.reader, self.modules, self.places = reader, modules, places
        self.found = SourceList(reader.source.data.at)

    def read(self) -> SourceList:
        """The transfers, in the order of the file."""
        data = self.reader.source.data
        for key in KEYS:
            if data.get(key) is None:
                continue
            table = self.reader.expect_table(data[key], (key,), f"`{key}`")
            self._read_templates(table.get("transfer_templates"), (key, "transfer_templates"))
            self._read_overrides(table, (key, OVERRIDES))
            self._read_capacity(table, (key, "capacity_cost_config"))
            known = ("transfer_templates", OVERRIDES, "capacity_cost_config")
            self.reader.ignore_others(table, known, (key,))
        return self.found

    def _read_overrides(self, table: SourceMapping, path: Path_) -> None:
        overrides = self.reader.expect_table(table.get(OVERRIDES), path, f"`{OVERRIDES}`")
        entries = self.reader.iterate_entries
        for source, rows, at in entries(
            overrides.get("source_overrides"), (*path, "source_overrides"), "`source_overrides`"
        ):
            self._read_templates(rows, at, source=source)
        for key in OF_TARGETS:
            for target, rows, at in entries(overrides.get(key), (*path, key), f"`{key}`"):
                self._read_templates(rows, at, target=target)
        key = "pair_overrides"
        for source, targets, at in entries(overrides.get(key), (*path, key), f"`{key}`"):
            for target, rows, there in entries(targets, at, "The overrides of a source"):
                self._read_templates(rows, there, source=source, target=target)
        self.reader.ignore_others(overrides, ("source_overrides", *OF_TARGETS, key), path)

    def _read_templates(self, rows: object, path: Path_, *, source: str = "", target: str = "") -> None:
        if rows is None:
            return
        ends = {"from": source, "to": target}
        for name in (name for name in ends.values() if name and name not in self.places):
            self.reader.add_warning(
                f"No location is called {name!r}: these transfers are left out.",
                path,
                "Check the name.",
                key=True,
            )
            return
        for index, row in enumerate(self.reader.expect_sequence(rows, path, "the templates")):
            template = self.reader.expect_table(row, (*path, index), "A template")
            self._read_template(template, (*path, index), ends)

    def _read_template(self, template: SourceMapping, path: Path_, ends: Mapping[str, str]) -> None:
        at = self.reader.source.place(path)
        node = template.get("node_name")
        if not isinstance(node, str) or not isinstance(template.get("action"), str):
            raise self.reader.source.error(
                "A transfer template names no node, or no action.",
                path,
                remedy="Write `node_name:` and `action:`.",
            )
        module = self.modules[node]["name"] if node in self.modules else node
        way = SourceMapping(at, {"module": module, "action": template["action"]})
        for end in ("source", "target"):
            way.put(end, str(template.get(f"{end}_argument_name") or f"{end}_location"))
        cost: Any = template.get("cost_weight")
        if is_number(cost) and cost > 0:
            way.put("cost", cost)
        elif cost:
            raise self.reader.source.error(
                f"A transfer cannot cost {cost!r}.",
                (*path, "cost_weight"),
                remedy="Write a number above 0, or leave it out (1).",
            )
        args = SourceMapping(at)
        for key in ("additional_args", "additional_location_args"):
            for name, value, _ in self.reader.iterate_entries(template.get(key), (*path, key), f"`{key}`"):
                args.put(name, self.places.get(value, value) if "location" in key else value)
        if args:
            way.put("args", args)
        for end, location in ends.items():
            if location:
                place = SourceList(at)
                place.put(self.places[location], at)
                way.put(end, place)
        self.found.put(way, at)

    def _read_capacity(self, table: SourceMapping, path: Path_) -> None:
        config = self.reader.expect_table(table.get("capacity_cost_config"), path, "`capacity_cost_config`")
        if config.get("enabled"):
            self.reader.add_warning(
                "In LabOS, the cost of a transfer does not depend on how full its target is; a "
                "transfer waits until there is room.",
                path,
                "To avoid a place, give it its own way with a higher `cost:`.",
                key=True,
            )
