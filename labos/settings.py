"""The places of a lab's files, and how a running lab is found."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import sys
from pathlib import Path
from typing import TypeVar

import msgspec

from labos.errors import BadInput
from labos.private import make_folder, replace_file

S = TypeVar("S", bound=msgspec.Struct)

URL = "LABOS_URL"
HOME = "LABOS_HOME"
DATABASE = "LABOS_DATABASE_URL"
TOKEN = "LABOS_TOKEN"
TOKEN_FILE = "LABOS_TOKEN_FILE"
CA = "LABOS_CA"
OIDC = "LABOS_OIDC"
CONTACTS = "LABOS_CONTACTS"
BLOBS = "LABOS_BLOBS"
ON_DATABASE_LOSS = "LABOS_ON_DATABASE_LOSS"
DATABASE_SILENCE = "LABOS_DATABASE_SILENCE"
QUARANTINE = "LABOS_QUARANTINE"
NODE_SETTINGS = "LABOS_NODE_SETTINGS"
NODE_SETTINGS_FILE = "nodes.yaml"
PKI = "LABOS_PKI"
OTLP = "LABOS_OTLP"
ORDER = "LABOS_ORDER"
DEFAULT_HOME = "lab"
HOME_KEY = "home.key"
PATIENCE_S = 30.0
"""How long a kernel waits for its database by default."""
SILENCE_S = 10.0
"""How long a database may give no answer before it counts as lost, by default."""
PATIENCE = "5/600"
"""How often a module may fail within how many seconds, by default."""
FAILURES_KNOWN = 50
"""The number of remembered failures of each module."""


class Settings(msgspec.Struct, frozen=True):
    """One lab's folder, database and addresses.

    Ports that are None are the ones the lab had last time, else free ones. ``speed`` is the speed-up factor
    of simulated instruments, ``simulate`` says whether the bench is simulated; None for both: as this lab has
    been so far. ``wire``: simulated instruments are reached over simulated wires, if their drivers have them;
    ``trace_wires``: every byte on wires is recorded; ``node_metrics``: each node serves metrics, on a free
    port. ``on_database_loss`` is the reaction of the kernel if it cannot write its log: ``stop``, ``wait`` or
    a number of seconds to wait. ``database_silence`` is how many seconds a database may take to answer before
    it counts as lost. ``bus`` are the endpoints of a bus in a separate process (``labos bus``); empty: the
    kernel runs one. ``quarantine`` says after how many failures within how many lab seconds a module is taken
    out of service, as ``5/600``, or ``never``. ``open_to_network``: a bus that requires no certificates may
    listen on a ``host`` that other computers reach. ``tls_certificate`` and ``tls_key`` are PEM files, for
    HTTP over TLS; ``behind_proxy``: a proxy encrypts the connections; ``names`` are the host names under
    which browsers reach the lab. ``first_user`` is added to a lab that has none, with the password in the
    file ``first_password``. ``secure`` says whether the bus uses TLS and certificates (None: as at the last
    start), ``certificate`` is the folder of the kernel's own certificate if the authority is elsewhere,
    ``addresses`` are further names under which other computers reach the bus that the kernel runs. ``otlp``
    is the address of the receiver of traces, such as ``http://127.0.0.1:4318``.
    """

    home: Path
    database: str
    host: str = "127.0.0.1"
    http_port: int | None = None
    bus_port: int | None = None
    name: str = "lab"
    speed: float | None = None
    simulate: bool | None = None
    seed: int = 0
    wire: bool = False
    trace_wires: bool = False
    on_database_loss: str = ""
    database_silence: float | None = None
    bus: tuple[str, ...] = ()
    quarantine: str = ""
    open_to_network: bool = False
    node_metrics: bool = False
    secure: bool | None = None
    certificate: Path | None = None
    addresses: tuple[str, ...] = ()
    authority: Path | None = None
    names: tuple[str, ...] = ()
    tls_certificate: str = ""
    tls_key: str = ""
    behind_proxy: bool = False
    first_user: str = ""
    first_password: str = ""
    otlp: str = ""

    @classmethod
    def make(cls, home: str | Path | None = None, database: str | None = None, **more: object) -> Settings:
        """Settings from options. For a missing option: LABOS_HOME, else ``./lab``; LABOS_DATABASE_URL, else
        the database that was used there before, else a SQLite file in that folder."""
        folder = Path(home or os.environ.get(HOME) or DEFAULT_HOME).absolute()
        url = database or os.environ.get(DATABASE) or _database_of(folder)
        return cls(folder, url, **more)  # type: ignore[arg-type]

    @property
    def reopen_s(self) -> float:
        """How long the kernel waits for a database that cannot be reached. Raises BadInput."""
        value = self.on_database_loss or os.environ.get(ON_DATABASE_LOSS) or ""
        if value in ("stop", "wait"):
            return 0.0 if value == "stop" else math.inf
        with contextlib.suppress(ValueError):
            seconds = float(value or PATIENCE_S)
            if 0 <= seconds < math.inf:
                return seconds
        raise BadInput(
            f"{value!r} says nothing about a database that is gone.",
            remedy=f"Say stop, wait, or a number of seconds ({ON_DATABASE_LOSS}, --on-database-loss).",
        )

    @property
    def trace_receiver(self) -> str:
        """The address of the receiver of traces; empty for none."""
        return self.otlp or os.environ.get(OTLP) or ""

    @property
    def silence_s(self) -> float:
        """How long a database may give no answer before it counts as lost. Raises BadInput."""
        value = self.database_silence or os.environ.get(DATABASE_SILENCE) or SILENCE_S
        with contextlib.suppress(ValueError):
            seconds = float(value)
            if seconds >= 1:
                return seconds
        raise BadInput(
            f"{value!r} does not say how long a database may be silent.",
            remedy=f"Say a number of seconds, 1 at the least ({DATABASE_SILENCE}, --database-silence).",
        )

    @property
    def failures_borne(self) -> tuple[int, float]:
        """How many failures of a module lead to its quarantine, and within how many lab seconds; 0 for never.
        Raises BadInput."""
        value = self.quarantine or os.environ.get(QUARANTINE) or PATIENCE
        if value == "never":
            return 0, 0.0
        times, _, seconds = value.partition("/")
        with contextlib.suppress(ValueError):
            found = int(times), float(seconds)
            if 1 <= found[0] <= FAILURES_KNOWN and 0 < found[1] < math.inf:
                return found
        raise BadInput(
            f"{value!r} does not say how often a module may fail.",
            remedy=f"Say never, or 5/600 for five times in 600 s ({QUARANTINE}, --quarantine); "
            f"more than {FAILURES_KNOWN} times are not counted.",
        )

    @property
    def searches_order(self) -> bool:
        """Whether the lab searches for an order of all waiting runs. Raises BadInput."""
        value = os.environ.get(ORDER) or "search"
        if value in ("age", "search"):
            return value == "search"
        raise BadInput(f"{value!r} is no order of waiting runs.", remedy=f"Write age or search ({ORDER}).")

    @property
    def is_secure(self) -> bool:
        """Whether the bus uses TLS: as configured, else according to its address, else as at the last
        start."""
        if self.secure is not None:
            return self.secure
        if self.bus:
            return self.bus[0].startswith("tls/")
        last = last_kernel(self.home)
        return last is not None and last.bus.startswith("tls/")

    @property
    def pki(self) -> Path:
        """The lab's own certificate authority: the configured folder, else LABOS_PKI, else ``pki`` in the
        home."""
        return self.authority.absolute() if self.authority else self._find_file(PKI, "pki")

    def _find_file(self, variable: str, name: str) -> Path:
        """The path in a variable of the environment, else ``name`` in the home."""
        named = os.environ.get(variable)
        return Path(named).absolute() if named else self.home / name

    @property
    def contacts(self) -> Path:
        """The contacts file: LABOS_CONTACTS, else ``contacts.yaml`` in the home."""
        return self._find_file(CONTACTS, "contacts.yaml")

    @property
    def notifications(self) -> Path:
        """The outbox of notifications, with those that were sent."""
        return self.home / "notifications.db"

    @property
    def node_settings(self) -> Path:
        """Settings of nodes on this computer besides the workcell: LABOS_NODE_SETTINGS, else ``nodes.yaml``
        in the home."""
        return self._find_file(NODE_SETTINGS, NODE_SETTINGS_FILE)

    @property
    def home_key(self) -> Path:
        """A key file: with its content, the owner of the lab's folder authenticates to the running lab."""
        return self.home / HOME_KEY

    @property
    def api_key(self) -> Path:
        """A key file: with its content, API processes on this computer authenticate to the kernel, if the bus
        requires no certificates."""
        return self.home / "api.key"

    @property
    def providers(self) -> Path:
        """The file with the identity provider for signing in: LABOS_OIDC, else ``oidc.yaml`` in the home."""
        return self._find_file(OIDC, "oidc.yaml")

    @property
    def journals(self) -> Path:
        return self.home / "journals"

    @property
    def logs(self) -> Path:
        return self.home / "logs"

    @property
    def nodes(self) -> Path:
        """Notes on node processes, with which the next kernel finds them."""
        return self.home / "nodes"

    @property
    def blobs(self) -> Path | str:
        """Where large payloads are stored: LABOS_BLOBS (a folder, or a URL such as ``s3://bucket/lab``), else
        where this lab has stored them, else ``blobs`` in the home."""
        value = os.environ.get(BLOBS)
        if not value:
            known = _read(self.home / "kernel.json", KernelInfo)
            value = known.blobs if known is not None else ""
        return value if "://" in value else Path(value).absolute() if value else self.home / "blobs"

    @property
    def arriving(self) -> Path:
        """Incomplete files of nodes."""
        return self.home / "arriving"

    @property
    def worlds(self) -> Path:
        return self.home / "world"

    def files(self, module: str) -> Path:
        """The files that the node of ``workcell/module`` has fetched."""
        return self.home / "files" / module.replace("/", ".")

    def journal(self, module: str) -> Path:
        """The journal of the node of ``workcell/module``."""
        return self.journals / f"{module.replace('/', '.')}.journal"

    def unit(self, module: str) -> Path:
        """The serial number of the device of ``workcell/module``, beside its node's journal."""
        return self.journal(module).with_suffix(".unit")

    def trace(self, module: str) -> Path:
        """Every byte on the wires of the device of ``workcell/module``, if they are recorded."""
        return self.home / "traces" / f"{module.replace('/', '.')}.txt"

    def world(self, workcell: str) -> Path:
        """The simulated bench of a workcell."""
        return self.worlds / f"{workcell}.db"


class KernelInfo(msgspec.Struct, frozen=True):
    """How to reach a running lab: the content of ``<home>/kernel.json``. ``pid`` is 0 if its kernel has shut
    down properly; the file of a kernel that was killed is out of date."""

    pid: int
    url: str
    bus: str
    lab: str
    database: str
    simulated: bool = False
    speed: float = 1.0
    blobs: str = ""
    certificate: str = ""
    searches_order: bool | None = None
    """Whether it looks for an order of all waiting runs; None in a file of an older version."""


class Ports(msgspec.Struct, frozen=True):
    """The last ports of a lab: nodes that outlive a kernel look for the next one there."""

    http: int = 0
    bus: int = 0


def keep_private() -> None:
    """From now on, files that this process and its children make can be read by their owner only."""
    os.umask(0o077)


def announce(home: Path, info: KernelInfo) -> None:
    """Write down where the kernel of this lab can be reached."""
    _write(home / "kernel.json", info)


def withdraw(home: Path) -> None:
    """Write down that the kernel has ended, unless another one has written its own note since."""
    found = _read(home / "kernel.json", KernelInfo)
    if found is not None and found.pid == os.getpid():
        with contextlib.suppress(OSError):
            announce(home, msgspec.structs.replace(found, pid=0))


def lab_url() -> str:
    """The address of a lab on another computer, from LABOS_URL; empty if it is not set. Raises BadInput."""
    return check_url(os.environ.get(URL, ""), URL)


def check_url(url: str, what: str) -> str:
    """An address of a lab without its last slash; empty if there is none. Raises BadInput, which names it
    ``what``."""
    url = url.strip().rstrip("/")
    if url and not url.startswith(("http://", "https://")):
        raise BadInput(f"{what} is {url[:100]!r}, which is no address.", remedy="Write http://host:port.")
    return url


def find_kernel(home: Path) -> KernelInfo | None:
    """The kernel that runs this lab, or None."""
    info = _read(home / "kernel.json", KernelInfo)
    if info is None or not is_alive(info.pid):
        return None
    host, _, port = info.url.rpartition("/")[2].partition(":")
    try:
        socket.create_connection((host, int(port)), timeout=2.0).close()
    except (OSError, ValueError):
        return None
    return info


def last_kernel(home: Path) -> KernelInfo | None:
    """The note of the present or last kernel of this lab, whether it runs or not."""
    return _read(home / "kernel.json", KernelInfo)


def was_simulated(settings: Settings) -> bool | None:
    """Whether this lab's bench is simulated; None for a lab that has never run."""
    info = _read(settings.home / "kernel.json", KernelInfo)
    if info is not None:
        return info.simulated
    return True if settings.worlds.is_dir() else None


def remember_ports(home: Path, ports: Ports) -> None:
    _write(home / "ports.json", ports)


def last_ports(home: Path) -> Ports:
    return _read(home / "ports.json", Ports) or Ports()


def is_alive(pid: int) -> bool:
    """Whether a process with that id exists and is not a zombie."""
    if pid <= 0:
        return False
    if sys.platform == "win32":
        return _is_alive_on_windows(pid)
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    try:
        # On Linux a dead child whose exit code was not read still accepts signals.
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return True
    return stat.rpartition(")")[2].split()[:1] != ["Z"]


def free_port(host: str = "127.0.0.1") -> int:
    """A port that is free now."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def is_free(port: int, host: str = "127.0.0.1") -> bool:
    """Whether a server could listen on a port now."""
    with socket.socket() as probe:
        if os.name == "posix":
            # As servers do it: remaining connections of an earlier server do not prevent it.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True


def _is_alive_on_windows(pid: int) -> bool:
    # On Windows signal 0 is Ctrl-C, so a handle is requested instead.
    import ctypes

    kernel32 = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel32.OpenProcess(0x100000, False, pid)  # SYNCHRONIZE
    if not handle:
        return False
    try:
        return bool(kernel32.WaitForSingleObject(handle, 0) == 0x102)  # WAIT_TIMEOUT: still runs
    finally:
        kernel32.CloseHandle(handle)


def _database_of(home: Path) -> str:
    """The database that this lab has used, else its own file."""
    own = home / "labos.db"
    known = _read(home / "kernel.json", KernelInfo)
    return known.database if known is not None and not own.exists() else f"sqlite:///{own}"


def _write(path: Path, value: msgspec.Struct) -> None:
    make_folder(path.parent)
    replace_file(path, msgspec.json.encode(value) + b"\n")


def _read(path: Path, kind: type[S]) -> S | None:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None
