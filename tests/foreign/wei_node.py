"""A WEI node as a lab would write it, on ``ad_sdl.wei``; run by the tests in its own environment.

Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import json
import os
import time
from pathlib import Path

from fastapi import UploadFile
from wei.modules.rest_module import RESTModule
from wei.types.module_types import ModuleStatus
from wei.types.step_types import StepFileResponse, StepResponse, StepStatus

TRUTH = Path(os.environ["TRUTH"])

module = RESTModule(name="bench", version="1.2", description="A shaker for the tests.", model="Shaker 3")


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


@module.startup()
def startup(state):
    note(what="startup")
    state.speed = 0


@module.state_handler()
def tell(state):
    return {"status": state.status, "error": state.error, "speed": getattr(state, "speed", 0)}


@module.action()
def shake(state, speed: int, time_s: float = 0.2, label: str = "") -> StepResponse:
    """Shake the plate."""
    note(what="shake", speed=speed, label=label)
    state.speed = speed
    time.sleep(time_s)
    state.speed = 0
    note(what="shaken", label=label)
    return StepResponse.step_succeeded(data={"speed": speed, "turns": speed * time_s})


@module.action()
def transfer(source: list, target: list) -> StepResponse:
    """Carry a plate from one place to another."""
    note(what="transfer", source=source, target=target)
    return StepResponse.step_succeeded()


@module.action()
def jam(label: str = "") -> StepResponse:
    """Fail as a device does."""
    note(what="jam", label=label)
    return StepResponse.step_failed(error="The plate is stuck.")


@module.action()
def crash(state) -> StepResponse:
    """Fail as a program does."""
    note(what="crash")
    raise RuntimeError("the driver has crashed")


@module.action()
def run(protocol: UploadFile) -> StepResponse:
    """Run a protocol file."""
    note(what="run", text=protocol.file.read().decode())
    return StepResponse.step_succeeded()


@module.action()
def picture(state) -> StepFileResponse:
    """Take a picture."""
    path = TRUTH.with_name("picture.png")
    path.write_bytes(b"\x89PNG" + bytes(range(256)))
    note(what="picture")
    return StepFileResponse(StepStatus.SUCCEEDED, files={"image": str(path)}, data={"exposure": 3})


@module.safety_stop()
def safety_stop(state):
    note(what="safety_stop")
    state.status[ModuleStatus.CANCELLED] = True
    return {"message": "stopped"}


module.start()
