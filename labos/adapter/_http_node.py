"""The common part of the adapters for HTTP nodes: one connection, and its address."""

from __future__ import annotations

from labos.adapter._foreign import ForeignNode
from labos.adapter._http import HttpClient
from labos.errors import DeviceError
from labos.node.node import Setup


class HttpNode(ForeignNode):
    """``connect`` sets ``_http``."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._http: HttpClient | None = None

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
