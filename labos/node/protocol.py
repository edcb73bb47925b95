"""The messages between kernel and node: the six operations and two publications.

Keys: ``labos/<lab>/<workcell>/<module>/{about,action,reset,resources,state,admin}`` answer queries;
``…/result/<action>`` and ``…/state`` are published. All messages are JSON.

An *attempt* is one sending of an action. A node carries out an attempt at most once, ever: it writes the
attempt to its journal before it moves, and if it is asked about an attempt that it has not received, it
records the attempt as void before it answers.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from labos.core.effects import AnyEffect
from labos.version import VERSION

EffectsDone = Literal["all", "none", "partial", "unknown"]
NodeStatus = Literal["IDLE", "BUSY", "ERROR"]

EPOCH_JUMP = 2**32
"""The largest step from the greatest epoch that a node has seen to the next one. ``labos db restored`` and
``labos restore`` set the epoch to the seconds since 2026, from any epoch before: this step is never
larger."""

POSITION_JUMP = 2**32
"""The largest distance of an acknowledged position from the last request that the node has seen: what a lab
logs during one action. A refused acknowledgement only costs space in the journal."""

ATTEMPT_JUMP = 100
"""The largest step from the last known attempt of an action to the next one; attempts are numbered one by
one."""

GREATEST = 2**53 - 1
"""The greatest epoch or position: every JSON reader reads numbers up to this one exactly."""


class Message(msgspec.Struct, frozen=True, tag_field="op"):
    """A request to the ``action`` operation."""


class Start(Message, frozen=True, tag="start"):
    """Carry out an action. ``position`` is the position of its request in the log. ``files`` maps file
    arguments to digests of blobs. ``effects`` are the planned effects on labware. The node only stores them:
    if the log loses its end, they show where labware may be."""

    lab: str
    epoch: int
    journal: str
    action: str
    attempt: int
    position: int
    name: str
    args: dict[str, Any] = {}
    files: dict[str, str] = {}
    effects: tuple[AnyEffect, ...] | None = None


class JointStart(Start, frozen=True, tag="start_together", kw_only=True):
    """Carry out an action ``together`` with others, at once: these are the ids of all of them. The device
    begins when a start of each has arrived; otherwise none of them begins. It gets one command, with the
    arguments of the first, and the outcome is valid for each. A node of an older version refuses this
    message."""

    together: tuple[str, ...]


class Ask(Message, frozen=True, tag="ask"):
    """Ask for the outcome of an attempt. With ``void``, an attempt that the node does not know can never run
    afterwards."""

    lab: str
    epoch: int
    action: str
    attempt: int
    position: int
    void: bool = False


class Acknowledge(Message, frozen=True, tag="acknowledge"):
    """The log contains the end of every action that was requested from this node up to ``position``. The node
    may forget these actions, and from now on refuses requests with such a position."""

    lab: str
    epoch: int
    position: int


ActionMessage = Start | JointStart | Ask | Acknowledge


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of an attempt. ``effects`` says how much of the declared effects took place. Times are by
    the node's clock, in UTC nanoseconds; 0 if not known. ``collided``: there was a collision."""

    succeeded: bool
    effects: EffectsDone
    result: Any = None
    error: str = ""
    started_ns: int = 0
    ended_ns: int = 0
    collided: bool = False


class ActionReply(msgspec.Struct, frozen=True):
    """The node's answer about an attempt.

    ``accepted``/``running``: it is being carried out. ``finished``: see ``outcome``; also the answer to a
    start if the action has already ended. ``refused``: it was not and will not be carried out, for the reason
    ``why``. The journal then has it as void, unless no kernel can have sent it. ``void``: it never ran and
    can never run. ``unheard``: it did not run, but the request may still arrive. ``interrupted``: the node
    ended while the action was under way, or its device cannot report the outcome; ``why`` is the reason.
    ``forgotten``: it is older than the position that the lab acknowledged. ``fenced``: the lab or epoch of
    the request is not the one of this node. ``done``: the acknowledgement is stored.

    ``attempt`` is the attempt to which the status belongs: an earlier one than the requested one, if the
    earlier one ran; 0 if none. ``transient``: the reason of the refusal can pass (busy, in error), unlike a
    wrong argument.
    """

    status: Literal[
        "accepted",
        "running",
        "finished",
        "refused",
        "void",
        "unheard",
        "interrupted",
        "forgotten",
        "fenced",
        "done",
    ]
    journal: str
    why: str = ""
    outcome: Outcome | None = None
    attempt: int = 0
    transient: bool = False


class ResultPublished(msgspec.Struct, frozen=True):
    """Published when an attempt has ended, unless the answer to its start already contained the outcome. The
    kernel uses it if it comes under the key of the requested module, and fits the request in journal, attempt
    and time (``ended_ns`` within 10 s of the possible time). Otherwise the kernel asks the node."""

    action: str
    attempt: int
    journal: str
    outcome: Outcome


class StateReport(msgspec.Struct, frozen=True):
    """The ``state`` operation's answer, and the heartbeat. ``running``, ``finished`` and ``interrupted`` list
    actions that the lab has not acknowledged, so that a lost result is noticed. ``stopped_at`` (UTC ns; 0: no
    stop) and ``stopped_by`` report an emergency stop until the module is reset, so that it is recorded even
    if the log could not be written at that time."""

    status: NodeStatus
    journal: str
    instance: str
    running: list[str] = []
    finished: list[str] = []
    variables: dict[str, Any] = {}
    error: str = ""
    interrupted: list[str] = []
    stopped_at: int = 0
    stopped_by: str = ""


class ResourcesReport(msgspec.Struct, frozen=True):
    """The ``resources`` operation's answer: the levels that the device itself reports."""

    levels: dict[str, float] = {}
    error: str = ""


class Unacknowledged(msgspec.Struct, frozen=True):
    """An action in a node's journal that the lab has not acknowledged. ``handle`` is the device's own id for
    it, if there is one. ``effects`` are its planned effects on labware; null if not known."""

    action: str
    attempt: int
    name: str
    status: Literal["running", "finished", "interrupted"]
    handle: str = ""
    position: int = 0
    effects: tuple[AnyEffect, ...] | None = None


PROTOCOL = 1
"""The version of this protocol. It increases when nodes or kernels of the version before can no longer work
with the new ones."""

OLDEST_PROTOCOL = 1
"""The oldest version of nodes and kernels that this one works with."""


def explain_skew(protocol: int, other: str, version: str) -> str:
    """Why this LabOS and another node or kernel (``other``) cannot work together; empty if they can."""
    if OLDEST_PROTOCOL <= protocol <= PROTOCOL:
        return ""
    known = f"version {PROTOCOL}" if OLDEST_PROTOCOL == PROTOCOL else f"{OLDEST_PROTOCOL} to {PROTOCOL}"
    which = version or "of an unknown version"
    return (
        f"{other} (LabOS {which}) speaks version {protocol} of the node protocol; LabOS {VERSION} here "
        f"speaks {known}. Install the same LabOS on both computers."
    )


class AboutReport(msgspec.Struct, frozen=True):
    """The ``about`` operation's answer: the driver's description, the device, and the open actions.
    ``protocol`` is the node's version of this protocol, ``labos`` its LabOS version, ``unit`` the serial
    number of the device to which it is bound, ``firmware`` the version that the device reports, and
    ``metrics`` the address (``host:port``) of the node's metrics for Prometheus. All may be empty. ``digest``
    is the digest of the description. ``epoch`` is the epoch of the kernel that the node accepts.
    ``acknowledged`` is the position that a kernel with the epoch ``acknowledged_by`` has acknowledged, so
    that the lab notices if its log was restored from an older copy. ``now_ns`` is the time by the clock of
    the node's host (UTC ns; 0: not reported)."""

    module: str
    journal: str
    instance: str
    digest: str
    description: dict[str, Any]
    simulated: bool = False
    open: list[Unacknowledged] = []
    epoch: int = 0
    acknowledged: int = 0
    acknowledged_by: int = 0
    protocol: int = PROTOCOL
    labos: str = ""
    unit: str = ""
    firmware: str = ""
    metrics: str = ""
    now_ns: int = 0


class AdminRequest(msgspec.Struct, frozen=True):
    """A request to ``admin``; fenced like an action unless it is a stop. An emergency stop takes
    the argument ``by``, and its result is the time of the stop (UTC ns)."""

    lab: str
    epoch: int
    command: str
    args: dict[str, Any] = {}


class AdminReply(msgspec.Struct, frozen=True):
    done: bool
    why: str = ""
    result: Any = None


class SetupRequest(msgspec.Struct, frozen=True):
    """A starting node asks the kernel for the configuration of its module, ``workcell/module``."""

    module: str


class SetupReply(msgspec.Struct, frozen=True):
    """The module in the applied workcell; ``unknown`` is the reason if there is none. ``interface`` is the
    protocol of a foreign node. ``about`` is the description from the workcell file if there is no driver, and
    ``extends`` is the addition to the driver's description. ``protocol`` is the kernel's version of this
    protocol, and ``labos`` its LabOS version."""

    driver: str = ""
    config: dict[str, Any] = {}
    poses: dict[str, list[float]] = {}
    regrip: str = ""
    pace: float = 1.0
    seed: int = 0
    simulated: bool = False
    unknown: str = ""
    interface: str = ""
    about: dict[str, Any] = {}
    poses_of: dict[str, dict[str, list[float]]] = {}
    extends: dict[str, Any] = {}
    protocol: int = PROTOCOL
    labos: str = ""


class FetchFile(Message, frozen=True, tag="fetch"):
    """A node requests a part of a file, from ``offset``; ``digest`` is the SHA-256 of the whole file."""

    digest: str
    offset: int = 0


class KeepFile(Message, frozen=True, tag="keep"):
    """A node sends a part of a file of ``size`` bytes. An empty part asks how many bytes have arrived."""

    digest: str
    size: int
    offset: int = 0
    data: bytes = b""


FileRequest = FetchFile | KeepFile


class FileReply(msgspec.Struct, frozen=True):
    """``data`` is the requested part of a file of ``size`` bytes. ``received`` is the number of bytes that
    have arrived of a file which a node sends; it is the full size when the file is stored. ``problem`` is the
    reason of a failure."""

    size: int = 0
    data: bytes = b""
    received: int = 0
    problem: str = ""


ANY_KERNEL = "labos/*/@kernel"
"""The living kernels of all labs on this bus."""


class Keys:
    """The key space of one lab."""

    def __init__(self, lab: str) -> None:
        self.lab = lab
        self.root = f"labos/{lab}"

    def operation(self, module: str, operation: str) -> str:
        """The key of an operation. ``module`` is ``workcell/module``."""
        return f"{self.root}/{module}/{operation}"

    def result(self, module: str, action: str) -> str:
        return f"{self.root}/{module}/result/{action}"

    def alive(self, module: str, instance: str) -> str:
        return f"{self.root}/@alive/{module}/{instance}"

    def name(self, module: str, instance: str, stage: str) -> str:
        """The liveliness key of a node that ``wants`` the module's name, or ``has`` it."""
        return f"{self.root}/@name/{module}/{instance}/{stage}"

    @property
    def all_alive(self) -> str:
        return f"{self.root}/@alive/*/*/*"

    @property
    def all_results(self) -> str:
        return f"{self.root}/*/*/result/*"

    @property
    def all_states(self) -> str:
        return f"{self.root}/*/*/state"

    @property
    def kernel(self) -> str:
        return f"{self.root}/@kernel"

    @property
    def setup(self) -> str:
        """The key on which the kernel answers SetupRequests."""
        return f"{self.root}/@setup"

    def setup_of(self, module: str) -> str:
        """The same for one module: on a secure bus its node may query only this key."""
        return f"{self.root}/@setup/{module}"

    @property
    def all_setups(self) -> str:
        return self.setup_of("*/*")

    @property
    def files(self) -> str:
        """The key on which the kernel answers FileRequests."""
        return f"{self.root}/@files"

    def requests_of(self, process: str, epoch: int | str) -> str:
        """The key on which the kernel of an epoch answers an API process."""
        return f"{self.root}/@requests/{process}/{epoch}"

    def events(self, family: str) -> str:
        return f"{self.root}/@events/{family}"

    @staticmethod
    def lab_of(key: str) -> str:
        return key.split("/")[1]

    @staticmethod
    def module_of(key: str) -> str:
        """``workcell/module`` in an operation, result or alive key."""
        parts = key.split("/")
        start = 3 if parts[2] == "@alive" else 2
        return f"{parts[start]}/{parts[start + 1]}"
