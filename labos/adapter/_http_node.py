"""The common part of the adapters for HTTP nodes: one connection, and its address."""

from __future__ import annotations

from typing import ClassVar

from labos.adapter._foreign import ForeignNode
from labos.adapter._http import HttpClient, find_address, read_authorization
from labos.errors import DeviceError
from labos.node.node import Setup


class HttpNode(ForeignNode):
    """``addresses`` are the keys of ``config`` for the node's address; the first one is used in messages.
    ``authorization`` is the key of the file with the value of the Authorization header."""

    addresses: ClassVar[tuple[str, ...]] = ("rest_node_address", "node_url")
    authorization: ClassVar[str] = "rest_node_auth"

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._http: HttpClient | None = None

    async def connect(self) -> None:
        config = self.setup.config
        where = find_address(config, *self.addresses)
        authorization = read_authorization(config, self.authorization)
        self._http = HttpClient(where, authorization, patience_s=self.patience_s)

    @property
    def http(self) -> HttpClient:
        if self._http is None:
            raise DeviceError("The adapter is not connected.", effects="none")
        return self._http

    @property
    def where(self) -> str:
        return self.http.address

    async def close(self) -> None:
        if self._http is not None:
            await self._http.close()
