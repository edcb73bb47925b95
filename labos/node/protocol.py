"""The messages between kernel and node: the six operations and two publications.

Keys: ``labos/<lab>/<workcell>/<module>/{about,action,reset,resources,state,admin}`` answer
queries; ``…/result/<action>`` and ``…/state`` are published. All messages are JSON.

An *attempt* is one sending of an action. A node carries out an attempt at most once, ever:
it writes the attempt to its journal before it moves, and an attempt that it was asked about and
had not heard of is written down as void before it answers.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from labos.core.effects import AnyEffect
from labos.version import VERSION

EffectsDone = Literal["all", "none", "partial", "unknown"]
NodeStatus = Literal["IDLE", "BUSY", "ERROR"]

EPOCH_JUMP = 2**32
"""How far above the greatest epoch that a node has seen the next one may lie. ``labos db restored`` and
``labos restore`` leap to the seconds since 2026, whatever the epoch was: that is never further."""

POSITION_JUMP = 2**32
"""How far an acknowledged position may lie behind the last request that the node has seen: what a lab
logs while one action lasts. A refused acknowledgement costs room in the journal, nothing else."""

ATTEMPT_JUMP = 100
"""How far an attempt may lie above the last one that the node knows of the same action; they follow each
other one by one."""

GREATEST = 2**53 - 1
"""No epoch and no position is greater: what every JSON reader reads exactly."""


class Message(msgspec.Struct, frozen=True, tag_field="op"):
    """A request to the ``action`` operation."""


class Start(Message, frozen=True, tag="start"):
    """Carry out an action. ``position`` is that of its request in the log; ``files`` maps file
    arguments to blob digests. ``effects`` are what it is to do to labware, which the node only notes: should
    the log lose its end, they report where labware may be."""

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
    """Carry out an action ``together`` with others, in one go: these are the names of all of them. The device
    begins when a start of each has come; else none of them begins. It gets one command, with the arguments of
    the first, and the outcome holds for each. A node of a version that does not know this refuses it."""

    together: tuple[str, ...]


class Ask(Message, frozen=True, tag="ask"):
    """What became of an attempt? With ``void``, one that was never heard of can never run."""

    lab: str
    epoch: int
    action: str
    attempt: int
    position: int
    void: bool = False


class Acknowledge(Message, frozen=True, tag="acknowledge"):
    """The log holds the end of every action requested from this node up to ``position``: the
    node may forget them, and refuses requests that old from now on."""

    lab: str
    epoch: int
    position: int


ActionMessage = Start | JointStart | Ask | Acknowledge


class Outcome(msgspec.Struct, frozen=True):
    """How an attempt ended. ``effects`` says how much of the declared effects took place;
    times are the node's own, UTC nanoseconds, 0 where they are not known. ``collided``: something was hit."""

    succeeded: bool
    effects: EffectsDone
    result: Any = None
    error: str = ""
    started_ns: int = 0
    ended_ns: int = 0
    collided: bool = False


class ActionReply(msgspec.Struct, frozen=True):
    """The node's word about an attempt.

    ``accepted``/``running``: it is being carried out. ``finished``: see ``outcome``; also the
    answer to a start that was over at once.
    ``refused``: it was not and will not be carried out, ``why`` tells; its journal knows it as
    void from then on, unless no kernel can have sent it. ``void``: it never ran and can never run.
    ``unheard``: it never ran, but may yet if it is still on its way. ``interrupted``: the node died
    while it ran, or its device cannot say how it ended; ``why`` tells.
    ``forgotten``: it is older than what the lab acknowledged. ``fenced``: the asker's lab or
    epoch is not the one this node serves. ``done``: the acknowledgement is kept.

    ``attempt`` is the attempt that the status speaks of: an earlier one than the one asked
    about, if that one ran; 0 if none. ``transient`` marks a refusal that may not be repeated
    later (busy, in error), unlike one of a wrong argument.
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
    """Published when an attempt has ended, unless the answer to its start told so already. It is used as it
    is if it comes under the key of the module that was asked, and fits the request in journal, attempt and
    time (``ended_ns`` within 10 s of when it can have been); else the node is asked."""

    action: str
    attempt: int
    journal: str
    outcome: Outcome


class StateReport(msgspec.Struct, frozen=True):
    """The ``state`` operation's answer, and the heartbeat. ``running``, ``finished`` and
    ``interrupted`` name actions that the lab has not acknowledged, so that a lost result is
    noticed. ``stopped_at`` (UTC ns, 0: it was not) and ``stopped_by`` report an emergency stop until the
    module is reset, so that it is recorded even if the log could not be written at the time."""

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
    """The ``resources`` operation's answer: levels as the device itself reports them."""

    levels: dict[str, float] = {}
    error: str = ""


class Unacknowledged(msgspec.Struct, frozen=True):
    """An action in a node's journal that the lab has not acknowledged. ``handle`` is the
    device's own id of it, if it has one; ``effects`` what it was to do to labware, null if nobody said."""

    action: str
    attempt: int
    name: str
    status: Literal["running", "finished", "interrupted"]
    handle: str = ""
    position: int = 0
    effects: tuple[AnyEffect, ...] | None = None


PROTOCOL = 1
"""The version of this protocol. It counts up when nodes or kernels of the version before could not go on."""

OLDEST_PROTOCOL = 1
"""The oldest version of nodes and kernels that this one works with."""


def skew_with(protocol: int, other: str, version: str) -> str:
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
    """The ``about`` operation's answer: the driver's description, which device, what is open. ``protocol``
    is the version of this protocol that the node speaks, ``labos`` its LabOS, ``unit`` the serial number of
    the device that it is pinned to, ``firmware`` the version that the device tells, ``metrics`` the address
    (``host:port``) at which Prometheus asks the node; all may be empty.
    ``digest`` is that of the description. ``epoch`` is that of the kernel that the node obeys;
    ``acknowledged`` is the position up to which a kernel of epoch ``acknowledged_by`` told it that the
    log holds the end of everything, so that a log that was put back from an older copy is noticed.
    ``now_ns`` is the time by the clock of the node's host (UTC ns; 0: not told)."""

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
    """A starting node asks the kernel what its module is: ``workcell/module``."""

    module: str


class SetupReply(msgspec.Struct, frozen=True):
    """The module as the applied workcell describes it; ``unknown`` says why there is none.
    ``interface`` is how a foreign node is reached, ``about`` the description that the workcell file
    gives where no driver does, ``extends`` what it says beyond the driver's. ``protocol`` is the version of
    this protocol that the kernel speaks, ``labos`` its LabOS."""

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
    """A node asks for a part of a file, from ``offset``; ``digest`` is the SHA-256 of the whole."""

    digest: str
    offset: int = 0


class KeepFile(Message, frozen=True, tag="keep"):
    """A node hands over a part of a file of ``size`` bytes. An empty part asks how much is there."""

    digest: str
    size: int
    offset: int = 0
    data: bytes = b""


FileRequest = FetchFile | KeepFile


class FileReply(msgspec.Struct, frozen=True):
    """``data`` is what was fetched, of ``size`` bytes in all; ``received`` how many bytes of a file
    that is handed over are there, all of them once it is kept for good. ``problem`` says why not."""

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
        """``module`` is ``workcell/module``."""
        return f"{self.root}/{module}/{operation}"

    def result(self, module: str, action: str) -> str:
        return f"{self.root}/{module}/result/{action}"

    def alive(self, module: str, instance: str) -> str:
        return f"{self.root}/@alive/{module}/{instance}"

    def name(self, module: str, instance: str, stage: str) -> str:
        """Liveliness of a node that ``wants`` the module's name, or ``has`` it."""
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
        """Where the kernel answers SetupRequests."""
        return f"{self.root}/@setup"

    def setup_of(self, module: str) -> str:
        """The same for one module: on a secure bus its node may ask here only."""
        return f"{self.root}/@setup/{module}"

    @property
    def all_setups(self) -> str:
        return self.setup_of("*/*")

    @property
    def files(self) -> str:
        """Where the kernel answers FileRequests."""
        return f"{self.root}/@files"

    def requests_of(self, process: str, epoch: int | str) -> str:
        """Where the kernel of an epoch answers an API process."""
        return f"{self.root}/@requests/{process}/{epoch}"

    def events(self, family: str) -> str:
        return f"{self.root}/@events/{family}"

    @staticmethod
    def lab_of(key: str) -> str:
        return key.split("/")[1]

    @staticmethod
    def module_of(key: str) -> str:
        """``workcell/module`` of an operation, result or alive key."""
        parts = key.split("/")
        start = 3 if parts[2] == "@alive" else 2
        return f"{parts[start]}/{parts[start + 1]}"
