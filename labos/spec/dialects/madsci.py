"""The dialect of MADSci 0.8.

Workcell: the lab's ``settings.yaml`` (``workcell_nodes: {name: url}``, ``location_locations``,
``resource_default_templates``) with the ``locations.yaml`` beside it, or a workcell manager's
definition (``name, nodes, locations``). Workflow: ``name, metadata, parameters, steps[name, key,
node, action, args, locations, files, use_parameters, data_labels, conditions]``.
"""

from __future__ import annotations

from labos.spec.dialects._madsci_workcell import is_workcell, rewrite_workcell
from labos.spec.dialects._madsci_workflow import is_workflow, rewrite_workflow

__all__ = ["is_workcell", "is_workflow", "rewrite_workcell", "rewrite_workflow"]
