"""Adapters: each makes a node with another protocol usable like a native node.

``interface:`` in a workcell file names the adapter. It runs as a LabOS node beside the foreign one and has a
LabOS journal. For every action, it reports that it was done, that it failed, that it is still running, or
that its outcome is unknown. docs/adapters.md describes what exactly-once means with each protocol.
"""

from labos.adapter._foreign import ForeignNode, adapt
from labos.adapter.registry import ADAPTERS, describe_foreign, find_adapter_class

__all__ = ["ADAPTERS", "ForeignNode", "adapt", "describe_foreign", "find_adapter_class"]
