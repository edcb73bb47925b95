"""Several hosts on one machine, each with network, processes, mounts and a name of its own, to be cut off.

A host is a set of Linux namespaces that lives as long as one process in it, which dies with the test. Hosts
meet at a bridge in a namespace of its own, so that nothing is changed in the network of the machine. A host
that is cut off hears and says nothing: its packets are dropped, no connection is refused or reset, and
nothing tells it.

Needs root, and a kernel that has namespaces and bridges (``why_not``).
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

NET = "10.77.0"
_CLONE_NEWNET = 0x40000000
_FOLDERS = "labos-hosts-"
_DROPPED, _FORWARDED = "0", "3"
"""States of a bridge's port: it drops all that comes and goes, or it passes it on."""

TOOLS = ("ip", "bridge", "unshare", "nsenter", "setpriv", "mount", "hostname")


def why_not() -> str:
    """Why there can be no hosts here; empty if there can be."""
    if os.name != "posix" or os.geteuid() != 0:
        return "namespaces for hosts need root"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"there is no {', '.join(missing)} here"
    try:
        with Hosts("a", "b") as hosts:
            hosts["a"].run("true")
    except (OSError, subprocess.CalledProcessError, RuntimeError) as error:
        return f"this machine makes no namespaces with a bridge: {error}"
    return ""


class Host:
    """One of them. ``folder`` is for its own files; ``mount`` puts ``/etc/labos`` and the like there."""

    def __init__(self, name: str, address: str, folder: Path) -> None:
        self.name, self.address, self.folder = name, address, folder
        self._holder = _hold(uts=True, processes=True)
        self.first = _child(self._holder)
        self.processes: list[subprocess.Popen[bytes]] = []

    @property
    def is_on(self) -> bool:
        return self._holder.poll() is None

    def argv(self, *words: str | Path, within: Path | None = None) -> list[str]:
        """A command as it is started from outside so that it runs on the host."""
        enter = [
            "nsenter",
            "-t",
            str(self.first),
            "-n",
            "-u",
            "-p",
            "-m",
            f"--wd={within or self.folder}",
            "--",
        ]
        return [*enter, "setpriv", "--pdeathsig", "KILL", *(str(word) for word in words)]

    def run(
        self, *words: str | Path, check: bool = True, within: Path | None = None, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        """Run a command on the host to its end, in a folder (the host's own)."""
        chosen = {
            "capture_output": True,
            "text": True,
            "timeout": 120,
            "stdin": subprocess.DEVNULL,
            **options,
        }
        done: subprocess.CompletedProcess[str] = subprocess.run(
            self.argv(*words, within=within), check=False, **chosen
        )
        if check and done.returncode:
            raise RuntimeError(f"{self.name}: {' '.join(map(str, words))}: {done.stdout}{done.stderr}")
        return done

    def start(
        self, *words: str | Path, log: str = "", environment: dict[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        """Start a program on the host; what it says is in ``log``, in the host's folder."""
        with (self.folder / (log or "log")).open("ab") as file:
            started = subprocess.Popen(
                self.argv(*words),
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env={**os.environ, **(environment or {})},
            )
        self.processes.append(started)
        return started

    def tell(self, started: subprocess.Popen[bytes], number: signal.Signals) -> None:
        """Send a signal to a program that ``start`` has started: `nsenter` is its parent."""
        os.kill(_child(started), number)

    def read_log(self, log: str = "log") -> str:
        path = self.folder / log
        return path.read_text(errors="replace") if path.exists() else ""

    def mount(self, place: str) -> Path:
        """Make a folder of the machine the host's own, and empty; returns where it really is."""
        own = self.folder / "root" / place.lstrip("/")
        own.mkdir(parents=True, exist_ok=True)
        Path(place).mkdir(parents=True, exist_ok=True)
        self.run("mount", "--bind", own, place)
        return own

    def give(self, place: str, text: str) -> None:
        """Let a file that is there have another content on this host."""
        own = self.folder / place.strip("/").replace("/", "-")
        own.write_text(text)
        own.chmod(0o644)
        self.run("mount", "--bind", own, place)

    def inside(self, function: Callable[[], T]) -> T:
        """Call a function whose connections are those of the host: in a thread that is in its network."""
        found: list[T] = []
        failed: list[BaseException] = []

        def work() -> None:
            try:
                with open(f"/proc/{self.first}/ns/net", "rb") as place:
                    if ctypes.CDLL(None, use_errno=True).setns(place.fileno(), _CLONE_NEWNET):
                        raise OSError(ctypes.get_errno(), "setns")
                found.append(function())
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        thread.join()
        if failed:
            raise failed[0]
        return found[0]

    def switch_off(self) -> None:
        """Its processes end at once, as when the power goes; its files stay. It does not come back."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.first, signal.SIGKILL)
        self._holder.kill()
        self._holder.wait()
        for started in self.processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                started.wait(10)
            started.kill()
            started.wait()


class Hosts:
    """Hosts by name, on one switch: 10.77.0.1 and so on, in the order of their names."""

    def __init__(self, *names: str) -> None:
        _sweep()
        self.folder = Path(tempfile.mkdtemp(prefix=f"{_FOLDERS}{os.getpid()}-", dir="/tmp"))
        self.folder.chmod(0o755)
        self._switch: subprocess.Popen[bytes] | None = None
        self._all: dict[str, Host] = {}
        self._cut: set[str] = set()
        try:
            self._switch = _hold()
            self._on_switch("ip", "link", "add", "br0", "type", "bridge")
            self._on_switch("ip", "link", "set", "br0", "up")
            for number, name in enumerate(names, 1):
                self._add(name, f"{NET}.{number}")
            self._introduce()
        except BaseException:
            self.remove()
            raise

    def __getitem__(self, name: str) -> Host:
        return self._all[name]

    def __iter__(self) -> Any:
        return iter(self._all.values())

    def __enter__(self) -> Hosts:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()

    def cut(self, *names: str) -> None:
        """From now on nothing reaches these hosts, and nothing comes from them, without a word to anybody."""
        for name in names:
            self._port(name, _DROPPED)
            self._cut.add(name)

    def heal(self, *names: str) -> None:
        """The hosts (all that are cut off) are reached again."""
        for name in names or sorted(self._cut):
            self._port(name, _FORWARDED)
            self._cut.discard(name)

    def remove(self) -> None:
        for host in self._all.values():
            host.switch_off()
        if self._switch is not None:
            self._switch.kill()
            self._switch.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _add(self, name: str, address: str) -> None:
        folder = self.folder / name
        folder.mkdir()
        host = self._all[name] = Host(name, address, folder)
        assert self._switch is not None
        near, far = str(_child(self._switch)), str(host.first)
        pair = ("type", "veth", "peer", "name", "eth0", "netns", far)
        _do("ip", "link", "add", f"p-{name}", "netns", near, *pair)
        self._on_switch("ip", "link", "set", f"p-{name}", "master", "br0")
        self._on_switch("ip", "link", "set", f"p-{name}", "up")
        host.run("ip", "link", "set", "lo", "up")
        host.run("ip", "address", "add", f"{address}/24", "dev", "eth0")
        host.run("ip", "link", "set", "eth0", "up")
        host.run("hostname", name)

    def _introduce(self) -> None:
        """Every host knows every name, and every hardware address, as with a router in between: a host that
        is cut off is not reported as unreachable."""
        names = "".join(f"{host.address} {host.name} {host.name}.example.org\n" for host in self)
        for host in self:
            host.give("/etc/hosts", f"127.0.0.1 localhost\n{names}")
        shown = {h.name: h.run("ip", "-j", "link", "show", "eth0").stdout for h in self}
        link = {name: json.loads(text)[0]["address"] for name, text in shown.items()}
        for host in self:
            lines = [
                f"neigh replace {other.address} lladdr {link[other.name]} dev eth0 nud permanent"
                for other in self
                if other is not host
            ]
            host.run("ip", "-batch", "-", input="\n".join(lines), stdin=None)

    def _port(self, name: str, state: str) -> None:
        self._on_switch("bridge", "link", "set", "dev", f"p-{name}", "state", state)

    def _on_switch(self, *words: str) -> None:
        assert self._switch is not None
        _do("nsenter", "-t", str(_child(self._switch)), "-n", "--", *words)


def _sweep() -> None:
    """Folders of tests that were killed; their processes and networks are gone already."""
    for folder in Path("/tmp").glob(f"{_FOLDERS}*-*"):
        owner = folder.name.removeprefix(_FOLDERS).partition("-")[0]
        if owner.isdigit() and not Path(f"/proc/{owner}").exists():
            shutil.rmtree(folder, ignore_errors=True)


def _hold(*, uts: bool = False, processes: bool = False) -> subprocess.Popen[bytes]:
    """Namespaces that end with this thread's process: with the first process of a set of processes all of it
    ends, and with the last process in a network the network."""
    own = ["--uts"] if uts else []
    own += ["--pid", "--mount", "--mount-proc"] if processes else []
    argv = ["setpriv", "--pdeathsig", "KILL", "unshare", "--net", *own, "--fork", "--kill-child"]
    holder = subprocess.Popen(
        [*argv, "sh", "-c", "echo; exec sleep infinity"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert holder.stdout is not None
    if holder.stdout.readline() != b"\n":
        holder.kill()
        holder.wait()
        holder.stdout.close()
        raise RuntimeError("unshare failed")
    holder.stdout.close()
    return holder


def _child(parent: subprocess.Popen[bytes]) -> int:
    """The first process that a process has started."""
    words = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    if not words:
        raise ProcessLookupError(f"process {parent.pid} has no child")
    return int(words[0])


def _do(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=30)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
