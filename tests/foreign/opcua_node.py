"""A shaker as an OPC UA server, on ``asyncua``: ``opcua_node.py PORT``, run by the tests in its own
environment.

Every motion is a line in the file named by TRUTH, synced before and after it: what really happened.
"""

import asyncio
import json
import os
import sys
from pathlib import Path

from asyncua import Server, ua, uamethod

TRUTH = Path(os.environ["TRUTH"])


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


async def main():
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{sys.argv[1]}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace("http://lab.example/shaker")
    shaker = await server.nodes.objects.add_object(ua.NodeId("Shaker", space), "Shaker")

    async def variable(name, value):
        made = await shaker.add_variable(ua.NodeId(f"Shaker.{name}", space), name, value)
        await made.set_writable()
        return made

    state, why = await variable("State", "Idle"), await variable("Why", "")
    speed, position = (
        await variable("Speed", ua.Variant(0, ua.VariantType.Int32)),
        await variable("Position", 0.0),
    )
    job, last = await variable("Job", ""), await variable("Last", "")
    going = []

    @uamethod
    async def shake(parent, time_s, label):
        """Answered at the end of the motion, which goes on when who called is gone."""
        going.append(asyncio.ensure_future(move(time_s, label)))
        await asyncio.shield(going[-1])

    async def move(time_s, label):
        told = {"speed": await speed.read_value(), "label": label}
        note(what="shake", **told)
        await state.write_value("Shaking")
        await asyncio.sleep(time_s)
        note(what="shaken", label=label)
        await last.write_value(await job.read_value())
        if label == "jam":
            await why.write_value("The plate is stuck.")
        await state.write_value("Error" if label == "jam" else "Idle")

    @uamethod
    async def travel(parent, target):
        """Answered at once."""
        note(what="travel", target=target)
        await state.write_value("Travelling")

        async def go():
            await asyncio.sleep(1.5)
            await position.write_value(target)
            note(what="travelled", target=target)
            await state.write_value("Idle")

        going.append(asyncio.ensure_future(go()))

    @uamethod
    async def reset(parent):
        note(what="reset")
        await why.write_value("")
        await state.write_value("Idle")

    number, text = ua.VariantType.Double, ua.VariantType.String
    methods = {"Shake": (shake, [number, text]), "Travel": (travel, [number]), "Reset": (reset, [])}
    for name, (method, args) in methods.items():
        await shaker.add_method(ua.NodeId(f"Shaker.{name}", space), name, method, args, [])
    async with server:
        note(what="startup")
        print("the server is up", flush=True)
        await asyncio.Event().wait()


asyncio.run(main())
