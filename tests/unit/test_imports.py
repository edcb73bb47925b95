"""What a library loads only because it is installed stays out of the lab's processes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from labos.imports import import_without


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_migration_does_not_load_what_only_colours_errors(tmp_path):
    code = (
        "import sys; from labos.imports import import_without; import_without('structlog', 'rich'); "
        "from labos.store import migrate; "
        f"migrate('sqlite:///{tmp_path}/lab.db'); "
        "print('alembic' in sys.modules, 'pygments' in sys.modules); import pygments.lexers; print('found')"
    )
    assert run_python(code).splitlines() == ["True False", "found"]


def test_a_package_that_is_left_out_can_be_imported_afterwards():
    code = (
        "import sys; from labos.imports import import_without; "
        "import_without('alembic.config', 'pygments'); "
        "print(sorted({'alembic', 'pygments'} & set(sys.modules))); import pygments.lexers"
    )
    assert run_python(code) == "['alembic']"


def test_what_is_loaded_already_stays():
    import json

    assert import_without("csv", "json").__name__ == "csv"
    assert sys.modules["json"] is json


def test_a_module_that_is_missing_leaves_nothing_hidden():
    with pytest.raises(ModuleNotFoundError):
        import_without("labos_without_this", "labos_not_installed")
    assert "labos_not_installed" not in sys.modules
