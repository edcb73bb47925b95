"""MADSci's steps, as steps of a LabOS workflow (MADSci 0.8): ``name, metadata, parameters, steps[name, key,
node, action, args, locations, files, use_parameters, data_labels, conditions]``."""

from __future__ import annotations

import re
from typing import Any

from labos.spec.carriers import TRANSFER
from labos.spec.dialects._madsci_parameters import ALIASES, Parameters
from labos.spec.dialects._reader import Reader, is_number
from labos.spec.findings import FindingList, suggest_name
from labos.spec.source import Path_, Source, SourceList, SourceMapping

METADATA = ("definition_metadata", "metadata")
ARGUMENTS = ("args", "arguments")
LOCATIONS = ("locations", "location_args", "location_arguments")
USED = ("use_parameters", "use_params", "params", "parameters")
TRANSFER_RESOURCE = "transfer_resource"
TRANSFER_CONTENTS = "transfer_location_contents"
TRANSFERS = {
    TRANSFER: {"destination": "target", "source_location_id": "source", "destination_location_id": "target"},
    TRANSFER_CONTENTS: {"source_location_id": "source", "destination_location_id": "target"},
    TRANSFER_RESOURCE: {},
}
"""Actions that MADSci's workcell manager carries out itself, with their arguments by LabOS' names."""
_FIELD = re.compile(r"[\w\-]+")


def is_workflow(source: Source) -> bool:
    """Whether the file's steps are MADSci's: none of them names a module, or another file."""
    steps = source.data.get("steps")
    if "labos" in source.data or not isinstance(steps, SourceList):
        return False
    tables = [step for step in steps if isinstance(step, SourceMapping)]
    return bool(tables) and not any("module" in step or "use" in step for step in tables)


def rewrite_workflow(source: Source, report: FindingList) -> Source:
    """Rewrite a workflow file. Raises SpecError for an unknown form."""
    return _Workflow(source, report).make_form()


class _Workflow:
    def __init__(self, source: Source, report: FindingList) -> None:
        self.reader = reader = Reader(source, report)
        self.source, self.data = source, source.data
        self.parameters = Parameters(reader)
        rows = reader.expect_sequence(source.data["steps"], ("steps",), "the steps")
        self.steps = [reader.expect_table(row, ("steps", n), "A step") for n, row in enumerate(rows)]
        self.names = self._list_references()
        self.pause: tuple[float, int] | None = None
        """Seconds to wait before the next step, and the step after which they begin."""

    def make_form(self) -> Source:
        data = self.data
        out = SourceMapping(data.at)
        metadata = SourceMapping(data.at)
        for key in METADATA:
            if data.get(key) is not None:
                metadata = self.reader.expect_table(data[key], (key,), f"`{key}`")
        self.reader.take_name(out, metadata)
        if isinstance(data.get("description"), str):
            out.take(data, "description")
        out.put("metadata", metadata)
        at = self.source.place(("steps",))
        steps = SourceList(at)
        last: int | None = None
        moved: dict[str, str] = {}
        for index, step in enumerate(self.steps):
            moved[f"steps[{index}]"] = f"steps[{len(steps)}]"
            form = self._step(index, step, last)
            if form is not None:
                steps.put(form, step.at)
                last = index
        if self.pause is not None:
            self.reader.add_warning(
                "The wait at the end has no effect; it is left out.",
                ("steps", len(self.steps) - 1),
                "Add a step.",
            )
        parameters = self.parameters.make_form(data.at)
        if parameters:
            out.put("parameters", parameters, *data.find_places("parameters"))
        out.put("steps", steps, *data.find_places("steps"))
        known = {"name", "description", "steps", "workflow_definition_id", *METADATA, *ALIASES}
        self.reader.ignore_others(data, known)
        done = self.reader.finish(out)
        done.moved = moved
        return done

    def _list_references(self) -> list[str]:
        """The reference to each step: its name, and its number among steps of the same name."""
        names = [self._find_name(step, n) for n, step in enumerate(self.steps)]
        return [
            f"{name}#{names[: n + 1].count(name)}" if names.count(name) > 1 else name
            for n, name in enumerate(names)
        ]

    @staticmethod
    def _find_name(step: SourceMapping, index: int) -> str:
        for key in ("name", "key", "step_key", "action"):
            if isinstance(step.get(key), str) and step[key]:
                return str(step[key])
        return f"step {index + 1}"

    # -- a step ------------------------------------------------------------------------------

    def _step(self, index: int, step: SourceMapping, last: int | None) -> SourceMapping | None:
        path: Path_ = ("steps", index)
        used_key = next((key for key in USED if step.get(key) is not None), "")
        used = self.reader.expect_table(step.get(used_key), (*path, used_key), f"`{used_key}`")
        arguments = self._arguments(index, step, used, used_key)
        node = self._find_named(step, used, "node", (*path, used_key))
        action = self._find_named(step, used, "action", (*path, used_key))
        self._ignore_unused(step, used, path, used_key)
        if action is None:
            raise self.source.error("A step has no action.", path, remedy="Write `action:`.")
        if node is None and action[0] in TRANSFERS:
            arguments = self._read_transfer(action[0], arguments, path)
            action = (TRANSFER, action[1])
        elif node is None:
            self._wait(action[0], arguments, path, last)
            return None
        out = SourceMapping(step.at)
        name_at = step.find_places("name")
        out.put("name", self._find_name(step, index), *name_at)
        if node is not None:
            out.put("module", node[0], *node[1])
        out.put("action", action[0], *action[1])
        out.put("args", arguments)
        for key in ("description", "comment"):
            if isinstance(step.get(key), str) and "comment" not in out:
                out.take(step, key, "comment")
        if self.pause is not None:
            seconds, after = self.pause
            out.put("wait", SourceMapping(step.at, {"after": self.names[after], "at_least": seconds}))
            self.pause = None
        return out

    def _find_named(
        self, step: SourceMapping, used: SourceMapping, key: str, path: Path_
    ) -> tuple[str, Any] | None:
        """The node or action with its places. If a parameter decides it, it comes from the payload."""
        if used.get(key) is None:
            return None if step.get(key) is None else (str(step[key]), step.find_places(key))
        parameter = used[key]
        if isinstance(parameter, SourceMapping):
            parameter = self.parameters.declare(parameter, (*path, key))
        if str(parameter) in self.parameters.forward:
            raise self.source.error(
                f"The {key} comes from an earlier step, but it must be known before the run.",
                (*path, key),
                remedy=f"Write `{key}:` itself, or take it from an input.",
            )
        return self._read_value(0, parameter, (*path, key)), used.find_places(key)

    def _arguments(
        self, index: int, step: SourceMapping, used: SourceMapping, used_key: str
    ) -> SourceMapping:
        path: Path_ = ("steps", index)
        out = SourceMapping(step.at)
        for key in ARGUMENTS:
            for name, value, at in self.reader.iterate_entries(step.get(key), (*path, key), f"`{key}`"):
                if value is not None:
                    self._put(out, name, self._literal(value), at)
        for key in LOCATIONS:
            for name, value, at in self.reader.iterate_entries(step.get(key), (*path, key), f"`{key}`"):
                if value is not None:
                    self._put(out, name, self._read_location(value, at), at)
        for name, value, at in self.reader.iterate_entries(step.get("files"), (*path, "files"), "`files`"):
            self._put(out, name, self._read_value(index, value, at), at)
        for group in (*ARGUMENTS, *LOCATIONS):
            for name, value, at in self.reader.iterate_entries(
                used.get(group), (*path, used_key, group), f"`{group}`"
            ):
                self._put(out, name, self._read_value(index, value, at), at)
        return out

    def _put(self, out: SourceMapping, name: str, value: Any, path: Path_) -> None:
        if name in out:
            raise self.source.error(
                f"The argument {name!r} is given twice.", path, key=True, remedy="Remove one of them."
            )
        out.put(name, value, self.source.place(path, key=True), self.source.place(path))

    def _literal(self, value: Any) -> Any:
        """Early files write ``$x`` for an input, as WEI does."""
        if isinstance(value, str) and value.startswith("$") and value[1:] in self.parameters.inputs:
            return f"payload.{value[1:]}"
        return value

    def _read_location(self, value: Any, path: Path_) -> str:
        if isinstance(value, SourceMapping):
            value = value.get("location_name")
        if not isinstance(value, str):
            raise self.source.error(
                "The location has no name; joint angles do not show which station it is.",
                path,
                remedy="Write the name of a location of the workcell.",
            )
        return value

    def _read_value(self, index: int, parameter: Any, path: Path_) -> str:
        """The reference of an argument: to the payload, or to the result of an earlier step."""
        if isinstance(parameter, SourceMapping):
            parameter = self.parameters.declare(parameter, path)
        key = str(parameter).removeprefix("$")
        if key in self.parameters.inputs:
            return f"payload.{key}"
        if key in self.parameters.forward:
            return self._read_source(index, *self.parameters.forward[key])
        known = [*self.parameters.inputs, *self.parameters.forward]
        raise self.source.error(
            f"The parameter {key!r} is not declared.", path, remedy=suggest_name(key, known, "parameter")
        )

    def _read_source(self, index: int, entry: SourceMapping, path: Path_) -> str:
        step, label = entry.get("step"), entry.get("label")
        found = self._find_labelled(index, label) if step is None else self._find_step(step)
        if found is None or not self._has_node(found):
            raise self.source.error(
                f"No step gives {label or step!r} before step {self.names[index]!r}.",
                path,
                remedy="Name an earlier step's key under `step:`.",
            )
        labels = self.steps[found].get("data_labels")
        if isinstance(labels, SourceMapping):
            label = next((output for output, name in labels.items() if name == label), label)
        result = f"steps.{self.names[found]}.result"
        if entry.get("parameter_type") == "feed_forward_file":
            result = f"{result}.files"
        if label is None or label == "json_result":
            return result
        if not _FIELD.fullmatch(str(label)):
            raise self.source.error(
                f"The label {label!r} cannot be a field of a result.", path, remedy="Use a plain word."
            )
        return f"{result}.{label}"

    def _has_node(self, index: int) -> bool:
        """Whether a node carries out the step: only then does it return a result."""
        step = self.steps[index]
        used = [step[key] for key in USED if isinstance(step.get(key), SourceMapping)]
        return step.get("node") is not None or any("node" in table for table in used)

    def _find_labelled(self, index: int, label: Any) -> int | None:
        """The last step before this one with this label for a result."""
        for number in reversed(range(index)):
            labels = self.steps[number].get("data_labels")
            if isinstance(labels, SourceMapping) and label in labels.values():
                return number
        return None

    def _find_step(self, step: Any) -> int | None:
        if is_number(step):
            return int(step) if 0 <= step < len(self.steps) else None
        keys = [candidate.get("key") or candidate.get("step_key") for candidate in self.steps]
        if step in keys:
            return keys.index(step)
        names = [candidate.get("name") for candidate in self.steps]
        return names.index(step) if step in names else None

    # -- what LabOS does otherwise -----------------------------------------------------------

    def _read_transfer(self, action: str, arguments: SourceMapping, path: Path_) -> SourceMapping:
        """The arguments of a transfer without a node, in LabOS' form."""
        if action == TRANSFER_RESOURCE:
            target = arguments.get("destination_location_id", "where it goes")
            raise self.source.error(
                "The step names a resource of MADSci, but LabOS does not know its location.",
                (*path, "action"),
                remedy="Write `action: transfer`, and as arguments `source:` with its location at that "
                f"time, and `target: {target}`.",
            )
        out = SourceMapping(arguments.at)
        for name, value in arguments.items():
            if name == "await_completion":
                if value is False:
                    self.reader.add_warning(
                        "The next step begins when the transfer has ended.",
                        path,
                        "Leave it out, or say `after:`.",
                    )
                continue
            out.put(TRANSFERS[action].get(name, name), value, *arguments.find_places(name))
        if action == TRANSFER_CONTENTS:
            self.reader.add_warning(
                "One piece of labware is moved: from a stack, the one on top.",
                path,
                "Repeat the step if the location holds more.",
            )
        return out

    def _wait(self, action: str, arguments: SourceMapping, path: Path_, last: int | None) -> None:
        """A step of the workcell itself. A wait is added to the step after it; other such steps are
        refused."""
        if action != "wait":
            raise self.source.error(
                f"The step names no node, and LabOS has no action {action!r} of its own.",
                (*path, "action"),
                remedy="Write `node:` with the arm or instrument that does it.",
            )
        seconds: Any = arguments.get("seconds")
        if isinstance(seconds, str) and seconds.startswith("payload."):
            seconds = self.parameters.find_default(seconds.removeprefix("payload."))
            self.reader.add_warning(
                "The time to wait is the parameter's default.", path, "Write the seconds."
            )
        if not is_number(seconds) or seconds < 0:
            raise self.source.error("The step does not say how long.", path, remedy="Write `seconds:`.")
        if last is None:
            self.reader.add_warning(
                "The wait at the start has no effect; it is left out.", path, "Remove it."
            )
            return
        self.pause = (seconds + (self.pause[0] if self.pause else 0), last)

    def _ignore_unused(self, step: SourceMapping, used: SourceMapping, path: Path_, used_key: str) -> None:
        known = {
            "name",
            "key",
            "step_key",
            "description",
            "comment",
            "action",
            "node",
            "files",
            "data_labels",
        }
        known |= {*ARGUMENTS, *LOCATIONS, used_key}
        for key, value in step.items():
            if key == "conditions" and value:
                self.reader.ignore((*path, key), "contains conditions; LabOS itself checks where labware is")
            elif key not in known and value is not None:
                self.reader.ignore((*path, key))
        for key, value in used.items():
            if key not in {"action", "node", *ARGUMENTS, *LOCATIONS} and value is not None:
                self.reader.ignore((*path, used_key, key))
