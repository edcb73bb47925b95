"""What a simulated lab is built of, and what people want of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec

from labos.core.decide import Command
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.ids import RunId, StationName
from labos.core.model import Workcell
from labos.node.node import Node


class Stand(msgspec.Struct, frozen=True):
    """What a lab is built of: a workcell, what stands there at first, its node classes."""

    workcell: Workcell
    stock: tuple[tuple[StationName, str, int], ...]
    nodes: Mapping[str, type[Node]]


class Job(msgspec.Struct, frozen=True):
    """What a user submits after ``after_s``: an experiment of one or more runs in sequence."""

    name: str
    user: str
    runs: tuple[SubmitRun, ...]
    experiment: StartExperiment | None = None
    after_s: float = 0.0


class Meddle(msgspec.Struct, frozen=True):
    """What somebody does about a run (job/number) as soon as one of its steps has begun: commands, or
    modules that are stopped, each so many seconds after the one before."""

    request: str
    step: int
    deeds: Callable[[RunId], Sequence[tuple[float, Command | str]]]


def cancelling(cancels: Mapping[str, int]) -> list[Meddle]:
    """Users who cancel runs, each when the step named has begun."""
    return [Meddle(name, step, lambda run: [(0.0, CancelRun(run))]) for name, step in cancels.items()]
