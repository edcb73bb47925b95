"""EPICS: process variables over Channel Access and PV Access."""

from __future__ import annotations

from labos.adapter._channels import Channels
from labos.adapter._signals import SignalNode
from labos.errors import DeviceError
from labos.spec.signals import Protocol


class EpicsNode(SignalNode):
    """Config: ``epics`` (the mapping); ``ca_address`` and ``pva_address``, the addresses of the IOCs, instead
    of EPICS' own environment variables."""

    table = "epics"

    @property
    def where(self) -> str:
        config = self.setup.config
        addresses = " ".join(str(config[key]) for key in ("ca_address", "pva_address") if config.get(key))
        return f"the IOC at {addresses}" if addresses else "the IOC"

    def client(self, protocol: Protocol) -> Channels:
        address = str(self.setup.config.get(f"{protocol}_address") or "")
        files = [name for action in self.mapping.actions.values() for name in action.files.values()]
        numbers = frozenset(self.mapping.find(name)[1] for name in (*self.mapping.numbers, *files))
        if protocol == "ca":
            from labos.adapter._epics_ca import CaChannels

            return CaChannels(address, numbers)
        if protocol == "pva":
            from labos.adapter._epics_pva import PvaChannels

            return PvaChannels(address, numbers)
        raise DeviceError(f"EPICS has no protocol {protocol!r}; it has ca and pva.", effects="none")
