"""Submits a workflow and follows it to its end, with a client that was generated from the description of the
API: ``python generated_client.py URL FOLDER``, where FOLDER holds the generated package.

Says the run's id, its status and the state of its steps as JSON.
"""

from __future__ import annotations

import json
import sys

URL, FOLDER = sys.argv[1:]
sys.path.insert(0, FOLDER)

from lab_os_client import Client  # noqa: E402
from lab_os_client.api.lab import get_state  # noqa: E402
from lab_os_client.api.log import list_events  # noqa: E402
from lab_os_client.api.modules import list_locations  # noqa: E402
from lab_os_client.api.runs import get_run, submit_run  # noqa: E402
from lab_os_client.models import NewRun, Problem, WorkflowText  # noqa: E402

FLOW = "labos: 1\nname: seal\nsteps:\n  - {name: look, module: arm, action: read_pose}\n"
OVER = ("completed", "failed", "cancelled")


def main() -> None:
    with Client(base_url=URL, raise_on_unexpected_status=True, timeout=60) as client:
        body = NewRun(workflow=WorkflowText(text=FLOW, name="seal.yaml"), user="ada", workcell="fuzz")
        names = {submit_run.sync(client=client, body=body, idempotency_key="mine").run for _ in range(2)}
        (run,) = names
        while True:
            found = get_run.sync(run, client=client, wait=20.0)
            if found.status in OVER:
                break
        events = list_events.sync(client=client, stream=[run], type_=["run"])
        missing = get_run.sync("R999", client=client)
        faulty = submit_run.sync(client=client, body=NewRun(workflow=WorkflowText(text="a: ["), user="ada"))
        assert isinstance(missing, Problem)
        state = get_state.sync(client=client, waits=False)
        poses = list_locations.sync("fuzz/arm", client=client)
        told = {
            "run": run,
            "status": found.status,
            "steps": [step.state for step in found.steps],
            "events": [event.type_ for event in events.events],
            "problem": [missing.status, missing.code],
            "finding": [faulty.status, faulty.details[0].line],
            "modules": sorted(module.name for module in state.modules),
            "poses": type(poses).__name__,
        }
    print(json.dumps(told))


if __name__ == "__main__":
    main()
