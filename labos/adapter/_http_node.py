"""The common parts of the adapters for HTTP nodes: one connection, its address, and the offer of the node."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, ClassVar

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


class DescribedHttpNode(HttpNode):
    """For nodes that report their status and describe their actions. The description is read at the first
    connection, and again after a failure."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._is_offer_known = False

    async def read_status(self) -> Any:
        """The node's status. Raises DeviceError (``none``)."""
        raise NotImplementedError

    async def read_offer(self) -> tuple[Any, Collection[str]]:
        """The node's version, and the names of its actions. Raises DeviceError (``none``)."""
        raise NotImplementedError

    def describe_trouble(self, status: Any) -> str:
        """The trouble that a status reports, as a sentence; empty if the node can be used."""
        raise NotImplementedError

    async def trouble(self) -> str:
        try:
            status = await self.read_status()
            if not self._is_offer_known:
                version, offered = await self.read_offer()
                self.note_version(version)
                if absent := self.describe_missing(offered.__contains__):
                    return absent
                self._is_offer_known = True
        except DeviceError as missing:
            self._is_offer_known = False
            return str(missing)
        return self.describe_trouble(status)

    async def learn(self) -> None:
        if not self._is_offer_known:
            await self.trouble()
