"""The shaker of ``sila_node.py`` as a SiLA 2 server on ``unitelabs-sila``: ``unitelabs_node.py PORT``, run by
the tests in its own environment.

Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import asyncio
import json
import os
import sys
from pathlib import Path

from sila.framework import Feature
from sila.server import (
    ObservableCommand,
    ObservableProperty,
    Server,
    ServerConfig,
    UnobservableCommand,
    UnobservableProperty,
)

TRUTH = Path(os.environ["TRUTH"])
DEFINITION = Path(__file__).with_name("shaker.sila.xml").read_text()
FACTORIES = {
    "unobservable_command_factory": UnobservableCommand,
    "observable_command_factory": ObservableCommand,
    "unobservable_property_factory": UnobservableProperty,
    "observable_property_factory": ObservableProperty,
}


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


class Shaker:
    """What a test needs of the device; its other commands do nothing."""

    def __init__(self):
        self.state = "Idle"

    async def shake(self, command_execution, metadata, **told):
        note(what="shake", speed=told["Speed"], label=told["Label"], mode=told["Mode"])
        self.state = "Shaking"
        for tenth in range(int(told["Duration"] * 10)):
            await asyncio.sleep(0.1)
            command_execution.send_intermediate_responses({"Elapsed": (tenth + 1) / 10})
        self.state = "Idle"
        note(what="shake ended", label=told["Label"])
        return {"Turns": told["Speed"] * told["Duration"] / 60}

    async def tell(self, metadata):
        while True:
            yield {"State": self.state}
            await asyncio.sleep(0.05)


async def main():
    feature = Feature.from_definition(DEFINITION, FACTORIES)
    shaker = Shaker()
    feature.commands["ShakePlate"].function = shaker.shake
    feature.properties["State"].function = shaker.tell
    server = Server(ServerConfig(hostname="127.0.0.1", port=int(sys.argv[1]), type="Shaker", version="1.2"))
    server.register_feature(feature)
    await server.start()
    note(what="startup")
    print("the server is up", flush=True)
    await asyncio.Event().wait()


asyncio.run(main())
