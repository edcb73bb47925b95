"""Nodes run on the PCs of instruments: nothing that Windows lacks may be needed."""

from __future__ import annotations

import subprocess
import sys

IMPORT_ALL = """
import importlib, importlib.abc, pkgutil, sys, types
import asyncio, multiprocessing, sqlite3, structlog, subprocess  # their Windows halves cannot be loaded here

BANNED = {"fcntl", "grp", "pwd", "pty", "resource", "syslog", "termios", "tty", "posix_ipc", "uvloop"}
HEAVY = {"serial", "pymodbus", "can", "canopen", "httpx"}

class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BANNED:
            raise ImportError(f"Windows has no {name}")

for name in BANNED:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Refuse())
sys.modules["msvcrt"] = types.ModuleType("msvcrt")
sys.platform = "win32"
for top in ("labos.node", "labos.link"):
    package = importlib.import_module(top)
    for module in pkgutil.walk_packages(package.__path__, top + "."):
        if module.name != "labos.link.http":
            importlib.import_module(module.name)
sys.platform = "linux"
print(sorted(HEAVY & set(sys.modules)))
importlib.import_module("labos.link.http")
"""


def test_nodes_and_links_import_nothing_that_windows_lacks() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
