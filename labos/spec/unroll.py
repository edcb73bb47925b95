"""Unrolls a workflow: ``for_each`` over lists, ``use`` of other files, steps left out by ``when``.

The result is a list of plain steps. Each has its payload and the place where it was written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labos.core.expressions import ExpressionError, evaluate, list_names, parse_expression
from labos.core.model import MAIN, ON_CANCEL, AnyPart
from labos.errors import SpecError
from labos.spec.carriers import TRANSFER, Carriers
from labos.spec.defaults import Defaults
from labos.spec.dialects import convert_workflow
from labos.spec.files import FileFinder
from labos.spec.findings import FindingList, Remarks
from labos.spec.layout import Box, Layout, LayoutNode, Leaf, Written
from labos.spec.models import RetryEntry, RunSteps, StepEntry, WorkflowFile
from labos.spec.payloads import find_unused
from labos.spec.references import fill, has_key, list_keys
from labos.spec.source import Path_, Source
from labos.spec.source import parse as parse_yaml
from labos.spec.validation import validate

MOST_STEPS = 2000
MOST_ENTRIES = 20_000
OF_A_RESCUE = {"name", "module", "action", "args", "use", "payload", "for_each", "when", "after"}
OF_A_RESCUE |= {"retry", "timeout", "comment"}
"""Keys of a step below ``on_error``."""

OF_A_USE = {"name", "use", "payload", "for_each", "after", "when", "comment"}
"""Keys of an entry that uses a file."""

DEEPEST = 8
"""The most levels of files that use each other."""


class UnrolledFile:
    """One file while its steps are unrolled."""

    def __init__(self, file: WorkflowFile, source: Source, names: tuple[str, ...], *, foreign: bool) -> None:
        self.file, self.source, self.names, self.foreign = file, source, names, foreign
        self.needed = list_keys([entry.args for entry in file.steps])


class Unroller:
    """Unrolls a workflow's steps. Faults go to the report."""

    def __init__(
        self, report: FindingList, finder: FileFinder, defaults: Defaults, carriers: Carriers
    ) -> None:
        self.report, self.finder, self.defaults, self.carriers = report, finder, defaults, carriers
        self.layout = Layout()
        self.pinned: dict[str, str] = {}
        self.contents: dict[str, bytes] = {}
        self._files: dict[str, tuple[WorkflowFile, Source, bool] | None] = {}
        self._entries = 0
        self._full = False
        self._part: AnyPart = MAIN
        self._conditions: tuple[Written, ...] = ()
        self._aside: list[tuple[Leaf, UnrolledFile, Path_]] = []

    def unroll(
        self, file: WorkflowFile, source: Source, payload: Mapping[str, Any], *, foreign: bool
    ) -> Layout:
        """The steps of a workflow for its payload."""
        frame = UnrolledFile(file, source, (), foreign=foreign)
        self._fill_box(self.layout.main, frame, payload)
        if file.on_cancel is not None:
            self._put_way_out(file.on_cancel, frame, payload)
        for leaf, frame, path in self._aside:
            self._put_aside(leaf, frame, path)
        if not self.layout.leaves and not self.report.errors:
            remedy = "Check `when` and the lists of `for_each`, or do not submit it."
            Remarks(source, self.report).error("No step of this workflow is left.", ("steps",), remedy)
        return self.layout

    def _put_way_out(
        self, written: str | list[StepEntry], frame: UnrolledFile, payload: Mapping[str, Any]
    ) -> None:
        """Add the ``on_cancel`` steps, which clear labware away when a run is cancelled."""
        box = self._add_box_aside("on_cancel/")
        self._part = ON_CANCEL
        if isinstance(written, str):
            self._use_file(written, box, frame, ("on_cancel",), payload)
        else:
            self._fill_box(box, frame, payload, ("on_cancel",), written)
        self._part = MAIN

    def _put_aside(self, leaf: Leaf, frame: UnrolledFile, path: Path_) -> None:
        """Add the steps that serve a step: the reset of its module before a retry, and the steps after its
        final failure."""
        entry = leaf.entry
        self._part = leaf.index
        if isinstance(entry.retry, RetryEntry) and entry.retry.reset:
            box = self._add_box_aside(f"{leaf.key}/")
            reset = StepEntry(name="reset", module=entry.module, action="reset")
            self._fill_box(box, frame, leaf.scope, (*path, "retry", "reset"), [reset])
        if isinstance(entry.on_error, RunSteps):
            box = self._add_box_aside(f"{leaf.key}/on_error/")
            at = (*path, "on_error", "run")
            if isinstance(entry.on_error.run, str):
                self._use_file(entry.on_error.run, box, frame, at, leaf.scope)
            else:
                self._fill_box(box, frame, leaf.scope, at, entry.on_error.run)
        self._part = MAIN

    def _add_box_aside(self, prefix: str) -> Box:
        box = Box(prefix)
        self.layout.aside.append(box)
        return box

    def _use_file(
        self, name: str, box: Box, frame: UnrolledFile, at: Path_, scope: Mapping[str, Any]
    ) -> None:
        """Add the steps of a file that uses the payload of the step that it serves."""
        known = self._read(name, frame, at) if name not in frame.names else None
        if known is None:
            if name in frame.names:
                self._add_error(frame, f"The file uses itself: {name}.", at, "Name another file.")
            return
        file, source, foreign = known
        inner = UnrolledFile(file, source, (*frame.names, name), foreign=foreign)
        self._fill_box(box, inner, with_defaults(file, scope))

    def _fill_box(
        self,
        box: Box,
        frame: UnrolledFile,
        scope: Mapping[str, Any],
        at: Path_ = ("steps",),
        entries: Sequence[StepEntry] | None = None,
    ) -> None:
        """Add the entries of a list at the place ``at`` in a file; without ``entries``, all steps of the
        file."""
        entries = frame.file.steps if entries is None else entries
        taken = {entry.name for entry in entries}
        counts: dict[str, int] = {}
        for index, entry in enumerate(entries):
            number = counts[entry.name] = counts.get(entry.name, 0) + 1
            name = entry.name
            if number > 1:
                while (name := f"{entry.name}#{number}") in taken:
                    number += 1
                taken.add(name)
            node = LayoutNode(box.prefix + name, entry, box)
            box.nodes.append(node)
            self.layout.nodes.setdefault(node.key, node)
            self._unroll(node, frame, at if at[-1] == "reset" else (*at, index), scope)

    def _unroll(self, node: LayoutNode, frame: UnrolledFile, path: Path_, scope: Mapping[str, Any]) -> None:
        entry = node.entry
        if not self._is_sound(entry, frame, path):
            return
        elements = self._list_elements(entry, frame, path, scope)
        for number, element in enumerate(elements):
            self._entries += 1
            if self._full or self._is_full(frame, path):
                return
            inner, key = scope, node.key
            if entry.for_each is not None:
                inner, key = {**scope, entry.for_each.item: element}, f"{node.key}[{number + 1}]"
            if not self._is_wanted(node, frame, path, inner):
                continue
            outer = self._conditions
            if _is_later(entry.when):
                self._conditions = (*outer, Written(entry.when, (*path, "when"), inner, node.box))
            if entry.use:
                self._use(node, f"{key}/", frame, path, inner)
            elif _is_transfer(entry):
                self._unroll_transfer(node, key, frame, path, inner)
            else:
                self._place(node, key, frame, path, inner)
            self._conditions = outer

    def _is_full(self, frame: UnrolledFile, path: Path_) -> bool:
        if len(self.layout.leaves) < MOST_STEPS and self._entries <= MOST_ENTRIES:
            return False
        self._full = True
        remedy = "Split it into several runs."
        self._add_error(frame, f"The workflow unrolls to more than {MOST_STEPS} steps.", path, remedy)
        return True

    def _add_error(self, frame: UnrolledFile, message: str, path: Path_, remedy: str) -> None:
        Remarks(frame.source, self.report).error(message, path, remedy)

    def _is_sound(self, entry: StepEntry, frame: UnrolledFile, path: Path_) -> bool:
        """Whether an entry is either a step or the use of a file."""
        if entry.use:
            wrong = sorted(entry.model_fields_set - OF_A_USE)
            for key in wrong:
                what = f"The key {key!r} belongs to a step, and this entry uses a file."
                self._add_error(frame, what, (*path, key), "Write it in the steps of that file.")
            return not wrong
        wrong = sorted(entry.model_fields_set - OF_A_RESCUE) if self._part != MAIN else []
        for key in wrong:
            under = "on_cancel" if self._part == ON_CANCEL else "on_error"
            what = f"A step under `{under}` cannot have {key!r}."
            self._add_error(frame, what, (*path, key), "Leave it out, or do this in steps of the workflow.")
        if wrong:
            return False
        needed = ("action",) if _is_transfer(entry) else ("module", "action")
        missing = [key for key in needed if key not in entry.model_fields_set]
        for key in missing:
            self._add_error(frame, f"The key {key!r} is missing.", (*path, key), f"Add `{key}:`.")
        if "payload" in entry.model_fields_set:
            what = "Only an entry that uses a file has a payload of its own."
            self._add_error(frame, what, (*path, "payload"), "Write the values under `args:`.")
            return False
        return not missing

    def _list_elements(
        self, entry: StepEntry, frame: UnrolledFile, path: Path_, scope: Mapping[str, Any]
    ) -> list[Any]:
        if entry.for_each is None:
            return [None]
        at = (*path, "for_each", "in")
        try:
            found = fill(entry.for_each.in_, scope, frame.needed)
        except SpecError as error:
            self._add_error(frame, f"Step {entry.name!r}: {error.message}", at, error.remedy)
            return []
        if not isinstance(found, list | tuple):
            what = f"Step {entry.name!r}: `for_each` needs a list, and this is not one."
            self._add_error(frame, what, at, "Name a list of the payload: `in: payload.plates`.")
            return []
        return list(found)

    def _is_wanted(
        self, node: LayoutNode, frame: UnrolledFile, path: Path_, scope: Mapping[str, Any]
    ) -> bool:
        """Whether ``when`` includes an entry, as far as the payload decides it."""
        entry = node.entry
        if not entry.when:
            return True
        at = (*path, "when")
        try:
            expression = parse_expression(entry.when)
            roots = {name[0] for name in list_names(expression)}
            if "result" in roots or ("steps" in roots and self._part != MAIN):
                what = f"Step {entry.name!r}: `when` can use only the payload and earlier results."
                self._add_error(frame, what, at, "Name values of the payload: `payload.count > 0`.")
                return False
            if "steps" in roots:
                return True  # it is decided during the run
            decided = evaluate(expression, {"payload": scope})
        except ExpressionError as error:
            self._add_error(frame, f"Step {entry.name!r}: {error.message}", at, error.remedy)
            return False
        if not isinstance(decided, bool):
            what = f"Step {entry.name!r}: `when` is neither true nor false."
            self._add_error(frame, what, at, "Compare the value: `payload.count > 0`.")
            return False
        if not decided:
            node.why_empty = "it is left out by its `when`"
        return decided

    def _unroll_transfer(
        self, node: LayoutNode, key: str, frame: UnrolledFile, path: Path_, scope: Mapping[str, Any]
    ) -> None:
        """Add the steps that carry labware from one station to another, with any arm."""
        entry = node.entry
        try:
            ends = fill(entry.args, scope, frame.needed)
            if set(ends) != {"source", "target"} or not all(isinstance(end, str) for end in ends.values()):
                raise SpecError(
                    "A transfer without a module takes `source` and `target`, two stations.",
                    remedy="Write both below `args:`, or name the `module:`.",
                )
            way = self.carriers.find_way(ends["source"], ends["target"])
        except SpecError as error:
            self._add_error(frame, f"Step {entry.name!r}: {error.message}", (*path, "args"), error.remedy)
            return
        for number, hop in enumerate(way, 1):
            name = key if len(way) == 1 else f"{key}[{number}]"
            change: dict[str, Any] = {"module": hop.module, "action": hop.action, "args": dict(hop.args)}
            if len(way) > 1:
                change["name"] = name
            if number > 1:  # the other parts have waited for everything that the first one waits for
                node.onward.add(len(node.rounds))
                change |= {"wait": [], "within": []}
            if number < len(way):
                change["expect"] = ""
            self._place(node, name, frame, path, scope, entry.model_copy(update=change))

    def _place(
        self,
        node: LayoutNode,
        key: str,
        frame: UnrolledFile,
        path: Path_,
        scope: Mapping[str, Any],
        written: StepEntry | None = None,
    ) -> None:
        """Add a step, as ``written`` or as in its node's entry."""
        if key in self.layout.by_key:
            self._add_error(frame, f"Two steps would be called {key!r}.", path, "Rename one of them.")
            return
        # The reset of a module before a retry is LabOS' own step, without defaults.
        entry = written or node.entry
        entry = entry if path[-1] == "reset" else self.defaults.fill_in(entry, scope)
        leaf = Leaf(
            len(self.layout.leaves), key, entry, scope, frame.needed, (frame.source, path), node,
            foreign=frame.foreign, part=self._part, conditions=self._conditions,
        )  # fmt: skip
        self._aside.append((leaf, frame, path))
        self.layout.leaves.append(leaf)
        self.layout.by_key[key] = leaf
        node.rounds.append(leaf)

    def _use(
        self, node: LayoutNode, prefix: str, frame: UnrolledFile, path: Path_, scope: Mapping[str, Any]
    ) -> None:
        name, at = node.entry.use, (*path, "use")
        if name in frame.names or len(frame.names) >= DEEPEST:
            chain = " → ".join((*frame.names, name))
            what = (
                f"The file uses itself: {chain}."
                if name in frame.names
                else f"Files use each other too deeply: {chain}."
            )
            self._add_error(frame, what, at, "Remove it from one of them.")
            return
        known = self._read(name, frame, at)
        if known is None:
            return
        file, source, foreign = known
        try:
            inner = dict(scope)
            if "payload" in node.entry.model_fields_set:
                inner = {key: fill(value, scope, frame.needed) for key, value in node.entry.payload.items()}
        except SpecError as error:
            self._add_error(
                frame, f"Step {node.entry.name!r}: {error.message}", (*path, "payload"), error.remedy
            )
            return
        if "payload" in node.entry.model_fields_set and not foreign and not node.rounds:
            for key, remedy in find_unused(inner, file, [source], self.finder):
                where = (*path, "payload", key.partition(".")[0])
                self._add_error(frame, f"{name} does not use {key!r} of its payload.", where, remedy)
        box = Box(prefix, node, len(node.rounds))
        node.rounds.append(box)
        self._fill_box(
            box, UnrolledFile(file, source, (*frame.names, name), foreign=foreign), with_defaults(file, inner)
        )

    def _read(self, name: str, frame: UnrolledFile, at: Path_) -> tuple[WorkflowFile, Source, bool] | None:
        """The file of that name, read and checked once."""
        if name in self._files:
            return self._files[name]
        self._files[name] = None
        found = self.finder.find(name)
        if found.content is None:
            remedy = "Put it beside the workflow, or send it along with the run."
            self._add_error(frame, f"The file {name!r} {found.problem}.", at, remedy)
            return None
        path = str(Path(frame.source.file).parent / name) if not frame.names else name
        report = FindingList(path)
        try:
            source = parse_yaml(found.content, path, last_wins=True)
            form, dialect = convert_workflow(source, report)
            file = validate(WorkflowFile, form, report)
            for key in ("hold", "windows", "on_cancel") if file is not None else ():
                if getattr(file, key):
                    what = f"`{key}` is allowed only in the submitted workflow, not in a file that it uses."
                    Remarks(form, report).error(what, (key,), "Write it there.", key=True)
        except SpecError as error:
            self.report.keep_error(error)
            return None
        self.report.take(report)
        if file is None or report.errors:
            return None
        self.pinned[name] = found.digest
        self.contents[found.digest] = found.content
        self._files[name] = (file, form, dialect != "labos")
        return self._files[name]


def _is_transfer(entry: StepEntry) -> bool:
    """Whether a step states what is carried and where, but not the arm."""
    return entry.action == TRANSFER and not entry.module


def _is_later(when: str) -> bool:
    """Whether a condition reads results of steps."""
    return bool(when) and any(name[0] == "steps" for name in list_names(parse_expression(when)))


def with_defaults(file: WorkflowFile, payload: Mapping[str, Any]) -> dict[str, Any]:
    """A payload with the defaults of a file's declared parameters."""
    values = dict(payload)
    for name, parameter in file.parameters.items():
        if not parameter.required and not has_key(name, values):
            values[name] = parameter.default
    return values
