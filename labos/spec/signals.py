"""``epics:``, ``opcua:`` and ``sila:`` of a module's config: a table with the meaning of process variables.

Names of process variables get the ``prefix``; ``pva://NAME`` or ``ca://NAME`` selects the protocol of EPICS.
Texts may contain ``{argument}`` and ``{id}`` (LabOS' id of the action); a text that consists of only one of
these is replaced by the value itself.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, Field, model_validator

from labos.spec.parts import Many, Part, Seconds

Protocol = Literal["ca", "pva", "ua"]
PROTOCOLS: tuple[Protocol, ...] = ("ca", "pva", "ua")

Variable = Annotated[str, Field(validation_alias=AliasChoices("pv", "node", "property"))]
"""A process variable of EPICS, a node of OPC UA, a property of SiLA."""


class Put(Part):
    """A value for a process variable, or a list of arguments for a method of OPC UA. With ``callback`` the
    put ends when the record has been processed, which for a record that moves is the end of the motion.
    ``object`` is the object whose method of OPC UA is called, if several objects share the method."""

    pv: Variable
    value: Any = 1
    callback: bool = True
    object: str = ""


class Condition(Part):
    """A condition on a process variable: ``is`` one of these values or an enumeration's labels, ``near`` a
    number ``within`` a tolerance, not below ``minimum``, not above ``maximum``. With ``not``, only these
    values mean that the condition is false. Any other value means nothing, so a module does not count as
    idle, nor a place as empty."""

    pv: Variable
    is_: Any = Field(default=None, alias="is")
    not_: Any = Field(default=None, alias="not")
    near: Any = None
    within: float = 0.0
    minimum: float | None = None
    maximum: float | None = None

    @model_validator(mode="after")
    def _check_says_something(self) -> Condition:
        if self.is_ is None and self.near is None and self.minimum is None and self.maximum is None:
            raise ValueError(f"{self.pv} needs `is`, `near`, `minimum` or `maximum`")
        return self


class Actuation(Part):
    """An action: ``set`` are puts that move nothing, then one put ``start`` starts it. It is ``done`` when
    all of these conditions hold, and has ``failed`` when one of those holds. ``files`` are arrays of numbers
    that are too long for a result: each becomes a file of it, ``NAME.npy``, as numpy writes arrays."""

    start: Put
    set: Many[Put] = []
    done: Many[Condition] = []
    failed: Many[Condition] = []
    result: str | dict[str, str] = ""
    files: dict[str, str] = {}
    timeout: Seconds | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _check_names_beside_files(self) -> Actuation:
        if self.files and isinstance(self.result, str) and self.result:
            raise ValueError("beside `files`, `result` needs a name for each process variable")
        return self

    @property
    def is_proven(self) -> bool:
        """Whether its end condition contains the id of this action: then the end is certain, even after lost
        messages."""
        return any("{id}" in str(condition.is_) for condition in self.done)


class ReportedState(Part):
    """How the device says that it is busy or in error; ``why`` names a value with words."""

    busy: Many[Condition] = []
    error: Many[Condition] = []
    why: str = ""


class DeviceMapping(Part):
    """What a device reports: its state, its resources, its variables, and the labware at its stations."""

    state: ReportedState = ReportedState()
    resources: dict[str, str] = {}
    observe: dict[str, str] = {}
    labware: dict[str, Condition] = {}


class DeviceState(ReportedState):
    """``alarms`` are process variables with an alarm severity; at ``severity`` or higher, the device is in
    error."""

    alarms: list[str] = []
    severity: Literal["minor", "major", "invalid"] = "major"


class SignalMapping(DeviceMapping):
    """A device's process variables. ``boot`` names one that tells when the IOC was started. ``namespace`` is
    the URI of that of OPC UA. Arrays of characters in EPICS are texts, but for those in ``numbers``."""

    prefix: str = ""
    protocol: Protocol = "ca"
    namespace: str = ""
    actions: dict[str, Actuation]
    state: DeviceState = DeviceState()
    boot: str = ""
    reset: Many[Put] = []
    stop: Many[Put] = []
    numbers: list[str] = []

    @model_validator(mode="after")
    def _check_opcua_calls(self) -> SignalMapping:
        puts = [*self.reset, *self.stop]
        puts += [put for action in self.actions.values() for put in (action.start, *action.set)]
        if self.protocol != "ua" and (wrong := [put.pv for put in puts if put.object]):
            raise ValueError(f"{wrong[0]}: `object` is for methods of OPC UA")
        return self

    def find(self, name: str) -> tuple[Protocol, str]:
        """The protocol and the full name of a process variable."""
        for protocol in PROTOCOLS:
            if name.startswith(f"{protocol}://"):
                return protocol, self.prefix + name.removeprefix(f"{protocol}://")
        if self.protocol == "ua" and "=" in name:  # a node id is used unchanged
            return "ua", name
        return self.protocol, self.prefix + name


class SilaMapping(DeviceMapping):
    """Data that are missing in the feature definitions of a SiLA 2 server. Properties are named
    ``Feature.Property``, followed by the elements of the structure if the value is one. Commands are named
    ``Feature.Command``. ``harmless`` are the identifiers of defined errors after which nothing has moved.
    ``intermediate`` names the actions whose intermediate responses are kept. ``reset`` and ``stop`` are
    commands without parameters."""

    harmless: list[str] = []
    intermediate: list[str] = []
    reset: str = ""
    stop: str = ""

    @property
    def properties(self) -> set[str]:
        """All properties that the table names."""
        conditions = [*self.state.busy, *self.state.error, *self.labware.values()]
        names = {*self.resources.values(), *self.observe.values(), self.state.why}
        return {name for name in names | {condition.pv for condition in conditions} if name}
