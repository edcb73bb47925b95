"""Adapters: each makes a node that speaks another protocol a native one.

``interface:`` in a workcell file names the adapter. It runs as a LabOS node beside the foreign one,
keeps LabOS' journal, and says of every action that it was done, that it failed, that it still runs,
or that nobody can know. What exactly-once means with each protocol stands in docs/adapters.md.
"""

from labos.adapter._foreign import ForeignNode, adapt
from labos.adapter.registry import ADAPTERS, adapter_class, describe_foreign

__all__ = ["ADAPTERS", "ForeignNode", "adapt", "adapter_class", "describe_foreign"]
