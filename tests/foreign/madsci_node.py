"""A MADSci node as a lab would write it, on ``madsci-node-module``; run by the tests in its own
environment.

Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import json
import os
import time
from pathlib import Path
from typing import Annotated

from madsci.common.types.location_types import LocationArgument
from madsci.node_module.helpers import action
from madsci.node_module.rest_node_module import RestNode

TRUTH = Path(os.environ["TRUTH"])


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


class Bench(RestNode):
    """A shaker for the tests."""

    module_name = "Shaker 3"
    module_version = "1.2"

    def startup_handler(self):
        note(what="startup")
        self.speed = 0

    def shutdown_handler(self):
        pass

    def state_handler(self):
        self.node_state = {"speed": getattr(self, "speed", 0)}

    @action
    def shake(self, speed: Annotated[int, "in rpm"], time_s: float = 0.2, label: str = "") -> dict:
        """Shake the plate."""
        note(what="shake", speed=speed, label=label)
        self.speed = speed
        time.sleep(time_s)
        self.speed = 0
        note(what="shaken", label=label)
        return {"speed": speed, "turns": speed * time_s}

    @action
    def transfer(self, source: LocationArgument, target: LocationArgument) -> None:
        """Carry a plate from one place to another."""
        known = {"resource": source.resource_id} if source.resource_id else {}
        note(what="transfer", source=source.representation, target=target.representation, **known)

    @action
    def jam(self, label: str = "") -> None:
        """Fail as a device does."""
        note(what="jam", label=label)
        raise RuntimeError("The plate is stuck.")

    @action
    def run(self, protocol: Path) -> None:
        """Run a protocol file."""
        note(what="run", text=protocol.read_text(errors="replace"), bytes=protocol.stat().st_size)

    @action
    def picture(self) -> Path:
        """Take a picture."""
        path = TRUTH.with_name("picture.png")
        path.write_bytes(b"\x89PNG" + bytes(range(256)))
        note(what="picture")
        return path

    def safety_stop(self):
        note(what="safety_stop")
        return True


if __name__ == "__main__":
    Bench().start_node()
