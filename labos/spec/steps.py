"""The order of a workflow's steps: keys, predecessors, windows."""

from __future__ import annotations

from msgspec.structs import replace

from labos.core.branches import list_all_before, sort_by_predecessors
from labos.core.model import MAIN, Window
from labos.errors import SpecError
from labos.spec.findings import Remarks, suggest_name
from labos.spec.layout import Box, Layout, LayoutNode
from labos.spec.models import StepEntry, Wait, Within
from labos.spec.references import fill
from labos.spec.source import Path_


class Steps:
    """The unrolled steps by name. A name that occurs twice gets ``#2`` at its second occurrence. Only a
    reference with more than one possible meaning is an error."""

    def __init__(self, layout: Layout, remarks: Remarks) -> None:
        self.layout, self.remarks, self.error = layout, remarks, remarks.error
        self.entries = [leaf.entry for leaf in layout.leaves]
        self.keys = [leaf.key for leaf in layout.leaves]
        self.after: list[tuple[int, ...]] = []
        self.windows: list[tuple[Window, ...]] = []
        layout.trace(remarks)
        self._read_order()

    def find(self, name: str, path: Path_, box: Box | None = None) -> int | None:
        """The index of the step to which a reference in a box refers; faults are reported at the path."""
        found = self.layout.find_named(name, box or self.layout.find_box_at(path), path, self.remarks)
        if isinstance(found, LayoutNode):
            inside = [key for key in self.keys if key.startswith((f"{found.key}/", f"{found.key}["))]
            what = found.why_empty or "it stands for several steps"
            remedy = suggest_name(name, inside, "step") if inside else "Refer to a step that is always there."
            self.error(f"{name!r} is not a single step: {what}.", path, remedy)
            return None
        return found.index if found is not None else None

    def list_before(self, index: int) -> set[int]:
        """All steps that are done before this one can start."""
        return list_all_before(self.after.__getitem__, index)

    def sort_steps(self) -> list[int]:
        """Step indices in an order in which they can run; empty if some wait for each other in a cycle."""
        order = sort_by_predecessors(dict(enumerate(self.after)))
        return order if len(order) == len(self.after) else []

    def is_chain(self) -> bool:
        """Whether each step of the workflow itself waits for all steps written before it."""
        return all(
            not index or (index - 1 in after and max(after) < index)
            for index, after in enumerate(self.after)
            if self.layout.leaves[index].part == MAIN
        )

    def _read_order(self) -> None:
        anchors: list[dict[int, Window]] = []
        outer: list[list[Window]] = []
        for index, entry in enumerate(self.entries):
            path: Path_ = ("steps", index)
            after = self.layout.find_before(self.layout.leaves[index], self.remarks)
            windows, others = self._make_windows(entry, path)
            outer.append(others)
            if index in after or index in windows:
                self.error(f"The step {entry.name!r} waits for itself.", path, "Name another step.")
                after.discard(index)
                windows.pop(index, None)
            self.after.append(tuple(sorted(after)))
            anchors.append(windows)
        if self.entries and not self.sort_steps():
            stuck = next(i for i in range(len(self.entries)) if i in self.list_before(i))
            self.error(
                f"The step {self.entries[stuck].name!r} waits for itself, through other steps.",
                ("steps", stuck, "after"),
                "Break the circle of `after:`.",
            )
            self.after = [(i - 1,) if i else () for i in range(len(self.entries))]
        for index, windows in enumerate(anchors):
            missing = [anchor for anchor in windows if anchor not in self.list_before(index)]
            for anchor in missing:
                if index in self.list_before(anchor):
                    self.error(
                        f"{self.entries[index].name!r} is done before {self.entries[anchor].name!r}.",
                        ("steps", index),
                        "Anchor `wait` and `within` at an earlier step.",
                    )
                else:
                    self.after[index] = tuple(sorted({*self.after[index], anchor}))
            self.windows.append((*(windows[anchor] for anchor in sorted(windows)), *outer[index]))

    def _make_windows(self, entry: StepEntry, path: Path_) -> tuple[dict[int, Window], list[Window]]:
        """A step's windows by their anchor step in this run, and the windows with an anchor in another
        run."""
        windows: dict[int, Window] = {}
        outer: dict[tuple[str, str], Window] = {}
        parts: list[tuple[str, int, Wait | Within]] = [("wait", n, p) for n, p in enumerate(entry.wait)]
        parts += [("within", n, p) for n, p in enumerate(entry.within)]
        for key, number, part in parts:
            at = (*path, key, number)
            of = self._find_other_run(part.of, (*at, "of"))
            if of is None:
                continue
            if of:
                named = (of, part.after)
                first = outer.get(named, Window(None, of=of, of_step=part.after))
                outer[named] = self._merge(first, part, at)
                continue
            anchor = self.find(part.after, (*at, "after"))
            if anchor is not None:
                windows[anchor] = self._merge(windows.get(anchor, Window(anchor)), part, at)
        return windows, list(outer.values())

    def _find_other_run(self, text: str, path: Path_) -> str | None:
        """The run or workflow that ``of`` names; it may come from the payload. Empty for the same run, None
        after a fault."""
        try:
            found = fill(text, self.layout.leaves[int(path[1])].scope)
        except SpecError as error:
            self.error(error.message, path, error.remedy)
            return None
        if not isinstance(found, str):
            self.error("`of` is not a text.", path, "Name a workflow, or give the id of a run.")
            return None
        return found

    def _merge(self, window: Window, part: Wait | Within, path: Path_) -> Window:
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
