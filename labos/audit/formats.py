"""A graph for other programs: Graphviz' DOT and W3C PROV-JSON."""

from __future__ import annotations

from typing import Any

from labos.audit._facts import describe_entity
from labos.audit.graph import ACTIVITIES, AGENTS, Entity, Graph
from labos.errors import BadInput

NAMESPACE = "https://labos.invalid/log/"
"""The namespace for ids of this lab's entities; it is not a web address."""

_SHAPES = {**dict.fromkeys(ACTIVITIES, "box"), **dict.fromkeys(AGENTS, "house")}


def as_dot(graph: Graph) -> str:
    """For `dot -Tsvg`: activities are boxes, agents houses, everything else ellipses."""
    lines = ["digraph provenance {", "  rankdir=LR;"]
    for entity in _list_things(graph):
        shape = _SHAPES.get(entity.kind, "ellipse")
        words = _quote(describe_entity(entity, graph.entities.get(str(entity), graph.facts)))
        lines.append(f"  {_quote(str(entity))} [label={words}, shape={shape}];")
    for link in graph.links:
        ends = f"{_quote(str(link.effect))} -> {_quote(str(link.cause))}"
        lines.append(f"  {ends} [label={_quote(link.relation)}];")
    return "\n".join([*lines, "}"])


def as_prov(graph: Graph, lab: str) -> str:
    """PROV-JSON. Raises BadInput without the library `prov`."""
    try:
        from prov.model import ProvDocument
    except ModuleNotFoundError:
        raise BadInput(
            "The library prov, which writes PROV, is not installed.",
            remedy='Run: pip install "labos-sdl[provenance]"',
        ) from None
    document = ProvDocument()
    document.add_namespace("labos", NAMESPACE)
    document.set_default_namespace(f"{NAMESPACE}{lab}/")
    for entity in _list_things(graph):
        _declare(document, entity, graph.entities.get(str(entity), graph.facts))
    for link in graph.links:
        _relate(document, link.effect, link.cause, link.relation)
    return str(document.serialize(format="json", indent=1))


def _declare(document: Any, entity: Entity, facts: dict[str, Any]) -> None:
    attributes = {f"labos:{name}": _value(value) for name, value in facts.items() if value != []}
    attributes = {
        "prov:label": describe_entity(entity, facts),
        "prov:type": f"labos:{entity.kind}",
        **attributes,
    }
    if entity.kind in ACTIVITIES:
        began = facts.get("requested_at") or facts.get("submitted_at") or facts.get("started_at")
        document.activity(_make_id(entity), began, facts.get("ended_at"), attributes)
    elif entity.kind in AGENTS:
        document.agent(_make_id(entity), attributes)
    else:
        document.entity(_make_id(entity), attributes)


def _relate(document: Any, effect: Entity, cause: Entity, relation: str) -> None:
    """The relation of PROV for the kinds of both ends; LabOS' own relation becomes the role."""
    ends = (_make_id(effect), _make_id(cause))
    role = {"prov:role": relation}
    if effect.kind in ACTIVITIES:
        if cause.kind in AGENTS:
            document.wasAssociatedWith(*ends, other_attributes=role)
        elif cause.kind in ACTIVITIES:
            document.wasInformedBy(*ends, other_attributes={"labos:relation": relation})
        else:
            document.used(*ends, other_attributes=role)
    elif cause.kind in ACTIVITIES:
        document.wasGeneratedBy(*ends, other_attributes=role)
    elif cause.kind in AGENTS:
        document.wasAttributedTo(*ends, other_attributes={"labos:relation": relation})
    else:
        document.wasDerivedFrom(*ends, other_attributes={"labos:relation": relation})


def _list_things(graph: Graph) -> list[Entity]:
    found = {graph.subject: True}
    for link in graph.links:
        found[link.effect] = found[link.cause] = True
    return list(found)


def _make_id(entity: Entity) -> str:
    """A local name; forbidden characters are written as %XX."""
    from urllib.parse import quote

    return f"{entity.kind}.{quote(entity.name, safe='')}"


def _value(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool) else str(value)


def _quote(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
