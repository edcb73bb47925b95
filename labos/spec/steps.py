"""The order of a workflow's steps: keys, predecessors, windows."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from msgspec.structs import replace

from labos.core.model import Window
from labos.errors import SpecError
from labos.spec.findings import near
from labos.spec.models import StepEntry, Wait, Within
from labos.spec.references import fill
from labos.spec.remarks import Remarks
from labos.spec.source import Path_


class Steps:
    """Steps by name. A name that occurs twice gets ``#2`` at its second place; only a reference
    that leaves open which is meant is an error."""

    def __init__(
        self, entries: list[StepEntry], remarks: Remarks, payload: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self.entries, self.error, self.payload = entries, remarks.error, payload
        self.keys: list[str] = []
        self._by_name: dict[str, list[int]] = {}
        taken: set[str] = {entry.name for entry in entries}
        for index, entry in enumerate(entries):
            before = self._by_name.setdefault(entry.name, [])
            key = entry.name
            number = len(before) + 1
            if before:
                while (key := f"{entry.name}#{number}") in taken:
                    number += 1
                taken.add(key)
            before.append(index)
            self.keys.append(key)
        self._by_key = {key: index for index, key in enumerate(self.keys)}
        self.after: list[tuple[int, ...]] = []
        self.windows: list[tuple[Window, ...]] = []
        self._read_order()

    def find(self, name: str, path: Path_) -> int | None:
        """The index of the step that a reference means; faults are reported at the path."""
        named = self._by_name.get(name, [])
        if len(named) > 1:
            choices = f"{name}#2"
            if name.endswith("#1"):
                return named[0]
            self.error(
                f"There are {len(named)} steps called {name!r}.",
                path,
                f"Write {name + '#1'!r}, {choices!r} … to say which.",
            )
            return None
        if named:
            return named[0]
        if name in self._by_key:
            return self._by_key[name]
        if name.endswith("#1") and self._by_name.get(name[:-2]):
            return self._by_name[name[:-2]][0]
        self.error(f"There is no step {name!r}.", path, near(name, self.keys, "step"))
        return None

    def before(self, index: int) -> set[int]:
        """All steps that are done before this one can start."""
        seen: set[int] = set()
        open_ = list(self.after[index])
        while open_:
            step = open_.pop()
            if step not in seen:
                seen.add(step)
                open_ += self.after[step]
        return seen

    def order(self) -> list[int]:
        """Step indices in an order in which they can run; empty if some wait in a circle."""
        waiting = [len(after) for after in self.after]
        followers: list[list[int]] = [[] for _ in self.after]
        for index, after in enumerate(self.after):
            for step in after:
                followers[step].append(index)
        ready = [index for index, count in enumerate(waiting) if not count]
        order: list[int] = []
        while ready:
            step = heapq.heappop(ready)
            order.append(step)
            for follower in followers[step]:
                waiting[follower] -= 1
                if not waiting[follower]:
                    heapq.heappush(ready, follower)
        return order if len(order) == len(self.after) else []

    def is_chain(self) -> bool:
        """Whether each step waits for all that are written before it."""
        return all(
            not index or (index - 1 in after and max(after) < index) for index, after in enumerate(self.after)
        )

    def _read_order(self) -> None:
        anchors: list[dict[int, Window]] = []
        outer: list[list[Window]] = []
        for index, entry in enumerate(self.entries):
            path: Path_ = ("steps", index)
            if entry.after is None:
                after = {index - 1} if index else set()
            else:
                found = [self.find(name, (*path, "after", n)) for n, name in enumerate(entry.after)]
                after = {step for step in found if step is not None}
            windows, others = self._windows(entry, path)
            outer.append(others)
            if index in after or index in windows:
                self.error(f"The step {entry.name!r} waits for itself.", path, "Name another step.")
                after.discard(index)
                windows.pop(index, None)
            self.after.append(tuple(sorted(after)))
            anchors.append(windows)
        if self.entries and not self.order():
            stuck = next(i for i in range(len(self.entries)) if i in self.before(i))
            self.error(
                f"The step {self.entries[stuck].name!r} waits for itself, by way of other steps.",
                ("steps", stuck, "after"),
                "Break the circle of `after:`.",
            )
            self.after = [(i - 1,) if i else () for i in range(len(self.entries))]
        for index, windows in enumerate(anchors):
            missing = [anchor for anchor in windows if anchor not in self.before(index)]
            for anchor in missing:
                if index in self.before(anchor):
                    self.error(
                        f"{self.entries[index].name!r} is done before {self.entries[anchor].name!r}.",
                        ("steps", index),
                        "Anchor `wait` and `within` at an earlier step.",
                    )
                else:
                    self.after[index] = tuple(sorted({*self.after[index], anchor}))
            self.windows.append((*(windows[anchor] for anchor in sorted(windows)), *outer[index]))

    def _windows(self, entry: StepEntry, path: Path_) -> tuple[dict[int, Window], list[Window]]:
        """A step's windows by the step of this run that they are anchored at, and those that are
        anchored at a step of another run."""
        windows: dict[int, Window] = {}
        outer: dict[tuple[str, str], Window] = {}
        parts: list[tuple[str, int, Wait | Within]] = [("wait", n, p) for n, p in enumerate(entry.wait)]
        parts += [("within", n, p) for n, p in enumerate(entry.within)]
        for key, number, part in parts:
            at = (*path, key, number)
            of = self._other_run(part.of, (*at, "of"))
            if of is None:
                continue
            if of:
                named = (of, part.after)
                first = outer.get(named, Window(-1, of=of, of_step=part.after))
                outer[named] = self._merged(first, part, at)
                continue
            anchor = self.find(part.after, (*at, "after"))
            if anchor is not None:
                windows[anchor] = self._merged(windows.get(anchor, Window(anchor)), part, at)
        return windows, list(outer.values())

    def _other_run(self, text: str, path: Path_) -> str | None:
        """The run or workflow that ``of`` names, which may stand in the payload; empty for the
        same run, None after a fault."""
        try:
            found = fill(text, self.payload)
        except SpecError as error:
            self.error(error.message, path, error.remedy)
            return None
        if not isinstance(found, str):
            self.error("`of` is no text.", path, "Name a workflow, or give the id of a run.")
            return None
        return found

    def _merged(self, window: Window, part: Wait | Within, path: Path_) -> Window:
        if isinstance(part, Wait):
            window = replace(window, wait_s=max(window.wait_s, part.at_least))
        else:
            window = replace(window, within_s=part.at_most, on_breach=part.on_breach)
        if window.within_s is not None and window.within_s < window.wait_s:
            self.error(
                f"It waits {window.wait_s:g} s, but must start within {window.within_s:g} s.",
                path,
                "Let `at_most` be greater than `at_least`.",
            )
        return window
