"""OPC UA servers with types of their own, shared methods, encryption and users; on ``asyncua`` 2.1.0."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.adapter import _signals, find_adapter_class
from labos.core.model import ActionSpec, Arg, Description
from labos.errors import DeviceError
from labos.node import Setup
from labos.settings import free_port
from tests.integration.adapter.test_opcua import OpcuaProcess
from tests.support.needed import need

need("asyncua", "opcua")

ANY = Arg(name="value", type="any")
NAMES = ("mode", "modes", "recipe", "rpm", "pump", "pump2")
DESCRIPTION = Description(
    driver="opcua_node",
    version="",
    description="",
    actions=tuple(ActionSpec(name=name, args=(ANY,)) for name in NAMES),
)
PUMP = {"node": "Pump", "value": ["Rough", "{value}"]}
MAPPING: dict[str, Any] = {
    "namespace": "http://lab.example/shaker",
    "actions": {
        **{
            name: {
                "start": {"node": f"Types.{name.title()}", "value": "{value}"},
                "result": f"Types.{name.title()}",
            }
            for name in NAMES[:4]
        },
        "pump": {"start": PUMP},
        "pump2": {"start": {**PUMP, "object": "Pump2"}},
    },
    "labware": {"nest": {"node": "Types.Mode", "is": "Off"}},
}


class SecuredServer(OpcuaProcess):
    """It takes encrypted connections of one user."""

    def environment(self) -> dict[str, str]:
        return {"SECURED": str(self.folder)}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpcuaProcess]:
    process = OpcuaProcess("opcua", tmp_path_factory.mktemp("opcua"), free_port())
    try:
        yield process.start()
    finally:
        process.kill()


def with_node(port: int, use: Callable[[Any], Awaitable[None]], **config: Any) -> None:
    """An adapter's node, connected to that server."""

    async def main() -> None:
        told = {"opcua_url": f"opc.tcp://127.0.0.1:{port}/", "opcua": MAPPING, "poll_s": 0.1, **config}
        node = find_adapter_class("opcua_node", DESCRIPTION)(Setup("plc", "cell", told))
        try:
            await node.connect()
            await use(node)
        finally:
            await node.close()

    asyncio.run(main())


def test_values_are_read_and_written_in_the_servers_own_types(server: OpcuaProcess) -> None:
    recipe = {"Mode": "Off", "Steps": [3, 4, 5], "Name": "mine"}

    async def use(node: Any) -> None:
        assert not await node.trouble()
        does = node.methods()
        assert await does["mode"](value="Gentle") == "Gentle"
        assert await does["mode"](value=2) == "Off"
        assert (await node.observe())["labware"] == {"nest": True}
        assert await does["modes"](value=["Rough", "Gentle"]) == ["Rough", "Gentle"]
        assert await does["recipe"](value=recipe) == recipe
        assert await does["rpm"](value=12) == 12.0
        for action, value, words in (
            ("mode", "Wild", r"the enumeration has Gentle \(0\), Rough \(1\), Off \(2\)"),
            ("mode", 7, "the enumeration has Gentle"),
            ("recipe", {"Mode": "Off", "Nam": 1}, "has no 'Nam', needs 'Steps', needs 'Name'"),
            ("recipe", {**recipe, "Mode": "Wild"}, "the enumeration has"),
        ):
            with pytest.raises(DeviceError, match=words) as caught:
                await does[action](value=value)
            assert caught.value.effects == "none"

    with_node(server.port, use)


def test_a_method_that_two_objects_share_is_called_on_the_one_that_is_meant(server: OpcuaProcess) -> None:
    async def use(node: Any) -> None:
        await node.methods()["pump2"](value=2.5)
        assert server.truth("pump") == [{"what": "pump", "by": "Pump2", "mode": 1, "rpm": 2.5}]
        with pytest.raises(DeviceError, match=r"several objects .*=Pump1.*=Pump2.*`object:`") as caught:
            await node.methods()["pump"](value=2.5)
        assert caught.value.effects == "none"
        assert len(server.truth("pump")) == 1

    with_node(server.port, use)


def test_an_object_is_nothing_to_epics() -> None:
    mapping = {"actions": {name: {"start": {"pv": "X", "object": "Y"}} for name in NAMES}}

    async def main() -> None:
        node = find_adapter_class("epics_node", DESCRIPTION)(Setup("plc", "cell", {"epics": mapping}))
        with pytest.raises(DeviceError, match="`object` is for methods of OPC UA"):
            await node.connect()

    asyncio.run(main())


def own_certificate(folder: Path) -> dict[str, str]:
    """A client's certificate and key, as files."""
    from asyncua.crypto.cert_gen import setup_self_signed_certificate
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key, certificate = folder / "labos_key.pem", folder / "labos.der"
    making = setup_self_signed_certificate(
        key,
        certificate,
        "urn:lab.example:labos",
        socket.gethostname(),
        [ExtendedKeyUsageOID.CLIENT_AUTH],
        {"commonName": "labos"},
    )
    asyncio.run(making)
    return {"opcua_certificate": str(certificate), "opcua_key": str(key)}


@pytest.mark.slow
def test_an_encrypted_server_lets_the_right_user_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = SecuredServer("opcua", tmp_path / "server", free_port())
    (password := tmp_path / "password").write_text("secret of the lab\n")
    try:
        server.start()
        told = {
            "opcua_policy": "Basic256Sha256",
            "opcua_server_certificate": str(server.folder / "server.der"),
            "opcua_user": "labos",
            "opcua_password": str(password),
            **own_certificate(tmp_path),
        }

        async def use(node: Any) -> None:
            assert not await node.trouble()
            assert await node.methods()["mode"](value="Off") == "Off"

        with_node(server.port, use, **told)
        wrong = tmp_path / "wrong"
        wrong.write_text("guessed")

        async def check_refused(node: Any) -> None:
            assert "BadUserAccessDenied" in await node.trouble()

        with_node(server.port, check_refused, **{**told, "opcua_password": str(wrong)})

        async def not_encrypted(node: Any) -> None:
            assert "here is no answer for" in await node.trouble()

        monkeypatch.setattr(_signals, "CONNECT_S", 1.5)  # it waits for all of this time
        with_node(server.port, not_encrypted)
    finally:
        server.kill()


def test_what_a_config_says_of_secrets_is_checked_before_anything_is_sent(tmp_path: Path) -> None:
    (tmp_path / "note.pem").write_text("no certificate")
    note = str(tmp_path / "note.pem")
    policy = {"opcua_policy": "Basic256Sha256"}
    for told, words in (
        ({"opcua_url": "opc.tcp://me:secret@plc/"}, "`opcua_url` contains a user"),
        ({"opcua_user": "me"}, "the password would be sent over the network unencrypted"),
        ({"opcua_user": "me", **policy, "opcua_password": "/no/file"}, "`opcua_password` names the file"),
        ({"opcua_policy": "None"}, "It is Basic256Sha256, Aes128Sha256RsaOaep or Aes256Sha256RsaPss"),
        ({"opcua_key": note}, "`opcua_key` has no effect without `opcua_policy`"),
        (policy, "`opcua_policy` needs `opcua_certificate`"),
        ({**policy, "opcua_certificate": note}, "holds no certificate"),
        ({**policy, "opcua_certificate": "/no/file"}, "cannot be read"),
    ):

        async def nothing(node: Any) -> None:
            """It is not reached."""

        with pytest.raises(DeviceError, match=words) as caught:
            with_node(1, nothing, **told)
        assert "secret" not in json.dumps(str(caught.value))
