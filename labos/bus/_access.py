"""The access rules of Zenoh for a secure bus: which party may send and receive which messages.

Everything that no rule allows is denied, without an error on either side. A rule's keys must include the
whole key that a party declares or queries: a subscription to ``labos/**`` is denied although
``labos/L/cell/arm/state`` would be allowed. ``**`` never matches a part that begins with ``@``, so such parts
are written out.

=======  ===================================================================================
node     answers and publishes for its module, shows its own liveliness, queries the kernel
kernel   queries and receives from the nodes of its lab, answers them, publishes events
api      sends the requests of its users to the kernel, under its own name
viewer   receives the states, results and events of its lab
stop     sees which nodes live in its lab, and may query `admin`, which stops modules
bus      runs the bus; it gets no access as a party
all      send a list of members, which is valid only if the authority has signed it
=======  ===================================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from labos.node.protocol import ANY_KERNEL, Keys
from labos.pki import PROCESS_NAME, CertificateEntry, PartyIdentity

ROUND_TRIP = "labos/@round-trip"
"""A key that an open router shows. A query for it returns after all declarations before it have arrived."""

MEMBERS = "labos/@members"
"""The key on which lists of members are sent. Every holder of a certificate of the authority may send there,
even if it is not in the present list: a kernel with a new certificate brings the list that contains it."""

IN, OUT = "ingress", "egress"
ALL = "all"
"""The rule and the subject for all parties."""

Rule = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Flows, messages, keys."""


def make_access_control(entries: Iterable[CertificateEntry]) -> dict[str, Any]:
    """The part ``access_control`` of Zenoh's configuration, for certificates that are not revoked."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for number, entry in enumerate(e for e in entries if not e.revoked_at):
        named = []
        for flows, messages, keys in _list_rules(entry.identity):
            named.append(f"r{len(rules)}")
            rules.append(_make_rule(named[-1], flows, messages, keys))
        if named:
            subjects.append({"id": f"s{number}", "cert_common_names": [entry.common_name]})
            policies.append({"rules": named, "subjects": [f"s{number}"]})
    rules.append(_make_rule(ALL, (IN,), ("put",), (MEMBERS,)))
    subjects.append({"id": ALL})
    policies.append({"rules": [ALL], "subjects": [ALL]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _make_rule(
    name: str, flows: Sequence[str], messages: Sequence[str], keys: Sequence[str]
) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows),
        "messages": list(messages),
        "key_exprs": list(keys),
    }


def _list_rules(who: PartyIdentity) -> Iterator[Rule]:
    if who.kind == "bus":
        return
    keys = Keys(who.lab)
    yield (IN,), ("liveliness_query",), (ROUND_TRIP,)
    yield (OUT,), ("liveliness_token",), (ROUND_TRIP,)
    match who.kind:
        case "node":
            yield from _list_node_rules(keys, who.name)
        case "kernel":
            yield from _list_kernel_rules(keys)
        case "api":
            if PROCESS_NAME.fullmatch(who.name):
                yield from _allow_seeing(keys.kernel)
                yield from _allow_asking(keys.requests_of(who.name, "*"))
        case "viewer":
            yield from _allow_hearing(f"{keys.root}/**", keys.events("**"))
            yield from _allow_seeing(keys.all_alive, ANY_KERNEL)
        case "stop":
            yield from _allow_asking(keys.operation("*/*", "admin"))
            yield from _allow_seeing(keys.all_alive, ANY_KERNEL)


def _list_node_rules(keys: Keys, module: str) -> Iterator[Rule]:
    own = keys.operation(module, "**")
    alive, named = keys.alive(module, "*"), keys.name(module, "*", "*")
    yield from _allow_answering(own)
    yield (IN,), ("put",), (own,)
    yield (IN,), ("liveliness_token",), (alive, named)
    yield from _allow_seeing(alive, named, ANY_KERNEL)
    yield from _allow_asking(keys.setup_of(module), keys.files)


def _list_kernel_rules(keys: Keys) -> Iterator[Rule]:
    yield from _allow_asking(keys.operation("*/*", "*"))
    yield from _allow_answering(keys.all_setups, keys.files, keys.requests_of("*", "*"))
    yield (IN,), ("put",), (keys.events("*"),)
    yield from _allow_hearing(keys.all_results, keys.all_states, MEMBERS)
    yield (IN,), ("liveliness_token",), (keys.kernel,)
    yield from _allow_seeing(keys.all_alive)


def _allow_asking(*keys: str) -> Iterator[Rule]:
    yield (IN,), ("query",), keys
    yield (OUT,), ("reply",), keys


def _allow_answering(*keys: str) -> Iterator[Rule]:
    yield (IN,), ("declare_queryable", "reply"), keys
    yield (OUT,), ("query",), keys


def _allow_hearing(*keys: str) -> Iterator[Rule]:
    yield (IN,), ("declare_subscriber",), keys
    yield (OUT,), ("put",), keys


def _allow_seeing(*keys: str) -> Iterator[Rule]:
    yield (IN,), ("liveliness_query", "declare_liveliness_subscriber"), keys
    yield (OUT,), ("liveliness_token",), keys
