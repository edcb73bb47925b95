"""Pauses, resumes and cancels the target that a name stands for: a run, an experiment, a module, a workcell,
the lab."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from labos.core.decide import Command
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts, ResumeStarts
from labos.core.decide.runs import PauseRun, ResumeRun
from labos.core.ids import ExperimentId, RunId, local
from labos.core.lab import WHOLE_LAB
from labos.core.repeated import RequestRepeated
from labos.core.runs import RunCancelled, RunCancelling
from labos.core.state import LabState
from labos.errors import NotFound, Refused
from labos.http.limits import Asker, Line, Name, says
from labos.http.parts import LabKernel

VERBS = ("pause", "resume", "cancel")

Kind = Literal["run", "experiment", "module", "workcell", "lab"]


class ControlRequest(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """``target``: a run, an experiment, a module, a workcell, or ``lab``. ``stay``: the labware of cancelled
    runs stays where it is. ``why`` is for pausing and cancelling."""

    target: Annotated[Name, says("a run, an experiment, a module, a workcell, or `lab`")]
    by: Asker = ""
    why: Annotated[Line, says("for a pause or a cancellation: a reason for the log")] = ""
    stay: Annotated[bool, says("`true`: labware of the cancelled runs stays where it is")] = False


class ControlResult(msgspec.Struct):
    """The target, and the runs that were cancelled. ``already``: it was in this state before, and nothing
    changed; ``noted``: the given reason was logged nevertheless."""

    kind: Kind
    target: str
    runs: list[str]
    already: bool = False
    noted: bool = False


async def control(kernel: LabKernel, verb: str, asked: ControlRequest) -> ControlResult:
    """Raises NotFound if the target names nothing, Refused if it names several modules."""
    kind, target = find_meant(kernel.state, asked.target)
    events = await kernel.execute(_command(verb, kind, target, asked), asked.by)
    ended = [str(event.run) for event in events if isinstance(event, RunCancelled | RunCancelling)]
    again = [isinstance(event, RequestRepeated) for event in events]
    return ControlResult(
        kind=kind,
        target="lab" if kind == "lab" else target,
        runs=list(dict.fromkeys(ended)),
        already=all(again),
        noted=any(again),
    )


def find_meant(state: LabState, text: str) -> tuple[Kind, str]:
    """The target that a name stands for; modules may be named without their workcell."""
    if state.runs.get(text) is not None:
        return "run", text
    if ExperimentId(text) in state.experiments.open:
        return "experiment", text
    if text in (WHOLE_LAB, "lab"):
        return "lab", WHOLE_LAB
    if text in state.lab.workcells:
        return "workcell", text
    modules = [name for name in state.modules.by_name if text in (name, local(name))]
    if len(modules) > 1:
        raise Refused(
            f"Several modules are called {text}.", remedy=f"Name one of them: {', '.join(modules)}."
        )
    if not modules:
        raise NotFound(
            f"There is no run or experiment that has not ended, no module and no workcell {text!r}.",
            remedy="List them: labos runs, labos experiments, labos nodes",
        )
    return "module", modules[0]


def make_run_command(verb: str, run: str, stay: bool, why: str) -> Command:
    """``cancel``, ``pause`` or ``resume`` a run."""
    if verb == "cancel":
        return CancelRun(RunId(run), stay, why)
    return PauseRun(RunId(run), why) if verb == "pause" else ResumeRun(RunId(run))


def _command(verb: str, kind: Kind, target: str, asked: ControlRequest) -> Command:
    if kind == "run":
        return make_run_command(verb, target, asked.stay, asked.why)
    if verb == "pause":
        return PauseStarts(target, asked.by, asked.why)
    if verb == "resume":
        return ResumeStarts(target, asked.by)
    if kind == "experiment":
        return CancelExperiment(ExperimentId(target), asked.by, asked.stay, asked.why)
    return CancelRuns(target, asked.stay, asked.why)
