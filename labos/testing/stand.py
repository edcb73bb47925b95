"""The parts of a simulated lab, and the jobs of its users."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec

from labos.bootstrap import find_own_class
from labos.core.decide import Command
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation
from labos.core.ids import RunId, StationName
from labos.core.model import ModuleSpec, Workcell
from labos.node.node import Node
from labos.node.protocol import SetupReply


class Stand(msgspec.Struct, frozen=True):
    """The parts of a lab: a workcell, the labware there at the start, its node classes by driver, and the
    labware that a person brings before the first run."""

    workcell: Workcell
    stock: tuple[tuple[StationName, str, int], ...]
    nodes: Mapping[str, type[Node]]
    loads: tuple[LoadStation, ...] = ()

    def node_class(self, module: ModuleSpec) -> type[Node]:
        """The class of a module's node, which the workcell file may describe."""
        about, extends = (module.config.get(key, {}) for key in ("about", "extends"))
        if not about and not extends:
            return self.nodes[module.driver]
        setup = SetupReply(driver=module.driver, simulated=True, about=about, extends=extends)
        return find_own_class(module.name, setup, self.nodes.get(module.driver))


class Job(msgspec.Struct, frozen=True):
    """A job that a user submits after ``after_s``: an experiment of one or more runs in sequence."""

    name: str
    user: str
    runs: tuple[SubmitRun, ...]
    experiment: StartExperiment | None = None
    after_s: float = 0.0


class Meddle(msgspec.Struct, frozen=True):
    """An interference with a run (job/number) as soon as one of its steps has started: commands or emergency
    stops of modules, each the given seconds after the previous one."""

    request: str
    step: int
    deeds: Callable[[RunId], Sequence[tuple[float, Command | str]]]


def make_cancellers(cancels: Mapping[str, int]) -> list[Meddle]:
    """Make users who cancel runs, each when the named step has started."""
    return [Meddle(name, step, lambda run: [(0.0, CancelRun(run))]) for name, step in cancels.items()]
