"""The package that applications import: a client of a lab, and an experiment as a block of code.

::

    lab = LabClient(home="lab")
    with Experiment(lab, "color picker", "bo", closing="cp_trashplate") as experiment:
        experiment.run("cp_newplate")
        result = experiment.run("cp_mixcolor", payload)
        experiment.note("decision", "next colors", colors=[1, 2, 3])

No part of the kernel is imported here: an application runs on any computer that can reach the lab.
"""

from typing import TYPE_CHECKING, Any

from labos.client._answers import LabUnreachable
from labos.client._experiment import Experiment, RunFailed
from labos.client._files import step_text, workflow_text
from labos.client._flows import Flow, FlowFailed, FlowResult, FlowStep
from labos.client._lab import LabClient
from labos.client._log import LabFiles, LabLog
from labos.client._logged import Loop
from labos.client._replay import ReplayMismatch
from labos.client._results import RunResult, StepResult
from labos.client._transfers import TransferFailed, Transferred

if TYPE_CHECKING:
    from labos.client._twin import AsyncExperiment, AsyncLabClient

__all__ = [
    "AsyncExperiment",
    "AsyncLabClient",
    "Experiment",
    "Flow",
    "FlowFailed",
    "FlowResult",
    "FlowStep",
    "LabClient",
    "LabFiles",
    "LabLog",
    "LabUnreachable",
    "Loop",
    "ReplayMismatch",
    "RunFailed",
    "RunResult",
    "StepResult",
    "TransferFailed",
    "Transferred",
    "step_text",
    "workflow_text",
]


def __getattr__(name: str) -> Any:
    """The asynchronous client, with its own imports, is only imported when it is used."""
    if name in ("AsyncExperiment", "AsyncLabClient"):
        from labos.client import _twin

        return getattr(_twin, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
