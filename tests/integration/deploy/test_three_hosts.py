"""The page that installs a lab on three hosts: its commands are carried out, on three hosts.

Hosts are sets of namespaces, with folders of their own where the page installs to. Commands that need
systemd are done by stand-ins (tests/support/three_hosts) that start what the units in deploy/ say, with
their environment files, but as root and without hardening. Not carried out: making the Python environment,
and nginx.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import psycopg
import pytest

from tests.docs.markdown import DOCS, ROOT
from tests.support.hosts import Host, Hosts, why_not
from tests.support.lab_process import until
from tests.support.other_version import copy_as
from tests.support.postgres import find_binaries
from tests.support.spread import DatabaseOn

PAGE = DOCS / "three-hosts.md"
SHIMS = ROOT / "tests" / "support" / "three_hosts"
NEW = "9.9.1"
CELL = "labos: 1\nname: rpl\nmodules:\n  - {name: sealer, model: a4s_sealer}\n"
OWN = ("/opt/labos", "/etc/labos", "/var/lib/labos", "/etc/systemd/system", "/usr/lib/sysusers.d")

pytestmark = [pytest.mark.full, pytest.mark.timeout(400)]

LEFT_OUT = re.compile(r"python3 -m venv|/opt/labos/bin/pip install '|ln -s -t /usr/local/bin|.*nginx")


class Part(msgspec.Struct, frozen=True):
    """Commands of the page, and the hosts on which they are said."""

    heading: str
    hosts: tuple[str, ...]
    commands: str


def parts() -> list[Part]:
    found, hosts, heading = [], (), ""
    for line in re.split(r"(?m)(^```\n.*?^```$)", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE):
        if not line.startswith("```"):
            heading = (re.findall(r"^## (.*)$", line, re.MULTILINE) or [heading])[-1]
            if named := re.findall(r"[Oo]n [^`\n]*`(db|k1|k2)`:", line):
                hosts = (named[-1],)
            elif "On all three" in line:
                hosts = ("db", "k1", "k2")
            continue
        lines = [one for one in line.splitlines()[1:-1] if not LEFT_OUT.match(one)]
        if lines:
            found.append(Part(heading, hosts, "\n".join(lines)))
    return found


class Site:
    def __init__(self, hosts: Hosts) -> None:
        self.hosts = hosts
        self.database = DatabaseOn(hosts["db"], superuser="postgres")
        self.database.open()
        self.newer = copy_as(NEW, hosts.folder / "newer")
        for host in hosts:
            for place in OWN:
                host.mount(place)
            (host.folder / "units").mkdir()
            self._install_program(host)

    def _install_program(self, host: Host) -> None:
        """What pip makes: `labos`, and a `pip` that brings the newer version."""
        program = host.folder / "root" / "opt" / "labos" / "bin"
        program.mkdir(parents=True)
        version = program.parent / "version"
        version.write_text("")
        starts = f'#!/bin/sh\nPYTHONPATH=$(cat {version}) exec {sys.executable} -P -m labos "$@"\n'
        brings = f"#!/bin/sh\necho {self.newer} > {version}\n"
        for name, text in (("labos", starts), ("python", "#!/bin/sh\n"), ("pip", brings)):
            (program / name).write_text(text)
            (program / name).chmod(0o755)

    def take_workcell(self) -> None:
        """One with a single instrument, as the page sets up one node: `labos doctor` misses all others."""
        for host in self.hosts:
            folder = host.folder / "root" / "etc" / "labos"
            (folder / "rpl.yaml").write_text(CELL)
            settings = (folder / "labos.env").read_text()
            assert "LABOS_UP=rpl " in settings
            told = settings.replace("LABOS_UP=rpl ", "LABOS_UP=/etc/labos/rpl.yaml ")
            (folder / "labos.env").write_text(told)

    def say(self, part: Part) -> str:
        said = ""
        for name in part.hosts:
            host = self.hosts[name]
            bins = f"{SHIMS}:{host.folder}/root/opt/labos/bin:{self.database.binaries}"
            environment = {
                **{key: value for key, value in os.environ.items() if not key.startswith("LABOS_")},
                "PATH": f"{bins}:{os.environ['PATH']}",
                "UNIT_STATE": str(host.folder / "units"),
                "HOSTS": str(self.hosts.folder),
                "PGHOST": str(self.database.folder),
                "PGUSER": "postgres",
            }
            with (host.folder / "shell.log").open("a+") as out:  # not a pipe: what is started would hold it
                began = out.tell()
                done = host.run(
                    *("sh", "-euc", part.commands),
                    **{"check": False, "capture_output": False, "within": ROOT},
                    **{"stdout": out, "stderr": out, "env": environment},
                )
                out.seek(began)
                text = out.read()
            assert done.returncode == 0, (
                f"{part.heading}, on {name}: {part.commands}\n{text}\n{self.read_logs()}"
            )
            said += text
        if (restart := self.hosts["db"].folder / "units" / "postgresql").exists():
            restart.unlink()
            self.database.restart()
        return said

    def read_logs(self) -> str:
        logs = [log for host in self.hosts for log in (host.folder / "units").glob("*.log")]
        return "\n".join(f"--- {log}\n{log.read_text()[-1500:]}" for log in logs)

    def kernel(self) -> tuple[int, str]:
        """The epoch, and whose lease it is, by the database."""
        with psycopg.connect(f"postgresql://postgres@/labos?host={self.database.folder}") as connection:
            if connection.execute("SELECT to_regclass('head')").fetchone() == (None,):
                return 0, ""  # no kernel has made it yet
            row = connection.execute("SELECT epoch, lease_owner FROM head").fetchone()
            assert row is not None
            return int(row[0]), str(row[1])

    def has_standby(self) -> str:
        with psycopg.connect(f"postgresql://postgres@/labos?host={self.database.folder}") as connection:
            rows = connection.execute(
                "SELECT application_name FROM pg_stat_activity WHERE application_name LIKE 'labos standby %' "
                "AND state_change > clock_timestamp() - interval '2 s'"
            ).fetchall()
            return " ".join(row[0] for row in rows)


@pytest.fixture
def site() -> Iterator[Site]:
    if reason := why_not() or ("" if find_binaries() else "there is no PostgreSQL here"):
        pytest.skip(reason)
    with Hosts("db", "k1", "k2") as hosts:
        yield Site(hosts)


def test_the_page_installs_a_lab_and_upgrades_it(site: Site) -> None:
    last = ""
    for part in parts():
        if part.heading != last:
            _await_chapter(site, last)
            last = part.heading
        if part.heading.startswith("Upgrade") and part.hosts == ("k1",):
            until(lambda: f"{NEW} on k2" in site.has_standby(), "the newer version stands by on k2")
        if part.heading.startswith("Upgrade") and part.commands.count("\n") == 0:
            until(lambda: f"{NEW} on k1" in site.has_standby(), "the newer version stands by on k1")
        if part.heading == "The kernel" and "members.json" in part.commands:
            members = site.hosts["k1"].folder / "root/var/lib/labos/lab/pki/members.json"
            until(partial(_names_kernel, members), "the kernel has its certificate")
        said = site.say(part)
        if part.heading == "On all three":
            site.take_workcell()
        if "take-over" in part.commands:
            print(re.findall(r"The kernel .*", said))
    epoch, owner = site.kernel()
    assert (epoch, owner.rpartition(" ")[2]) == (3, "k1")
    until(lambda: f"{NEW} on k2" in site.has_standby(), "k2 stands by again")


def _names_kernel(members: Path) -> bool:
    return '"kernel"' in members.read_text()


def _await_chapter(site: Site, heading: str) -> None:
    """What the page says of a chapter is so before the next one begins."""
    served = site.hosts["db"].folder / "units" / "labos-api@web.log"
    look = Part("", ("k1",), "LABOS_HOME=/var/lib/labos/lab labos nodes")
    holds: dict[str, Callable[[], Any]] = {
        "The kernel": lambda: site.kernel()[1].endswith("on k1"),
        "The other kernel": lambda: "on k2" in site.has_standby(),
        "The HTTP interface": lambda: served.exists() and "serves the lab" in served.read_text(),
        "A node": lambda: re.search(r"rpl/sealer .*IDLE", site.say(look)),
    }
    try:
        until(holds.get(heading, lambda: True), f"what is done in {heading!r} has its effect")
    except AssertionError as error:
        seen = site.say(look) if heading == "A node" else ""
        raise AssertionError(f"{error}\n{seen}{site.read_logs()}") from None
