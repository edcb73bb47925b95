"""A shaker that speaks protobuf over TCP: ``protobuf_node.py PORT SCHEMA``, run by the tests in its own
environment, with the code that protoc generates from the schema there.

It shares nothing with LabOS but the .proto file. With FORGETFUL set it keeps no record of actions and answers
each at its end. Every motion is a line in the file named by TRUTH, synced before and after it: what really
happened.
"""

import importlib
import json
import os
import socketserver
import sys
import tempfile
import threading
import time
from pathlib import Path

from google.protobuf.proto import parse_length_prefixed, serialize_length_prefixed
from grpc_tools import protoc

PORT, SCHEMA = int(sys.argv[1]), Path(sys.argv[2])
TRUTH = Path(os.environ["TRUTH"])
FORGETFUL = bool(os.environ.get("FORGETFUL"))

generated = tempfile.mkdtemp(dir=Path.cwd())
assert protoc.main(["protoc", f"-I{SCHEMA.parent}", f"--python_out={generated}", SCHEMA.name]) == 0
sys.path.insert(0, generated)
messages = importlib.import_module("tcp_node_pb2")


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


class Shaker:
    def __init__(self):
        self.known = {}
        self.busy = False
        self.error = ""
        self.speed = 0
        self.guard = threading.Lock()

    def start(self, action):
        with self.guard:
            if action.id in self.known:
                return self.known[action.id]
            progress = messages.Progress(id=action.id, status=messages.STATUS_RUNNING)
            if self.busy:
                progress.status, progress.error = messages.STATUS_NOT_STARTED, "It shakes already."
                return progress
            self.known[action.id] = progress
            self.busy = True
        if FORGETFUL:
            self.work(action, progress)
            del self.known[action.id]
        else:
            threading.Thread(target=self.work, args=(action, progress), daemon=True).start()
        return progress

    def work(self, action, progress):
        told = json.loads(action.action_vars)
        note(what=action.action_handle, **told)
        ended = messages.Progress(id=action.id, status=messages.STATUS_SUCCEEDED)
        if action.action_handle == "jam":
            self.error = ended.error = "The plate is stuck."
            ended.status = messages.STATUS_FAILED
        elif action.action_handle == "run":
            note(what="text", text=action.files["protocol"].content.decode())
            ended.files["log"].name, ended.files["log"].content = "log.txt", b"all well"
        else:
            self.speed = told["speed"]
            time.sleep(told["time_s"])
            ended.result = json.dumps({"turns": told["speed"] * told["time_s"]})
        note(what=f"{action.action_handle} ended", label=told.get("label", ""))
        self.speed, self.busy = 0, False
        progress.CopyFrom(ended)

    def answer(self, request):
        response = messages.Response()
        asked = request.WhichOneof("what")
        if asked == "action":
            response.progress.CopyFrom(self.start(request.action))
        elif asked == "ask":
            known = self.known.get(request.ask.id)
            unknown = messages.Progress(id=request.ask.id, status=messages.STATUS_NOT_KNOWN)
            response.progress.CopyFrom(known or unknown)
        elif asked == "state":
            response.state.busy, response.state.error = self.busy, self.error
            response.state.variables = json.dumps({"speed": self.speed})
        elif asked == "resources":
            response.resources.levels["oil"] = 12.5
        elif asked == "reset":
            self.error = ""
            response.done.SetInParent()
        elif asked == "about":
            shake = response.about.actions.add(name="shake", description="Shake the plate.", has_result=True)
            shake.args.add(name="speed", type="int")
            shake.args.add(name="time_s", type="float", optional=True, default="0.2")
            response.about.name, response.about.version = "shaker", "1.2"
        else:
            response.refused.why = f"there is no {asked}"
        return response


shaker = Shaker()


class Handler(socketserver.StreamRequestHandler):
    def handle(self):
        while request := parse_length_prefixed(messages.Request, self.rfile):
            serialize_length_prefixed(shaker.answer(request), self.wfile)


class Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True

    def handle_error(self, request, client_address):
        pass  # the line was cut


server = Server(("127.0.0.1", PORT), Handler)
note(what="startup")
print("the server is up", flush=True)
server.serve_forever()
