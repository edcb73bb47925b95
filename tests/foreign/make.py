"""Makes the environments of the foreign nodes and tools: ``python tests/foreign/make.py [KIND …]``.

They are put below the folder that LABOS_FOREIGN names, ``.foreign`` in the checkout if it names none. It
needs nothing but ``uv`` in the Python that runs it; for packages of npm, ``npm`` and ``node``; for those of
Maven, ``mvn`` and Java.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = Path(os.environ.get("LABOS_FOREIGN") or ROOT / ".foreign")

PACKAGES = {
    "wei": ["ad_sdl.wei==0.7.4"],
    "zmq": ["ad_sdl.wei==0.7.4", "pyzmq==27.3.0"],
    "madsci": [
        "madsci-node-module==0.8.1",
        "madsci-client==0.8.1",
        "pydantic==2.12.5",
        "pydantic-settings==2.13.1",
        "fastapi==0.135.1",
        "starlette==0.52.1",
        "uvicorn==0.41.0",
        "sqlalchemy<2.1",
    ],
    "epics": ["softioc==4.6.1"],
    "protobuf": ["grpcio-tools==1.85.1"],
    "s3": ["moto[server]==5.2.5"],
    "opcua": ["asyncua==2.1.0"],
    "unitelabs": ["unitelabs-sila==0.13.0"],
    "sila": ["sila2[cryptography]==0.14.0"],
    "schemathesis": ["schemathesis==4.32.5", "openapi-python-client==0.29.1"],
    # The package of rocrate 0.13 is the newest that ships the context of RO-Crate 1.1.
    "exports": ["roc-validator==0.13.0", "rocrate==0.13.0", "cloudevents==2.2.0"],
    # A receiver of OpenTelemetry, a program in Rust.
    "otlp": ["rotel==0.0.1a15"],
    "opentrons": ["opentrons==8.8.2", "numpy<2"],
    "ros": [
        "ros-kilted-rclpy==9.1.2",
        "ros-kilted-rmw-fastrtps-cpp==9.3.3",
        "ros-kilted-std-msgs==5.5.1",
        "ros-kilted-std-srvs==5.5.1",
        "ros-kilted-sensor-msgs==5.5.1",
        "ros-kilted-test-msgs==2.3.0",
    ],
}

NODE_PACKAGES = {
    "oidc": ["oidc-provider@9.13.3"],
}
"""Of npm: a folder with `node_modules` for each."""


MAVEN_PACKAGES = {
    "kafka": ["org.apache.kafka:kafka_2.13:4.1.0"],
}
"""Of Maven: a folder with `libs` for each, with all that they need."""

_POM = """<project xmlns="http://maven.apache.org/POM/4.0.0">
  <modelVersion>4.0.0</modelVersion>
  <groupId>labos</groupId>
  <artifactId>foreign</artifactId>
  <version>1</version>
  <packaging>pom</packaging>
  <dependencies>
{}
  </dependencies>
</project>
"""


def make_java(kind: str) -> None:
    """A folder with a foreign kind of packages of Maven, unless there is one."""
    folder = FOLDER / kind
    mark = folder / "complete"
    wanted = "\n".join(MAVEN_PACKAGES[kind])
    if mark.exists() and mark.read_text() == wanted:
        return
    folder.mkdir(parents=True, exist_ok=True)
    parts = ("groupId", "artifactId", "version")
    needed = []
    for package in MAVEN_PACKAGES[kind]:
        told = zip(parts, package.split(":"), strict=True)
        needed.append(f"    <dependency>{''.join(f'<{n}>{value}</{n}>' for n, value in told)}</dependency>")
    (folder / "pom.xml").write_text(_POM.format("\n".join(needed)))
    command = ["mvn", "-q", "-B", "-f", folder / "pom.xml", "dependency:copy-dependencies"]
    subprocess.run([*command, f"-DoutputDirectory={folder / 'libs'}"], check=True)
    mark.write_text(wanted)


def make_node(kind: str) -> None:
    """A folder with a foreign kind of packages of npm, unless there is one."""
    folder = FOLDER / kind
    mark = folder / "complete"
    wanted = "\n".join(NODE_PACKAGES[kind])
    if mark.exists() and mark.read_text() == wanted:
        return
    folder.mkdir(parents=True, exist_ok=True)
    command = ["npm", "install", "--prefix", folder, "--no-fund", "--no-audit", "--ignore-scripts"]
    subprocess.run([*command, "--loglevel=error", *NODE_PACKAGES[kind]], check=True)
    mark.write_text(wanted)


def make(kind: str) -> None:
    """An environment with a foreign kind of nodes, unless there is one."""
    folder = FOLDER / kind
    mark = folder / "complete"
    wanted = "\n".join(PACKAGES[kind])
    if mark.exists() and mark.read_text() == wanted:
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [sys.executable, "-m", "uv", "venv", "-q", "--clear", "-p", sys.executable, folder], check=True
    )
    python = folder / "bin" / "python"
    subprocess.run(
        [sys.executable, "-m", "uv", "pip", "install", "-q", "-p", python, *PACKAGES[kind]], check=True
    )
    mark.write_text(wanted)


if __name__ == "__main__":
    for wanted_kind in sys.argv[1:] or PACKAGES:
        if wanted_kind in NODE_PACKAGES:
            make_node(wanted_kind)
        elif wanted_kind in MAVEN_PACKAGES:
            make_java(wanted_kind)
        else:
            make(wanted_kind)
