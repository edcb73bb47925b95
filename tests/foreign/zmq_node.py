"""A reader as a ZeroMQ node that WEI's own client can drive, on ``pyzmq``: ``zmq_node.py PORT``, run by the
tests in its own environment. WEI has the client only.

It measures ``mute`` for as long as it lives. Every measurement is a line in the file named by TRUTH, synced
before and after it: what really happened.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path

import zmq

TRUTH = Path(os.environ["TRUTH"])


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


def act(handle, told):
    if handle != "measure":
        return {"action_response": "failed", "action_msg": "", "action_log": f"There is no {handle}."}
    if told["assay"] == "jam":
        return {"action_response": "failed", "action_msg": "", "action_log": "The drawer is stuck."}
    note(what="measure", assay=told["assay"])
    if told["assay"] == "mute":
        threading.Event().wait()
    time.sleep(told.get("time_s", 0.0))
    note(what="measured", assay=told["assay"])
    return {"action_response": "succeeded", "action_msg": f"/data/{told['assay']}.csv", "action_log": ""}


server = zmq.Context().socket(zmq.REP)
server.bind(f"tcp://127.0.0.1:{sys.argv[1]}")
note(what="startup")
print("the server is up", flush=True)
while True:
    asked = json.loads(server.recv())
    server.send_string(json.dumps(act(asked["action_handle"], asked["action_vars"])))
