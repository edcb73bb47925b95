"""Builds the steps of a plan: targets, arguments, files, effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from labos.core.amounts import find_duration_s
from labos.core.effects import (
    AnyEffect,
    Consumes,
    Draws,
    Move,
    Replaces,
    Take,
    Transfers,
    list_carried,
    list_moved,
    resolve,
)
from labos.core.expiry import DATE
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import (
    MAIN,
    ON_CANCEL,
    ActionSpec,
    Description,
    ModuleSpec,
    OnError,
    Plan,
    PlanStep,
    Retry,
    Workcell,
)
from labos.core.wells import list_doses
from labos.errors import SpecError
from labos.spec.about import describe_modules
from labos.spec.amounts import compute_amount, list_arguments
from labos.spec.arguments import bind, is_later
from labos.spec.bench import BenchFile
from labos.spec.conditions import StepConditions
from labos.spec.defaults import find_timeout
from labos.spec.dryrun import DryRun
from labos.spec.files import FileFinder
from labos.spec.findings import Remarks, suggest_name
from labos.spec.holds import make_holds
from labos.spec.layout import Layout
from labos.spec.models import ANY_OF, SAME_AS, RetryEntry, RunSteps, StepEntry, WorkflowFile
from labos.spec.plan_check import InitialBench, PlanCheck
from labos.spec.references import fill, find_result
from labos.spec.source import Path_, Source
from labos.spec.stations import Stations
from labos.spec.steps import Steps
from labos.spec.tables import find_counter


class CompileInputs(msgspec.Struct):
    """The data for compiling a workflow, besides the workflow itself; the options are those of
    ``compile_workflow``."""

    source: Source
    form: Source
    foreign: bool
    payload: Mapping[str, Any]
    workcell: Workcell
    descriptions: Mapping[str, Description]
    finder: FileFinder
    simulate: bool
    bench: BenchFile | None
    left_out: Mapping[str, str]


class StepPlanner:
    """Makes a plan from one workflow."""

    def __init__(self, file: WorkflowFile, layout: Layout, remarks: Remarks, given: CompileInputs) -> None:
        self.file, self.layout, self.remarks, self.given = file, layout, remarks, given
        self.workcell = workcell = given.workcell
        self.stations = Stations(workcell.name, workcell.stations)
        self.modules = {local(module.name): module for module in workcell.modules}
        self.described = describe_modules(workcell, given.descriptions)
        self.steps = Steps(layout, remarks)
        self.feeds: set[int] = set()
        self.conditions = StepConditions(self.steps, self.feeds)
        self.pinned: dict[str, str] = {}
        self.contents: dict[str, bytes] = {}

    def plan(self) -> Plan:
        """The plan. It is complete only if the report has no errors afterwards."""
        self._check_modules()
        steps = tuple(self._make_step(index, entry) for index, entry in enumerate(self.steps.entries))
        steps = tuple(self._take_from_stacks(index, step, steps) for index, step in enumerate(steps))
        claims = {station.name: station.claim for station in self.workcell.stations if station.claim}
        return Plan(
            workflow=self.file.name,
            workcell=self.workcell.name,
            steps=steps,
            feeds=tuple(sorted(self.feeds)),
            files=self.pinned,
            holds=make_holds(self.file.hold, self.modules, claims, self.steps, steps, self.remarks),
        )

    def _take_from_stacks(self, index: int, step: PlanStep, steps: Sequence[PlanStep]) -> PlanStep:
        """An arm that carries labware from a stack takes its topmost piece, unless an earlier step has put a
        piece there. After a failure or a cancellation, it carries the run's own labware, wherever that is."""
        if step.part != MAIN:
            return step
        put_there = {
            what.target
            for before in self.steps.list_before(index)
            for what in list_carried(steps[before].effects)
        }
        effects = tuple(
            Take(effect.source, effect.target)
            if type(effect) is Move and effect.source not in put_there and self._is_stack(effect.source)
            else effect
            for effect in step.effects
        )
        return msgspec.structs.replace(step, effects=effects) if effects != step.effects else step

    def _is_stack(self, station: StationName) -> bool:
        return station in self.stations and self.stations[station].kind == "stack"

    def do_dry_run(self, plan: Plan) -> tuple[Plan, DryRun]:
        """Carry out a dry run. Returns also the plan in which only steps may be skipped for which this is
        possible."""
        modules = {module.name: module for module in self.modules.values()}
        labware = {kind.name: kind for kind in self.workcell.labware}
        bench = InitialBench(self.stations, modules, self.given.bench, labware)
        return PlanCheck(bench, self.steps, self.remarks).do_dry_run(plan)

    def _check_modules(self) -> None:
        """Check that every module that the workflow lists is in the workcell, and that every used one is
        listed."""
        listed = self.file.modules
        if listed is None:
            return
        for index, name in enumerate(listed):
            if name not in self.modules:
                self.remarks.add_warning(
                    f"The workcell {self.workcell.name!r} has no module {name!r}.",
                    ("modules", index),
                    suggest_name(name, self.modules, "module"),
                )

    # -- a step ------------------------------------------------------------------------------

    def _make_step(self, index: int, entry: StepEntry) -> PlanStep:
        path: Path_ = ("steps", index)
        settled = self._fill_step(index, entry, path)
        if settled is None:
            return PlanStep(self.steps.keys[index], ModuleName(""), entry.action)
        entry = settled
        module = self._find_module(entry, path)
        blank = PlanStep(self.steps.keys[index], module.name if module else ModuleName(""), entry.action)
        if module is None:
            return blank
        action = self._find_action(module, entry, path)
        if action is None:
            return blank
        args = self._make_arguments(index, entry, module, action, path)
        if args is None:
            return blank
        action = self._set_duration(action, args, entry, path)
        return PlanStep(
            key=self.steps.keys[index],
            module=module.name,
            action=action.name,
            args=args,
            after=self._find_after(index),
            effects=self._make_effects(module, action, args, entry, path),
            duration_s=action.duration_s,
            safe_to_repeat=action.safe_to_repeat,
            exclusive=action.exclusive,
            windows=self.steps.windows[index],
            recovers=action.recovers,
            retry=self._retry(index, entry),
            timeout_s=find_timeout(entry, action, self.remarks, path),
            by_person=action.by_person,
            on_error=self._on_error(index, entry, module),
            part=self.layout.leaves[index].part,
            when=self.conditions.find_condition(index),
            expect=self.conditions.expect(index),
            dangerous=action.dangerous if module.second_person else "",
            hazard=action.dangerous,
        )

    def _find_after(self, index: int) -> tuple[int, ...]:
        """The steps for which a step waits. Any of the ``on_cancel`` steps may be left out, so each waits for
        all before it."""
        if self.layout.leaves[index].part == ON_CANCEL:
            return tuple(sorted(self.steps.list_before(index)))
        return self.steps.after[index]

    def _set_duration(
        self, action: ActionSpec, args: dict[str, Any], entry: StepEntry, path: Path_
    ) -> ActionSpec:
        """The action with its duration for the arguments and files of this step."""
        values = {arg.name: args.get(arg.name, arg.default) for arg in action.args}
        known = {name: None if is_later(value) else value for name, value in values.items()}
        try:
            duration_s = find_duration_s(action, known, self._count_seconds)
        except SpecError as error:
            self._report(error, entry, path)
            return action
        return msgspec.structs.replace(action, duration_s=duration_s)

    def _count_seconds(self, text: str, values: Mapping[str, Any]) -> float:
        return compute_amount(text, values, self._find_content).amount

    def _retry(self, index: int, entry: StepEntry) -> Retry | None:
        if not isinstance(entry.retry, RetryEntry):
            return None
        aside = self.layout.by_key.get(f"{self.steps.keys[index]}/reset") if entry.retry.reset else None
        return Retry(entry.retry.times, entry.retry.delay, aside.index if aside is not None else None)

    def _on_error(self, index: int, entry: StepEntry, module: ModuleSpec) -> OnError | None:
        """The reaction to a failure of the step, from its own entry or else from its module's entry."""
        written = entry.on_error
        if isinstance(written, RunSteps):
            return OnError("run", written.then)
        default = module.on_error if self.layout.leaves[index].part == MAIN else ""
        do = written or default or "fail"
        return None if do == "fail" else OnError(do, may_skip=True)

    def _fill_step(self, index: int, entry: StepEntry, path: Path_) -> StepEntry | None:
        """The step with its module and action, which may come from the payload; None if it has faults."""
        found: dict[str, str] = {}
        for key in ("module", "action"):
            try:
                value = fill(getattr(entry, key), self.layout.leaves[index].scope)
                if not isinstance(value, str):
                    raise SpecError(f"The {key} is not a text.", remedy=f"Give the name of the {key}.")
                found[key] = value
            except SpecError as error:
                self.remarks.error(f"Step {entry.name!r}: {error.message}", (*path, key), error.remedy)
        return entry.model_copy(update=found) if len(found) == 2 else None

    def _find_module(self, entry: StepEntry, path: Path_) -> ModuleSpec | None:
        name = entry.module.removeprefix(f"{self.workcell.name}/")
        module = self.modules.get(name)
        if module is None and name in self.given.left_out:
            message = f"Step {entry.name!r}: the module {name!r} is left out: {self.given.left_out[name]}."
            remedy = "Switch it on in the workcell file, give it a `driver:` or describe it below `about:`."
            self.remarks.error(message, (*path, "module"), remedy)
        elif module is None and name.startswith((ANY_OF, SAME_AS)):
            message = f"Step {entry.name!r}: `{name}` is allowed only in the submitted workflow."
            remedy = "Pass the module in the payload: `module: ${step.module}`; here `payload.module`."
            self.remarks.error(message, (*path, "module"), remedy)
        elif module is None:
            message = f"Step {entry.name!r}: there is no module {entry.module!r} in {self.workcell.name!r}."
            self.remarks.error(message, (*path, "module"), suggest_name(name, self.modules, "module"))
        elif module.name not in self.described:
            message = (
                f"Step {entry.name!r}: the driver {module.driver!r} of {entry.module!r} is not installed."
            )
            self.remarks.error(message, (*path, "module"), "Install the package that offers it.")
            return None
        return module

    def _find_action(self, module: ModuleSpec, entry: StepEntry, path: Path_) -> ActionSpec | None:
        description = self.described[module.name]
        action = description.action(entry.action)
        if action is None:
            known = [name for action in description.actions for name in (action.name, *action.aliases)]
            self.remarks.error(
                f"Step {entry.name!r}: {entry.module} has no action {entry.action!r}.",
                (*path, "action"),
                suggest_name(entry.action, known, "action"),
            )
        return action

    # -- arguments ---------------------------------------------------------------------------

    def _make_arguments(
        self, index: int, entry: StepEntry, module: ModuleSpec, action: ActionSpec, path: Path_
    ) -> dict[str, Any] | None:
        """The arguments in the form that the node gets; None if they have faults."""
        faults = self.remarks.report.errors
        written: dict[str, Any] = {}
        broken: set[str] = set()
        for name, value in entry.args.items():
            at = (*path, "args", name)
            try:
                written[name] = self._make_value(index, value, at)
            except SpecError as error:
                self.remarks.error(
                    f"Step {entry.name!r}, argument {name!r}: {error.message}", at, error.remedy
                )
                written[name] = None
                broken.add(name)
        known = {alias for arg in action.args for alias in (arg.name, *arg.aliases)}
        if self.layout.leaves[index].foreign:
            for name in [name for name, value in entry.args.items() if value is None and name not in known]:
                del written[name]

        taught = _find_taught(module)

        def add_finding(name: str, message: str, remedy: str) -> None:
            if name not in broken:
                if close := _find_nearly_same(taught, written.get(name)):
                    message = f"{message.rstrip('.')}; {close}."
                at = (*path, "args", name) if name else (*path, "args")
                unknown = bool(name) and name not in known
                self.remarks.error(f"Step {entry.name!r}: {message}", at, remedy, key=unknown)

        args = bind(action, _with_places(taught, action, written), add_finding)
        for arg in action.args:
            value = args.get(arg.name)
            at = (*path, "args", *[name for name in entry.args if name in (arg.name, *arg.aliases)][:1])
            if arg.type == "file" and isinstance(value, dict) and is_later(value):
                args[arg.name] = {**value, "$file": True}
            if not isinstance(value, str) or not value:
                continue
            if arg.type == "station":
                args[arg.name] = self._place(value, module, entry, at)
            elif arg.type == "file":
                args[arg.name] = self.given.finder.find_full_name(value)
                self._pin(args[arg.name], entry, at)
        if self.remarks.report.errors == faults:
            self._choose_grips(module, action, args)
            return args
        return None

    def _choose_grips(self, module: ModuleSpec, action: ActionSpec, args: dict[str, Any]) -> None:
        """If a grip is not written and its station allows only one, that grip is used."""
        known = {arg.name: arg for arg in action.args}
        for effect in list_moved(action.effects):
            for place, grip in ((effect.source, effect.source_grip), (effect.target, effect.target_grip)):
                arg = known.get(grip.strip("{}"))
                where = args.get(place.strip("{}"))
                if arg is None or args.get(arg.name) or not isinstance(where, str):
                    continue
                found = self.stations.find(where, local(module.name))
                grips = self.stations[found].reach.get(module.name, ())
                if len(grips) == 1 and (not arg.choices or grips[0] in arg.choices):
                    args[arg.name] = grips[0]

    def _make_value(self, index: int, value: Any, path: Path_) -> Any:
        reference = find_result(value)
        if reference is not None:
            return self._make_result(index, reference, path)
        leaf = self.layout.leaves[index]
        filled = fill(value, leaf.scope, leaf.needed)
        if _holds_result(filled):
            raise SpecError(
                "A step's result must be the whole argument.",
                remedy="Write `steps.<name>.result` as the argument's own value.",
            )
        return filled

    def _make_result(self, index: int, reference: tuple[str, list[str]], path: Path_) -> Any:
        name, fields = reference
        step = self.steps.find(name, path)
        if step is None:
            return {"$result": [index, *fields]}
        if step not in self.steps.list_before(index):
            raise SpecError(
                f"The step {name!r} is not done before this one.",
                remedy="Refer to an earlier step, or add it under `after:`.",
            )
        self.feeds.add(step)
        return {"$result": [step, *fields]}

    def _place(self, text: str, module: ModuleSpec, entry: StepEntry, path: Path_) -> str:
        try:
            found = self.stations.find(text, local(module.name))
            hotel = self.stations[found].hotel
            if hotel:
                raise SpecError(
                    f"{local(found)} is a shelf of {local(hotel)}, which LabOS chooses when the step starts.",
                    remedy=f"Write {local(hotel)}.",
                )
            return local(found)
        except SpecError as error:
            self.remarks.error(f"Step {entry.name!r}: {error.message}", path, error.remedy)
            return text

    def _pin(self, name: str, entry: StepEntry, path: Path_) -> None:
        found = self.given.finder.find(name)
        if found.content is not None:
            self.pinned[name] = found.digest
            self.contents[found.digest] = found.content
            return
        message = f"Step {entry.name!r}: the file {name!r} {found.problem}."
        if self.given.simulate:
            self.remarks.add_warning(message, path, "It is needed on the real bench.")
        else:
            self.remarks.error(message, path, "Put it beside the workflow, or send it along with the run.")

    def _find_content(self, name: str) -> bytes | None:
        """The pinned content of a file; None if it was not found, which was reported before."""
        return self.contents.get(self.pinned.get(name, ""))

    # -- effects -----------------------------------------------------------------------------

    def _make_effects(
        self, module: ModuleSpec, action: ActionSpec, args: dict[str, Any], entry: StepEntry, path: Path_
    ) -> tuple[AnyEffect, ...]:
        values = {
            arg.name: args.get(arg.name, "" if arg.default is None else arg.default) for arg in action.args
        }
        later = {name for name, value in values.items() if is_later(value)}
        effects: list[AnyEffect] = []
        for effect in action.effects:
            used = {
                name
                for field in effect.__struct_fields__
                for name in later
                if f"{{{name}}}" in str(getattr(effect, field))
            }
            if isinstance(effect, Consumes) and isinstance(effect.amount, str):
                used |= later & list_arguments(effect.amount)
            if isinstance(effect, Consumes) and effect.resource in module.units.keys() - module.levels.keys():
                continue  # the volume of the liquid is not known
            if used and not isinstance(effect, Transfers | Draws):
                names = ", ".join(sorted(used))
                self.remarks.error(
                    f"Step {entry.name!r}: {names} decides what moves, so it must be known before the run.",
                    (*path, "args", *sorted(used)[:1]),
                    "Write the value itself, or take it from the payload.",
                )
                continue
            try:
                if isinstance(effect, Consumes) and isinstance(effect.amount, str):
                    known = {name: value for name, value in values.items() if name not in later}
                    effect = self._count(module, effect, effect.amount, known, entry, path)
                written = effect
                effect = self._resolve(effect, values, module)
                if isinstance(effect, Transfers | Draws) and isinstance(written, Transfers | Draws):
                    self._check_doses(written, effect, entry, path)
                if not isinstance(effect, Replaces) or effect.module:
                    effects.append(effect)
            except SpecError as error:
                self._report(error, entry, path)
            except KeyError as error:
                self.remarks.error(
                    f"Step {entry.name!r}: {entry.action} names an argument {error} that it does not have.",
                    (*path, "action"),
                    f"The driver {module.driver!r} must be corrected.",
                )
        return tuple(effects)

    def _report(self, error: SpecError, entry: StepEntry, path: Path_) -> None:
        """Report the fault of an argument, or of the file that it names."""
        if error.file:
            self.remarks.report.keep_error(error)
        else:
            self.remarks.error(f"Step {entry.name!r}: {error.message}", (*path, "args"), error.remedy)

    def _count(
        self,
        module: ModuleSpec,
        effect: Consumes,
        written: str,
        values: dict[str, Any],
        entry: StepEntry,
        path: Path_,
    ) -> Consumes:
        """The effect with the number for its amount. A warning reports an assumed number. Raises
        SpecError."""
        counter = find_counter(module.driver, effect.resource, self.given.descriptions)
        found = compute_amount(written, values, self._find_content, counter)
        if found.doubt:
            name = next((str(values.get(arg, "")) for arg in list_arguments(written)), "")
            self.remarks.add_warning(
                f"Step {entry.name!r} is assumed to use up {found.amount:g} {effect.resource}: "
                f"this cannot be counted from {name or 'its file'} ({found.doubt}).",
                (*path, "args"),
                found.remedy,
            )
        return msgspec.structs.replace(effect, amount=found.amount)

    def _check_doses(
        self, written: Transfers | Draws, effect: Transfers | Draws, entry: StepEntry, path: Path_
    ) -> None:
        """Check the volumes for wells, as far as they are known before the run."""
        try:
            list_doses(effect)
        except ValueError as error:
            argument = str(written.volumes_ul).strip("{}")
            self.remarks.error(
                f"Step {entry.name!r}: {error}.",
                (*path, "args", argument),
                "Write one volume in µL, 0 or more, for each well.",
            )

    def _resolve(self, effect: AnyEffect, values: dict[str, Any], module: ModuleSpec) -> AnyEffect:
        filled = resolve(effect, values, lambda text: self.stations.find(text, local(module.name)))
        if isinstance(filled, Replaces) and filled.module:
            return self._replace(filled)
        if isinstance(filled, Move):
            turns = filled.source_grip and filled.target_grip and filled.source_grip != filled.target_grip
            if turns and module.regrip and not filled.via:
                return msgspec.structs.replace(filled, via=module.regrip)
            if filled.via and not turns and isinstance(effect, Move) and effect.source_grip:
                return msgspec.structs.replace(filled, via=StationName(""))  # the grip is not changed
        return filled

    def _replace(self, effect: Replaces) -> Replaces:
        """The effect with the full names of the workcell. Raises SpecError for names that it does not
        have."""
        module = self.modules.get(local(ModuleName(effect.module)))
        if module is None:
            remedy = suggest_name(effect.module, self.modules, "module")
            raise SpecError(f"There is no module {effect.module!r}.", remedy=remedy)
        if effect.resource not in module.levels:
            remedy = suggest_name(effect.resource, module.levels, "resource")
            raise SpecError(f"{effect.module} uses no {effect.resource!r}.", remedy=remedy)
        if effect.expires and not DATE.fullmatch(effect.expires):
            raise SpecError(f"{effect.expires!r} is not a date.", remedy="Write it like 2027-05-31.")
        return msgspec.structs.replace(effect, module=module.name)


def _holds_result(value: Any) -> bool:
    if isinstance(value, list):
        return any(_holds_result(item) for item in value)
    if isinstance(value, dict):
        return "$result" in value or any(_holds_result(item) for item in value.values())
    return find_result(value) is not None


def _find_taught(module: ModuleSpec) -> dict[str, Any]:
    """The known joint angles of a module, by station."""
    config = module.config.get("config") or {}
    return {**(config.get("representations") or {}), **(module.config.get("poses") or {})}


def _with_places(taught: Mapping[str, Any], action: ActionSpec, written: dict[str, Any]) -> dict[str, Any]:
    """The arguments with a station instead of joint angles, if these are the taught ones of exactly one
    station."""
    known = {alias for arg in action.args if arg.type == "station" for alias in (arg.name, *arg.aliases)}
    found = dict(written)
    for name in known & written.keys() if taught else ():
        if isinstance(written[name], list):
            places = [place for place, pose in taught.items() if pose and pose == written[name]]
            found[name] = places[0] if len(places) == 1 else written[name]
    return found


def _find_nearly_same(taught: Mapping[str, Any], angles: Any) -> str:
    """The station with these joint angles except for one joint; empty if there is none."""
    for place, pose in taught.items() if isinstance(angles, list) else ():
        if isinstance(pose, list) and len(pose) == len(angles):
            apart = [n for n, (one, other) in enumerate(zip(pose, angles, strict=True)) if one != other]
            if len(apart) == 1:
                at = apart[0]
                return f"these joint angles are those of {place}, but {angles[at]} in the place of {pose[at]}"
    return ""
