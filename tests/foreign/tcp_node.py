"""A reader as a TCP node that WEI's own client can drive: ``tcp_node.py PORT``, run by the tests as a process
of its own. WEI has the client only.

It answers ``pieces`` in three, as a slow line would, and measures ``mute`` for as long as it lives. Every
measurement is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import contextlib
import json
import os
import socketserver
import sys
import threading
import time
from pathlib import Path

TRUTH = Path(os.environ["TRUTH"])
NOTING = threading.Lock()


def note(**what):
    with NOTING, TRUTH.open("a") as file:
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


class Handler(socketserver.BaseRequestHandler):
    def handle(self):
        data = b""
        while piece := self.request.recv(65536):
            data += piece
            try:
                told = json.loads(data)
            except ValueError:
                continue
            answer = json.dumps(act(told["action_handle"], told["action_vars"])).encode()
            step = len(answer) // 3 if told["action_vars"]["assay"] == "pieces" else len(answer)
            with contextlib.suppress(OSError):  # nobody waits for it any more
                for start in range(0, len(answer), step):
                    self.request.sendall(answer[start : start + step])
                    time.sleep(0.01)
            return


class Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


with Server(("127.0.0.1", int(sys.argv[1])), Handler) as server:
    note(what="startup")
    print("the server is up", flush=True)
    server.serve_forever()
