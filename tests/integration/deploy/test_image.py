"""The container image: built by podman from the Containerfile, and a lab that runs in it.

Where no registry is reached its base is made of Debian packages by mmdebstrap. `podman run` needs cgroups
that not every machine lets a test have: the lab runs by `buildah run` with the isolation of a chroot, which
is the image and its user, without limits or a network of its own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.markdown import ROOT

TOOLS = ("podman", "buildah", "mmdebstrap")
PACKAGES = "python3,python3-venv,ca-certificates"

pytestmark = [
    pytest.mark.full,
    pytest.mark.timeout(2400),
    pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="images are built by root here"),
    pytest.mark.skipif(any(not shutil.which(tool) for tool in TOOLS), reason=f"needs {', '.join(TOOLS)}"),
]

LAB = """
labos up rpl --simulate --speed 100 --quiet & lab=$!
for _ in $(seq 120); do labos nodes 2>/dev/null | grep -q 'sealer .*IDLE' && break; sleep 0.5; done
labos do rpl/pf400 explore_workcell && labos log | grep -c action.succeeded
kill -TERM $lab; wait $lab; echo "ended with $?"
"""


class Store:
    """A store of images of its own, below a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, tool: str, *words: str | Path, timeout_s: float = 1800.0) -> str:
        where = [
            "--root",
            f"{self.folder}/root",
            "--runroot",
            f"{self.folder}/run",
            "--storage-driver",
            "vfs",
        ]
        more = ["--cgroup-manager", "cgroupfs", "--events-backend", "file"] if tool == "podman" else []
        done = subprocess.run(
            [tool, *where, *more, *map(str, words)],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout.strip()


@pytest.fixture
def store() -> Iterator[Store]:
    with tempfile.TemporaryDirectory(prefix="image-", dir="/tmp") as folder:  # podman wants a short path
        made = Store(Path(folder))
        yield made
        made("podman", "rmi", "--all", "--force")


def test_the_image_is_built_and_a_lab_runs_in_it(store: Store, tmp_path: Path) -> None:
    base = tmp_path / "base.tar"
    make = ["mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(base)]
    subprocess.run(make, check=True)
    store("podman", "import", "-q", base, "localhost/base")
    # The package index is reached as it is outside: with the certificates of this machine.
    told = tmp_path / "pip.conf"
    told.write_text("[global]\ncert = /etc/ssl/machine.pem\n")
    store(
        # Not a layer for each step: this store copies all files for each.
        *("podman", "build", "--layers=false", "--isolation", "chroot", "--network", "host"),
        *(
            "-v",
            "/etc/ssl/certs/ca-certificates.crt:/etc/ssl/machine.pem:ro",
            "-v",
            f"{told}:/etc/pip.conf:ro",
        ),
        *(
            "--build-arg",
            "BASE=localhost/base",
            "-f",
            ROOT / "deploy/compose/Containerfile",
            "-t",
            "labos",
            ROOT,
        ),
    )
    container = store("buildah", "from", "localhost/labos")
    try:
        run = ("buildah", "run", "--isolation", "chroot", container, "--")
        assert store(*run, "labos", "--version").startswith("labos, version ")
        assert store(*run, "id", "-u") == "10001"
        said = store(*run, "sh", "-c", LAB, timeout_s=180.0)
        assert said.endswith("ended with 0"), said
        assert "\n1\n" in said, said
    finally:
        store("buildah", "rm", container)
