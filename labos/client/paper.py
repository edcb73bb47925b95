"""The client with the names of the paper, for programs that were written for it (Vescovi et al., "Towards a
Modular Architecture for Science Factories", Supplementary Information A.4)::

    exp = Experiment("127.0.0.1", "8000", "Color_Picker")
    exp.register_exp()
    steps_run, run_info = run_flow("cp_wf_newplate.yaml", {}, [], exp)
    exp.events.log_loop_start("Main Loop")
    exp.events.end_experiment()

It uses ``labos.client``, which new programs should use directly.
"""

from __future__ import annotations

import getpass
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from labos.client._experiment import Experiment as LabExperiment
from labos.client._files import workflow_text
from labos.client._lab import LabClient
from labos.client._results import RunResult
from labos.errors import BadInput

Steps = list[dict[str, Any]]
RunInfo = dict[str, Any]


class Experiment:
    """An execution of an application, in the lab whose API answers at an address and port. ``user`` is its
    owner (default: the user name on this computer), ``folder`` the folder for files that runs return,
    ``resume`` the id of the experiment that a restarted program continues."""

    def __init__(
        self,
        server_addr: str,
        server_port: str | int,
        experiment_name: str,
        *,
        user: str = "",
        folder: str | Path = "experiments",
        resume: str = "",
        **options: Any,
    ) -> None:
        self.lab = LabClient(f"http://{server_addr}:{server_port}")
        user = user or getpass.getuser()
        self.experiment = LabExperiment(self.lab, experiment_name, user, resume=resume, **options)
        self.experiment_name = experiment_name
        self.events = Events(self)
        self._folder = Path(folder)
        self._is_open = False

    @property
    def experiment_id(self) -> str:
        """Empty before it is registered."""
        return self.experiment.id

    @property
    def experiment_path(self) -> Path:
        """Its folder on this computer."""
        return self._folder / f"{self.experiment_name}_{self.experiment_id}"

    def register_exp(self) -> dict[str, Any]:
        """Begin it, or continue the one of ``resume``. Raises as ``labos.client.Experiment``."""
        if not self._is_open:
            self.experiment.__enter__()
            self._is_open = True
        return {"exp_id": self.experiment_id, "exp_dir": str(self.experiment_path)}

    def run_job(self, workflow: str | Path, payload: Mapping[str, Any] | None = None) -> RunInfo:
        """Run a workflow to its end: ``hist`` has the result of each step, by its name, as
        ``action_response`` and ``action_msg``; a file is its path below ``run_dir``. Raises RunFailed."""
        self.register_exp()
        source = workflow_text(workflow, payload)
        # In the paper's programs one payload is used for several workflows; each takes its part.
        taken = {name: value for name, value in (payload or {}).items() if name in source["text"]}
        return self._info(self.experiment.run(workflow, taken))

    def end(self) -> None:
        """Its closing workflow, if it has one, clears away labware that it left parked."""
        if self._is_open:
            self._is_open = False
            self.experiment.__exit__(None, None, None)
            self.lab.close()

    def _info(self, result: RunResult) -> RunInfo:
        folder = self.experiment_path / "runs" / result.id
        results = {step.key: self._describe_result(step.result, folder) for step in result.steps}
        return {
            "run_id": result.id,
            "run_dir": folder,
            "name": result.workflow,
            "status": result.status,
            "hist": {
                step.key: {
                    "action_response": "succeeded" if step.state == "done" else step.state,
                    "action_msg": results[step.key],
                    "action_log": step.error,
                }
                for step in result.steps
            },
        }

    def _describe_result(self, result: Any, folder: Path) -> str:
        if result is None:
            return ""
        if isinstance(result, Mapping) and isinstance(result.get("sha256"), str):
            name = Path(str(result.get("file", ""))).name or result["sha256"]
            place = folder / "results" / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(self.lab.file(result))
            return str(place)
        return result if isinstance(result, str) else msgspec.json.encode(result).decode()


class Events:
    """The events that an application logs. The start and end of the experiment and of each workflow are
    logged automatically: the calls for them begin and end the experiment, and log nothing more."""

    def __init__(self, of: Experiment) -> None:
        self._of = of
        self._loops: list[str] = []

    def start_experiment(self) -> None:
        """EXPERIMENT:START, with its name and id."""
        self._of.register_exp()

    def end_experiment(self) -> None:
        """EXPERIMENT:END, with its name and id."""
        self._of.end()

    def log_local_compute(self, func_name: str) -> None:
        """LOCAL:COMPUTE, with the name of the function."""
        self._log.log_local_compute(func_name)

    def log_globus_compute(self, func_name: str) -> None:
        """GLOBUS:COMPUTE, with the name of the function."""
        self._log.log_remote_compute(func_name, where="globus")

    def log_globus_flow(self, flow_name: str, flow_id: str = "") -> None:
        """GLOBUS:FLOWS:RUNFLOW, with the name and id of the flow."""
        self._log.log_flow(flow_name, flow_id=str(flow_id), where="globus")

    def log_loop_start(self, loop_name: str) -> None:
        """LOOP:START."""
        self._loops.append(loop_name)
        self._log.log_loop_start(loop_name)

    def log_loop_end(self) -> None:
        """LOOP:END of the innermost loop. Raises BadInput outside of all."""
        self._log.log_loop_end(self._innermost())
        self._loops.pop()

    def log_loop_check(self, condition: str, value: bool) -> None:
        """LOOP:CHECK CONDITION of the innermost loop, with its result. Raises BadInput outside of all."""
        self._log.log_check(condition, value, loop=self._innermost())

    def log_decision(self, dec_name: str, dec_value: Any) -> None:
        """CHECK, with the condition and the decision's value."""
        self._log.log_decision(dec_name, dec_value)

    def log_wf_start(self, wf_name: str, run_id: str) -> None:
        """WEI:WORKFLOW:START: the lab has logged it as run.started."""

    def log_wf_end(self, wf_name: str, run_id: str) -> None:
        """WEI:WORKFLOW:END: the lab has logged it as run.completed or run.failed."""

    @property
    def _log(self) -> LabExperiment:
        self._of.register_exp()
        return self._of.experiment

    def _innermost(self) -> str:
        if not self._loops:
            raise BadInput("No loop was started.", remedy="Call log_loop_start first.")
        return self._loops[-1]


def run_flow(
    workflow: str | Path, payload: Mapping[str, Any] | None, steps_run: Steps, experiment: Experiment
) -> tuple[Steps, RunInfo]:
    """Run a workflow to its end; returns the steps of earlier runs and of this one, and the result of
    ``run_job``. Raises RunFailed."""
    run_info = experiment.run_job(workflow, payload=payload)
    return [*steps_run, {"run_id": run_info["run_id"], "steps": run_info["hist"]}], run_info
