"""A shaker as a SiLA 2 server, on ``sila2``: ``sila_node.py PORT [KEY CERTIFICATE]``, run by the tests in its
own environment.

Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import datetime
import json
import os
import sys
import threading
import time
from pathlib import Path
from queue import Queue

from sila2.framework import DefinedExecutionError, Feature
from sila2.server import FeatureImplementationBase, SilaServer

TRUTH = Path(os.environ["TRUTH"])
PORT, SECRETS = int(sys.argv[1]), [Path(name).read_bytes() for name in sys.argv[2:]]
FEATURE = Feature(Path(__file__).with_name("shaker.sila.xml").read_text())
UUID = "0d0f4ba7-56a7-4a0c-8d9a-3a8e6e1c2f11"


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


def failure(name, message):
    return DefinedExecutionError(FEATURE.defined_execution_errors[name], message)


class Shaker(FeatureImplementationBase):
    """A device that can do one thing at a time."""

    def __init__(self, parent_server):
        super().__init__(parent_server)
        self._State_producer_queue = Queue()
        self.works = threading.Lock()
        self.why = ""
        self.tell("Idle")

    def tell(self, state):
        self._State_producer_queue.put(state)

    def move(self, what, told, duration, each=lambda elapsed: None):
        """Carry a motion out, as its label says; ``each`` is called every tenth of a second."""
        if not self.works.acquire(blocking=False):
            raise RuntimeError("It moves already.")
        try:
            note(what=what, **told)
            self.tell("Shaking")
            began = time.monotonic()
            while (elapsed := time.monotonic() - began) < duration:
                each(round(elapsed, 1))
                time.sleep(min(0.1, duration - elapsed))
            note(what=f"{what} ended", label=told["label"])
            if told["label"] == "jam":
                self.why = "The plate is stuck."
                raise failure("PlateStuck", "The plate does not move.")
            if told["label"] == "break":
                raise RuntimeError("The motor is hot.")
        finally:
            self.tell("Error" if self.why else "Idle")
            self.works.release()

    def ShakePlate(self, speed, duration, label, mode, *, metadata, instance):
        if label == "lid":
            raise failure("LidOpen", "Close the lid.")
        instance.begin_execution()
        told = {"speed": speed, "label": label, "mode": mode}
        self.move("shake", told, duration, instance.send_intermediate_response)
        return speed * duration / 60

    def Nudge(self, duration, label, *, metadata):
        self.move("nudge", {"label": label}, duration)
        return 1.5, -2.0

    def RunProgram(self, protocol, steps, not_before, *, metadata):
        parts = [{"part": step.Part, "reversed": step.Reversed} for step in steps]
        note(what="program", text=protocol.decode(), steps=parts, after=not_before.isoformat())
        began = datetime.datetime(2026, 2, 3, 4, 5, 6, 789000, tzinfo=datetime.UTC)
        return b"all well", [step.Part for step in steps], began

    def Reset(self, *, metadata):
        note(what="reset")
        self.why = ""
        self.tell("Idle")

    def Halt(self, *, metadata):
        note(what="halt")

    def State_on_subscription(self, *, metadata):
        return None

    def get_Why(self, *, metadata):
        return self.why

    def get_Oil(self, *, metadata):
        return 12.5

    def get_Nest(self, *, metadata):
        return True, (0.5, 0.25)


server = SilaServer("Shaker", "Shaker", "A shaker for the tests.", "1.2", "https://lab.example", UUID)
server.set_feature_implementation(FEATURE, Shaker(server))
if SECRETS:
    key, certificate = SECRETS
    server.start("127.0.0.1", PORT, private_key=key, cert_chain=certificate, enable_discovery=False)
else:
    server.start_insecure("127.0.0.1", PORT, enable_discovery=False)
note(what="startup")
print("the server is up", flush=True)
threading.Event().wait()
