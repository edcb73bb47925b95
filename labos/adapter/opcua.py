"""OPC UA: variables and methods of a server."""

from __future__ import annotations

from typing import Any

from labos.adapter._channels import Channels
from labos.adapter._opcua_security import access_of
from labos.adapter._signals import SignalNode
from labos.spec.signals import Protocol

SERVER_START = "i=2257"
"""``Server.ServerStatus.StartTime``, which every server has."""


class OpcuaNode(SignalNode):
    """Config: ``opcua_url``; ``opcua`` (the mapping); for encryption ``opcua_policy``, ``opcua_mode``,
    ``opcua_certificate``, ``opcua_key``, ``opcua_server_certificate`` (files); ``opcua_user``, and
    ``opcua_password``, a file; ``opcua_insecure`` allows sending the password without encryption."""

    table = "opcua"

    @property
    def where(self) -> str:
        return str(self.setup.config.get("opcua_url") or "the server")

    def read_mapping(self) -> dict[str, Any]:
        return {"boot": SERVER_START, **super().read_mapping(), "protocol": "ua"}

    def client(self, protocol: Protocol) -> Channels:
        from labos.adapter._opcua import UaChannels

        config = self.setup.config
        return UaChannels(str(config.get("opcua_url") or ""), self.mapping.namespace, access_of(config))
