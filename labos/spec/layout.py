"""The layout of unrolled steps: the file and place where each was written, its payload, and the list to which
it belongs.

A *box* holds the entries of one list: the steps of a file, once for each use of the file. A *node* is one
entry of such a list. Its *rounds* are the results of unrolling it: a step, a box, or one of these for each
element of ``for_each``; none if it was left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from labos.core.model import MAIN, AnyPart
from labos.spec.findings import FindingList, Remarks, suggest_name
from labos.spec.models import StepEntry
from labos.spec.source import Path_, Source


class Origin(NamedTuple):
    """The file, line, column and field of a text."""

    file: str
    line: int
    column: int
    field: str


class Written:
    """A written condition: its place, its payload, and its box."""

    def __init__(self, text: str, path: Path_, scope: Mapping[str, Any], box: Box) -> None:
        self.text, self.path, self.scope, self.box = text, path, scope, box


class Leaf:
    """A step of the plan. ``scope`` is its payload; ``needed`` are the payload keys that its file uses.
    ``part`` is the failed step that it serves, if it is for a failure. ``conditions`` have to be true when it
    is to start."""

    def __init__(
        self,
        index: int,
        key: str,
        entry: StepEntry,
        scope: Mapping[str, Any],
        needed: list[str],
        origin: tuple[Source, Path_],
        node: LayoutNode,
        *,
        foreign: bool,
        part: AnyPart = MAIN,
        conditions: tuple[Written, ...] = (),
    ) -> None:
        self.conditions = conditions
        self.part = part
        self.index, self.key, self.scope, self.needed = index, key, scope, needed
        self.node, self.box = node, node.box
        self.source, self.path = origin
        self.foreign = foreign
        self.unrolled = bool(self.box.prefix or entry.for_each)
        self.entry = entry.model_copy(update={"name": key}) if self.unrolled else entry


class LayoutNode:
    """One entry of a list of steps. ``parallel`` rounds do not wait for each other. ``onward`` are the
    numbers of rounds that continue the round before them: the later parts of one transfer."""

    def __init__(self, key: str, entry: StepEntry, box: Box) -> None:
        self.key, self.entry, self.box = key, entry, box
        self.position = len(box.nodes)
        self.rounds: list[Leaf | Box] = []
        self.parallel = bool(entry.for_each and entry.for_each.parallel)
        self.onward: set[int] = set()
        self.why_empty = ""


class Box:
    """The steps of one list; the names of steps of a used file begin with ``prefix``."""

    def __init__(self, prefix: str = "", node: LayoutNode | None = None, number: int = 0) -> None:
        self.prefix, self.node, self.number = prefix, node, number
        self.nodes: list[LayoutNode] = []


class Layout:
    """All steps of a plan, with their names and their order."""

    def __init__(self) -> None:
        self.main = Box()
        self.aside: list[Box] = []
        """The steps for failures and cancellation."""
        self.leaves: list[Leaf] = []
        self.by_key: dict[str, Leaf] = {}
        self.nodes: dict[str, LayoutNode] = {}
        self._ends: dict[str, frozenset[int]] = {}
        self._open: set[str] = set()

    def find_box_at(self, path: Path_) -> Box:
        """The box in which a reference at a path was written."""
        if len(path) > 1 and path[0] == "steps" and isinstance(path[1], int):
            return self.leaves[path[1]].box
        return self.main

    def find_named(self, name: str, box: Box, path: Path_, remarks: Remarks) -> LayoutNode | Leaf | None:
        """The step to which a name in a box refers, or the entry if it has become several steps. Faults are
        reported at the path."""
        same = [node for node in box.nodes if node.entry.name == name]
        if not same and name.endswith("#1"):
            same = [node for node in box.nodes if node.entry.name == name[:-2]][:1]
        if len(same) > 1:
            remarks.error(
                f"There are {len(same)} steps called {name!r}.",
                path,
                f"Write {name + '#1'!r}, {name + '#2'!r} … to say which.",
            )
            return None
        key = box.prefix + name
        found = same[0] if same else self.by_key.get(key) or self.nodes.get(key)
        if found is None:
            keys = [
                leaf.key.removeprefix(box.prefix) for leaf in self.leaves if leaf.key.startswith(box.prefix)
            ]
            remarks.error(f"There is no step {name!r}.", path, suggest_name(name, keys, "step"))
        elif (
            isinstance(found, LayoutNode)
            and not found.entry.use
            and not found.entry.for_each
            and found.rounds
        ):
            last = found.rounds[-1]  # several rounds are parts of one transfer
            return last if isinstance(last, Leaf) else None
        return found

    def find_before(self, leaf: Leaf, remarks: Remarks) -> set[int]:
        """The steps for which a step waits, by its place in the file and its ``after``."""
        number = next(n for n, item in enumerate(leaf.node.rounds) if item is leaf)
        return set(self._find_before_round(leaf.node, number, remarks))

    def trace(self, remarks: Remarks) -> None:
        """Find the ends of all entries, in the order in which they were written."""
        boxes = [self.main, *self.aside]
        try:
            while boxes:
                for node in boxes.pop().nodes:
                    self.find_ends(node, remarks)
                    boxes += [item for item in node.rounds if isinstance(item, Box)]
        except RecursionError:
            remarks.error(
                "Too many steps that are left out wait for each other.",
                ("steps",),
                "Write steps below those that they wait for.",
            )

    def _find_before_round(self, node: LayoutNode, number: int, remarks: Remarks) -> frozenset[int]:
        if number and (not node.parallel or number in node.onward):
            return self._find_ends_of_round(node.rounds[number - 1], remarks)
        return self._find_before_node(node, remarks)

    def _find_before_node(self, node: LayoutNode, remarks: Remarks) -> frozenset[int]:
        if node.entry.after is None and node.position:
            return self.find_ends(node.box.nodes[node.position - 1], remarks)
        path = self._find_path(node)
        found: frozenset[int] = frozenset()
        for number, name in enumerate(node.entry.after or ()):
            meant = self.find_named(name, node.box, (*path, "after", number), remarks)
            if isinstance(meant, Leaf):
                found |= {meant.index}
            elif meant is not None:
                found |= self.find_ends(meant, remarks)
        above = node.box.node
        return found if found or above is None else self._find_before_round(above, node.box.number, remarks)

    def _find_path(self, node: LayoutNode) -> Path_:
        """A path at which faults of a node are reported: that of its first step."""
        item: Leaf | Box | None = node.rounds[0] if node.rounds else None
        while isinstance(item, Box):
            item = next((r for n in item.nodes for r in n.rounds), None)
        return ("steps", item.index) if isinstance(item, Leaf) and not node.entry.use else ("steps",)

    def find_ends(self, node: LayoutNode, remarks: Remarks) -> frozenset[int]:
        """The last steps of an entry. If the entry was left out, the last steps of the entries before it."""
        found = self._ends.get(node.key)
        if found is not None:
            return found
        if node.key in self._open:
            return frozenset()  # a cycle, which is reported as a fault
        self._open.add(node.key)
        if not node.rounds:
            found = self._find_before_node(node, remarks)
        else:
            last = node.rounds[-1:]
            if node.parallel:
                last = [item for number, item in enumerate(node.rounds, 1) if number not in node.onward]
            found = frozenset().union(*(self._find_ends_of_round(item, remarks) for item in last))
        self._open.discard(node.key)
        self._ends[node.key] = found
        return found

    def _find_ends_of_round(self, item: Leaf | Box, remarks: Remarks) -> frozenset[int]:
        if isinstance(item, Leaf):
            return frozenset((item.index,))
        followed: set[str] = set()
        for node in item.nodes:
            if node.entry.after is None:
                if node.position:
                    followed.add(item.nodes[node.position - 1].key)
                continue
            for other in item.nodes:
                if other is not node and {other.entry.name, other.key[len(item.prefix) :]} & set(
                    node.entry.after
                ):
                    followed.add(other.key)
        open_ends = [node for node in item.nodes if node.key not in followed]
        return frozenset().union(*(self.find_ends(node, remarks) for node in open_ends))


class UnrolledRemarks(Remarks):
    """Faults of an unrolled step are reported at the place where it was written, with its name."""

    def __init__(self, source: Source, report: FindingList, layout: Layout) -> None:
        super().__init__(source, report)
        self.layout = layout

    def find_origin(self, path: Path_) -> Origin:
        """The place in the original file for a path."""
        source, at, name = self.find_source(path)
        return Origin(source.file, *source.place(at), source.name_field(at) + name)

    def find_source(self, path: Path_) -> tuple[Source, Path_, str]:
        if len(path) > 1 and path[0] == "steps" and isinstance(path[1], int):
            leaf = self.layout.leaves[path[1]]
            return leaf.source, (*leaf.path, *path[2:]), f" ({leaf.key})" if leaf.unrolled else ""
        return self.source, path, ""
