"""The message bus between kernel, nodes and applications."""

from labos.bus._zenoh import ZenohBus, open_bus

__all__ = ["ZenohBus", "open_bus"]
