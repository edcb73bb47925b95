"""The process that communicates over ROS 2, run by the Python with rclpy: ``python ros_bridge.py``. It needs
the standard library and rclpy, nothing of LabOS, and no Python newer than 3.8, so that it runs where ROS is
installed. One JSON object a line comes in by standard input, one goes out by standard output:

    {"id": 1, "call": "/x/home", "type": "std_srvs/srv/Trigger", "fields": {}, "wait_s": 3}
        {"id": 1, "absent": true}, or {"id": 1, "sent": true} and later {"id": 1, "answer": {...}}
    {"id": 2, "watch": "/x/state", "type": "std_msgs/msg/String"}
        {"id": 2, "message": {...}}, again and again
    {"id": 3, "ready": "/x/home", "type": "std_srvs/srv/Trigger"}
        {"id": 3, "answer": true}
    {"id": 4, "frame": "/x/video_frames", "file": "/tmp/raw"}
        {"id": 4, "answer": {"width": 640, ...}}
    {"id": 5, "forget": 4}

A call is sent only once. A request that cannot be carried out is answered by {"id": …, "refused": "why"}.
When standard input ends, so does the bridge.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import queue
import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data

LOOK_S = 0.1
LEAVE_S = 3.0


def find_type(name: str) -> Any:
    """``std_srvs/srv/Trigger``, or ``test_msgs/action/Fibonacci:SendGoalService``."""
    whole, _, part = name.partition(":")
    package, kind, bare = whole.split("/")
    found = getattr(importlib.import_module(f"{package}.{kind}"), bare)
    return getattr(found.Impl, part) if part else found


def fill(message: Any, fields: dict[str, Any]) -> None:
    """Set a message's fields from plain values."""
    known = message.get_fields_and_field_types()
    for name, value in fields.items():
        if name not in known:
            raise ValueError(f"there is no field {name!r}; there are {', '.join(known)}")
        now = getattr(message, name)
        if isinstance(value, dict) and hasattr(now, "get_fields_and_field_types"):
            fill(now, value)
        elif isinstance(now, float) and isinstance(value, int):
            setattr(message, name, float(value))
        else:
            setattr(message, name, value)


def plain(value: Any) -> Any:
    """A message as plain values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(item) for item in value]


class Bridge:
    """Carries commands out on one ROS node, which is named after the process."""

    def __init__(self) -> None:
        self.node = rclpy.create_node(f"labos_bridge_{os.getpid()}")
        self.clients: dict[str, Any] = {}
        self.waiting: list[tuple[float, int, Any, Any]] = []
        self.watched: dict[int, Any] = {}
        self.commands: queue.Queue[dict[str, Any]] = queue.Queue()
        self.guard = self.node.create_guard_condition(self.work)
        self.node.create_timer(LOOK_S, self.look)

    def read(self) -> None:
        """Read commands, in a separate thread."""
        for line in sys.stdin:
            self.commands.put(json.loads(line))
            self.guard.trigger()
        # If a participant leaves without notice, it is still contacted for 20 s, and the next bridge waits
        # for that.
        last = threading.Timer(LEAVE_S, os._exit, (0,))
        last.daemon = True
        last.start()
        rclpy.shutdown()

    def say(self, **fields: Any) -> None:
        sys.stdout.write(json.dumps(fields) + "\n")
        sys.stdout.flush()

    def work(self) -> None:
        while not self.commands.empty():
            command = self.commands.get()
            try:
                self.carry_out(command)
            except Exception as error:
                self.say(id=command["id"], refused=f"{type(error).__name__}: {error}")

    def carry_out(self, command: dict[str, Any]) -> None:
        if "call" in command:
            client = self.client(command["call"], command["type"])
            request = find_type(command["type"]).Request()
            fill(request, command["fields"])
            self.waiting.append((time.monotonic() + command["wait_s"], command["id"], client, request))
            self.look()
        elif "ready" in command:
            client = self.client(command["ready"], command["type"])
            self.say(id=command["id"], answer=client.service_is_ready())
        elif "watch" in command:
            self.watch(command["id"], command["watch"], command["type"])
        elif "frame" in command:
            self.frame(command["id"], command["frame"], command["file"])
        elif "forget" in command and command["forget"] in self.watched:
            self.node.destroy_subscription(self.watched.pop(command["forget"]))

    def client(self, name: str, kind: str) -> Any:
        if name not in self.clients:
            self.clients[name] = self.node.create_client(find_type(kind), name)
        return self.clients[name]

    def look(self) -> None:
        """Send the calls whose service is now available."""
        waiting, self.waiting = self.waiting, []
        for entry in waiting:
            until, known, client, request = entry
            if client.service_is_ready():
                future = client.call_async(request)
                self.say(id=known, sent=True)
                future.add_done_callback(functools.partial(self.answer, known))
            elif time.monotonic() > until:
                self.say(id=known, absent=True)
            else:
                self.waiting.append(entry)

    def answer(self, known: int, done: Any) -> None:
        try:
            self.say(id=known, answer=plain(done.result()))
        except Exception as error:
            self.say(id=known, refused=f"{type(error).__name__}: {error}")

    def watch(self, known: int, topic: str, kind: str) -> None:
        def pass_on(message: Any) -> None:
            self.say(id=known, message=plain(message))

        self.watched[known] = self.node.create_subscription(find_type(kind), topic, pass_on, 10)

    def frame(self, known: int, topic: str, path: str) -> None:
        taken: list[bool] = []

        def save_image(message: Any) -> None:
            if taken:
                return
            taken.append(True)
            with open(path, "wb") as file:
                file.write(bytes(message.data))
            shape = {key: getattr(message, key) for key in ("width", "height", "encoding", "step")}
            self.say(id=known, answer=shape)

        kind = find_type("sensor_msgs/msg/Image")
        self.watched[known] = self.node.create_subscription(kind, topic, save_image, qos_profile_sensor_data)


def main() -> None:
    rclpy.init()
    bridge = Bridge()
    threading.Thread(target=bridge.read, daemon=True).start()
    bridge.say(ready=True)
    try:
        rclpy.spin(bridge.node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    bridge.node.destroy_node()


if __name__ == "__main__":
    main()
