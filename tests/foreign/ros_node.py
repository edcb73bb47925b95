"""A shaker as a ROS 2 node, on ``rclpy``; run by the tests in its own environment.

It has what WEI's ROS nodes have: a service for actions, a topic for its state, a service that describes it;
its messages are of ``test_msgs``, since ``wei_services`` is on no package index. Beside these a ROS action
and a camera.
Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import json
import os
import time
from pathlib import Path

import rclpy
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

TRUTH = Path(os.environ["TRUTH"])
ABOUT = {"name": "shaker", "model": "Shaker 3", "actions": {"shake": "%d %d", "jam": ""}}


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


class Shaker(Node):
    def __init__(self):
        super().__init__("shaker", namespace="/std_ns")
        self.state = "READY"
        group = {"callback_group": ReentrantCallbackGroup()}
        self.create_service(BasicTypes, "~/action_handler", self.act, **group)
        self.create_service(BasicTypes, "~/description_handler", self.describe, **group)
        self.create_service(Trigger, "~/reset", self.reset, **group)
        self.states = self.create_publisher(String, "~/state", 10)
        self.frames = self.create_publisher(Image, "~/video_frames", 10)
        self.create_timer(0.1, self.tell, **group)
        ActionServer(self, Fibonacci, "~/grow", self.grow, **group)

    def tell(self):
        self.states.publish(String(data=f"State: {self.state}"))
        picture = Image(width=2, height=1, encoding="bgr8", step=6, data=bytes([1, 2, 3, 4, 5, 6]))
        self.frames.publish(picture)

    def act(self, request, response):
        told = json.loads(request.string_value)
        given = {"label": "", **told["action_vars"]}
        note(what=told["action_handle"], **given)
        self.state = "BUSY"
        time.sleep(given.get("time_s", 0.0))
        jammed = told["action_handle"] == "jam"
        response.int8_value = -1 if jammed else 0
        response.string_value = "The plate is stuck." if jammed else "shaken"
        note(what=f"{told['action_handle']} ended", label=given["label"])
        self.state = "ERROR" if jammed else "READY"
        return response

    def grow(self, goal):
        note(what="grow", order=goal.request.order)
        self.state = "BUSY"
        time.sleep(goal.request.order / 10)
        self.state = "READY"
        note(what="grown", order=goal.request.order)
        if goal.request.order == 13:
            goal.abort()
            return Fibonacci.Result()
        goal.succeed()
        return Fibonacci.Result(sequence=list(range(goal.request.order)))

    def describe(self, request, response):
        response.string_value = str(ABOUT)
        return response

    def reset(self, request, response):
        note(what="reset")
        self.state = "READY"
        response.success = True
        return response


rclpy.init()
shaker = Shaker()
executor = MultiThreadedExecutor(num_threads=8)
executor.add_node(shaker)
note(what="startup")
print("the ROS node is up", flush=True)
executor.spin()
