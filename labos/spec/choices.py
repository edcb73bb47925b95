"""Steps that one of several modules may do: ``module: any ot2``, ``module: any ot2_a, ot2_b``.

The workflow is compiled once for each choice. In each of these plans, a step with ``same as`` has the module
of the step that it names. ``${<step>.module}`` in arguments is the name of that module.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import prod
from typing import Any

import msgspec

from labos.core.decide.choices import MOST_PLANS
from labos.core.ids import local
from labos.core.model import Plan, Workcell
from labos.spec.findings import Remarks, suggest_name
from labos.spec.models import ANY_OF, SAME_AS, RunSteps, StepEntry, WorkflowFile
from labos.spec.references import change_texts, iterate_texts
from labos.spec.source import Path_

_MODULE_OF = re.compile(r"\$\{(?!payload[.:])([^{}]+)\.module\}")


class BoundWorkflow(msgspec.Struct, frozen=True):
    """A workflow in which each step has one module, and the chosen modules by the steps' names."""

    file: WorkflowFile
    chosen: dict[str, str] = {}


def bind_modules(file: WorkflowFile, workcell: Workcell, remarks: Remarks) -> list[BoundWorkflow]:
    """The workflow, once for each choice of modules; unchanged if there is no choice. Faults go to the
    remarks."""
    known = {local(module.name): module.driver for module in workcell.modules}
    choices: dict[str, Sequence[str]] = {}
    for path, entry in file.iterate_entries():
        if entry.module in known:
            continue
        if entry.module.startswith(ANY_OF) and not _is_step(path):
            remarks.error(
                f"Step {entry.name!r} is for an emergency and has no choice of modules.",
                (*path, "module"),
                "Name the module, or the step of the workflow that it goes with: `module: same as <step>`.",
            )
        elif entry.module.startswith(ANY_OF):
            choices[entry.name] = _list_modules_meant(entry, (*path, "module"), known, remarks)
    count = prod(len(names) for names in choices.values())
    if count > MOST_PLANS:
        remarks.error(
            f"There are {count} ways to choose the modules of this workflow; {MOST_PLANS} are allowed.",
            ("steps",),
            "Name fewer modules, or let steps go together: `module: same as <step>`.",
        )
    references = _check_references(file, known, remarks)
    if remarks.report.errors or not (choices or references):
        return [BoundWorkflow(file)]
    combinations = product(*choices.values())
    return [_bind(file, dict(zip(choices, names, strict=True)), known) for names in combinations]


def list_choices(plans: Sequence[Plan]) -> dict[str, list[str]]:
    """The modules among which the plans choose, by the key of the step."""
    found: dict[str, list[str]] = {}
    for steps in zip(*(plan.steps for plan in plans), strict=True):
        names = list(dict.fromkeys(local(step.module) for step in steps))
        if len(names) > 1:
            found[steps[0].key] = names
    return found


def describe_choices(choices: Mapping[str, Sequence[str]]) -> list[str]:
    """One sentence for each group of steps with the same possible modules."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for key, names in choices.items():
        groups.setdefault(tuple(names), []).append(repr(key))
    return [f"By {_join_names(names)}: {', '.join(keys)}." for names, keys in groups.items()]


def expand_lists(file: WorkflowFile) -> list[WorkflowFile]:
    """The workflow, once for each choice between modules that it names, independent of the workcell."""
    choices = {
        entry.name: names
        for _, entry in file.iterate_entries()
        if entry.module.startswith(ANY_OF) and "," in entry.module and (names := _split_names(entry.module))
    }
    if not choices or prod(map(len, choices.values())) > MOST_PLANS:
        return [file]
    return [
        _bind(file, dict(zip(choices, names, strict=True)), {}).file for names in product(*choices.values())
    ]


def is_left_open(entry: StepEntry) -> bool:
    """Whether the module of a step, or of a place in its arguments, depends on the workcell."""
    return entry.module.startswith((ANY_OF, SAME_AS)) or any(
        _list_steps_meant(v) for _, v in _list_values(entry)
    )


def _join_names(names: Sequence[str]) -> str:
    return " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _split_names(module: str) -> list[str]:
    return list(
        dict.fromkeys(name.strip() for name in module.removeprefix(ANY_OF).split(",") if name.strip())
    )


def _list_modules_meant(
    entry: StepEntry, path: Path_, known: Mapping[str, str], remarks: Remarks
) -> Sequence[str]:
    """The possible modules of a step with ``any``: those that it lists, or all with the driver."""
    names = _split_names(entry.module)
    if len(names) == 1 and "," not in entry.module:
        found = [name for name, driver in known.items() if driver == names[0]]
        if not found:
            remarks.error(
                f"Step {entry.name!r}: no module of the workcell has the driver {names[0]!r}.",
                path,
                f"{suggest_name(names[0], known.values(), 'driver')} Or list modules: `{{any: [a, b]}}`.",
            )
        return found
    for name in names:
        if name not in known:
            remarks.error(
                f"Step {entry.name!r}: there is no module {name!r} to choose.",
                path,
                suggest_name(name, known, "module"),
            )
    return names


def _check_references(file: WorkflowFile, known: Mapping[str, str], remarks: Remarks) -> bool:
    """Check the references of steps to the modules of other steps."""
    names = [entry.name for path, entry in file.iterate_entries() if _is_step(path) and entry.module]
    found = False
    for path, entry in file.iterate_entries():
        references = [
            (name, (*path, where))
            for where, value in _list_values(entry)
            for name in _list_steps_meant(value)
        ]
        if entry.module.startswith(SAME_AS) and entry.module not in known:
            references.append((entry.module.removeprefix(SAME_AS).strip(), (*path, "module")))
        for name, at in references:
            found = True
            _check_reference(entry, name, at, names, remarks)
    for key in file.hold:
        for name in _list_steps_meant(key):
            found = True
            if name not in names:
                remarks.error(
                    f"There is no step {name!r}.", ("hold", key), suggest_name(name, names, "step"), key=True
                )
    return found


def _check_reference(entry: StepEntry, name: str, at: Path_, names: Sequence[str], remarks: Remarks) -> None:
    if name == entry.name and at[-1] == "module":
        remarks.error(f"Step {name!r} refers to itself for its module.", at, "Name another step.")
    elif name not in names:
        remarks.error(
            f"Step {entry.name!r}: there is no step {name!r} with a module.",
            at,
            suggest_name(name, names, "step"),
        )
    elif names.count(name) > 1:
        remarks.error(
            f"Step {entry.name!r}: several steps are called {name!r}.", at, "Give each its own name."
        )


def _is_step(path: Path_) -> bool:
    """Whether an entry is a step of the workflow itself, and not one for failures or cancellation."""
    return path[0] == "steps" and len(path) == 2


def _list_values(entry: StepEntry) -> Iterable[tuple[str, Any]]:
    return (("args", entry.args), ("payload", entry.payload))


def _list_steps_meant(value: Any) -> list[str]:
    """The steps to whose modules a value refers."""
    return [name for text in iterate_texts(value) for name in _MODULE_OF.findall(text)]


def _bind(file: WorkflowFile, chosen: Mapping[str, str], known: Mapping[str, str]) -> BoundWorkflow:
    modules = {
        e.name: chosen.get(e.name, e.module) for p, e in file.iterate_entries() if _is_step(p) and e.module
    }
    for _ in modules:  # a step may refer to one that itself refers to a third
        for name, module in modules.items():
            if module.startswith(SAME_AS) and module not in known:
                modules[name] = modules.get(module.removeprefix(SAME_AS).strip(), module)

    def fill(text: str) -> str:
        return _MODULE_OF.sub(lambda found: modules.get(found[1], found[0]), text)

    def bind(entry: StepEntry, *, own: bool) -> StepEntry:
        module = entry.module
        if own and entry.name in modules and module:
            module = modules[entry.name]
        elif module.startswith(SAME_AS) and module not in known:
            module = modules.get(module.removeprefix(SAME_AS).strip(), module)
        change: dict[str, Any] = {"module": module} if module != entry.module else {}
        for name, value in _list_values(entry):
            if (filled := change_texts(value, fill)) != value:
                change[name] = filled
        if isinstance(entry.on_error, RunSteps) and isinstance(entry.on_error.run, list):
            inner = [bind(each, own=False) for each in entry.on_error.run]
            if inner != entry.on_error.run:
                change["on_error"] = entry.on_error.model_copy(update={"run": inner})
        return entry.model_copy(update=change) if change else entry

    changed: dict[str, Any] = {"steps": [bind(entry, own=True) for entry in file.steps]}
    if isinstance(file.on_cancel, list):
        changed["on_cancel"] = [bind(entry, own=False) for entry in file.on_cancel]
    changed["hold"] = {fill(key): value for key, value in file.hold.items()}
    return BoundWorkflow(file.model_copy(update=changed), dict(chosen))
