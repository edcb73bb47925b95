"""The class of a module's node: that of its driver or adapter, with the additions of the workcell file.

Specs are read only if a file has such additions, because this takes time and memory that other nodes do not
need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from labos.bootstrap._drivers import load_driver
from labos.errors import BadInput
from labos.node.node import Node
from labos.node.protocol import SetupReply

if TYPE_CHECKING:
    from labos.core.model import Description


def find_foreign_class(module: str, reply: SetupReply) -> type[Node]:
    """The adapter of a foreign node. Raises BadInput, NotFound."""
    from labos.adapter import find_adapter_class
    from labos.spec.interfaces import REMEDY, explain_unreachable

    if why := explain_unreachable(reply.interface):
        raise BadInput(f"{module} cannot be reached: {why}", remedy=REMEDY)
    described = _describe(reply) if reply.about else load_driver(reply.driver).describe()
    return find_adapter_class(reply.interface, _extend(described, reply))


def find_own_class(module: str, reply: SetupReply, driver: type[Node] | None = None) -> type[Node]:
    """LabOS' own node: of ``driver`` if it is given, otherwise of the driver that the workcell names. On a
    simulated bench, actions that no driver knows are simulated from their description. Raises BadInput,
    NotFound."""
    if reply.about and not reply.simulated:
        raise BadInput(
            f"{module} is described by `about:`, but its interface is missing.",
            remedy="Write its `interface:` and address in the workcell file, or give it a `driver:`.",
        )
    if reply.extends and not reply.simulated:
        raise BadInput(
            f"{module} has actions (`extends:`) that the driver {reply.driver} does not have.",
            remedy="Write the `interface:` of the node that has them, or leave `extends:` out.",
        )
    if reply.about:
        from labos.node.generic import make_generic_node

        return make_generic_node(_extend(_describe(reply), reply))
    found = (driver or load_driver(reply.driver)).for_config(reply.config)
    if reply.extends:
        from labos.node.generic import extend_node

        return extend_node(found, _extend(found.describe(), reply))
    return found


def _describe(reply: SetupReply) -> Description:
    from labos.spec.about import About, add_reset, make_description

    return add_reset(make_description(About.model_validate(reply.about), reply.driver))


def _extend(description: Description, reply: SetupReply) -> Description:
    if not reply.extends:
        return description
    from labos.spec.about import Extends, extend

    return extend(description, Extends.model_validate(reply.extends))
