"""A question of each type, with names in all fields."""

from __future__ import annotations

from labos.core.effects import Move, Take
from labos.core.ids import ActionId, ExperimentId, LabwareId, StationName
from labos.core.topics import (
    AnyTopic,
    Approval,
    Barcode,
    BookedPlace,
    ClosingWaits,
    DeviceWaits,
    DiscoveredAction,
    DoubtfulNode,
    FailedStep,
    LateResult,
    LateStep,
    LeftLabware,
    LostExperiment,
    LostLabware,
    NotSeen,
    OutrankedNode,
    PlannedWork,
    SecondPerson,
    SeenElsewhere,
    ShorterLog,
    Unexpected,
    UnknownAction,
)

A, B = StationName("c/a"), StationName("c/b")
P1, P2 = LabwareId("P1"), LabwareId("P2")
ACTION = ActionId("A1")
MOTIONS = (Move(A, B, labware=P1), Take(StationName("c/s"), B, labware=P2))

TOPICS: list[AnyTopic] = [
    UnknownAction(run="R1", module="c/m", action=ACTION),
    LostLabware(run="R1", module="c/m", action=ACTION, motions=MOTIONS),
    LeftLabware(run="R1", labware=(P1, P2)),
    LeftLabware(module="c/m", labware=(P1,), lost_by="A1"),
    DiscoveredAction(module="c/m", action=ACTION),
    LateResult(module="c/m", action=ACTION),
    NotSeen(module="c/m", station=A, labware=(P1, P2)),
    SeenElsewhere(module="c/m", station=A, labware=P1, recorded=B, others=(P2,)),
    SeenElsewhere(station=A, labware=P1),
    Unexpected(module="c/m", station=A, type="plate96"),
    Unexpected(module="c/m", station=A),
    LostExperiment(experiment=ExperimentId("E1")),
    LateStep(run="R1#2", step=3),
    FailedStep(run="R1", module="c/m", step=12),
    Barcode(run="R1", module="c/m", action=ACTION, labware=P1, station=A, barcode="77", other=P2),
    Barcode(run="R1", module="c/m", action=ACTION, labware=P1, station=A, barcode="77"),
    PlannedWork(run="R1", module="c/m", action=ACTION),
    DoubtfulNode(module="c/m"),
    OutrankedNode(module="c/m"),
    ShorterLog(),
    DeviceWaits(run="R1", module="c/m"),
    ClosingWaits(run="R1", user=""),
    SecondPerson(run="R1", module="c/m"),
    Approval(run="R1", about="R1", digest="ab" * 32, what="run"),
    Approval(about="C1", digest="ab" * 32, what="amendment"),
    BookedPlace(module="c/m", booking="B3", labware=(P1,)),
    BookedPlace(module="c/m", booking="B3", action=ACTION),
]
