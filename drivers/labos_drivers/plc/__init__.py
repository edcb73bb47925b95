"""PLC with a Modbus interface, over TCP or a serial line."""

from labos_drivers.plc.interface import Plc

__all__ = ["Plc"]
