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
from asyncua.common.structures104 import new_enum, new_struct, new_struct_field
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import User, UserRole
from cryptography.x509.oid import ExtendedKeyUsageOID

TRUTH = Path(os.environ["TRUTH"])


def note(**what):
    with TRUTH.open("a") as file:
        file.write(json.dumps(what) + "\n")
        file.flush()
        os.fsync(file.fileno())


async def own_types(server, space):
    """Variables of types that the server defines, and one method that two pumps share."""
    mode = await new_enum(server, space, "Mode", ["Gentle", "Rough", "Off"])
    fields = [
        new_struct_field("Mode", mode.nodeid),
        new_struct_field("Steps", ua.VariantType.UInt16, array=True),
        new_struct_field("Name", ua.VariantType.String),
    ]
    recipe, _ = await new_struct(server, space, "Recipe", fields)
    rpm = await server.get_node(ua.ObjectIds.Float).add_data_type(ua.NodeId("Rpm", space), "Rpm")
    await server.load_data_type_definitions()
    types = await server.nodes.objects.add_object(ua.NodeId("Types", space), "Types")
    first = ua.Recipe(Mode=ua.Mode.Rough, Steps=[1, 2], Name="first")
    for name, value, kind, data_type in (
        ("Mode", 1, ua.VariantType.Int32, mode.nodeid),
        ("Modes", [0, 2], ua.VariantType.Int32, mode.nodeid),
        ("Recipe", first, ua.VariantType.ExtensionObject, recipe.nodeid),
        ("Rpm", 0.0, ua.VariantType.Float, rpm.nodeid),
    ):
        made = await types.add_variable(ua.NodeId(f"Types.{name}", space), name, value, kind, data_type)
        await made.set_writable()

    @uamethod
    def pump(parent, how, speed):
        note(what="pump", by=parent.Identifier, mode=int(how), rpm=round(speed, 3))

    given = []
    for name, data_type in (("how", mode.nodeid), ("speed", rpm.nodeid)):
        given.append(ua.Argument(Name=name, DataType=data_type, ValueRank=-1))
    one = await server.nodes.objects.add_object(ua.NodeId("Pump1", space), "Pump1")
    two = await server.nodes.objects.add_object(ua.NodeId("Pump2", space), "Pump2")
    method = await one.add_method(ua.NodeId("Pump", space), "Pump", pump, given, [])
    await two.add_reference(method, ua.ObjectIds.HasComponent)


async def secure(server, folder):
    """Encrypted, and for one user; the certificate is made anew."""
    await server.set_application_uri("urn:lab.example:shaker")
    await setup_self_signed_certificate(
        folder / "server_key.pem",
        folder / "server.der",
        "urn:lab.example:shaker",
        "127.0.0.1",
        [ExtendedKeyUsageOID.SERVER_AUTH],
        {"commonName": "shaker"},
    )
    await server.load_certificate(str(folder / "server.der"))
    await server.load_private_key(str(folder / "server_key.pem"))
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])


class OneUser:
    def get_user(self, server, username=None, password=None, certificate=None):
        if (username, password) == ("labos", "secret of the lab"):
            return User(role=UserRole.Admin)
        return None


async def main():
    folder = os.environ.get("SECURED")
    server = Server(user_manager=OneUser()) if folder else Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{sys.argv[1]}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    if folder:
        await secure(server, Path(folder))
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
    await own_types(server, space)
    async with server:
        note(what="startup")
        print("the server is up", flush=True)
        await asyncio.Event().wait()


asyncio.run(main())
