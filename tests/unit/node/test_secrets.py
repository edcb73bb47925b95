"""Secrets stand in files or in the environment, never in the workcell file."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.adapter._http import read_authorization
from labos.adapter._opcua_security import access_of
from labos.errors import DeviceError
from labos.node.secrets import read_secret


def test_by_a_variable_or_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "secret"
    file.write_text("from a file\n")
    monkeypatch.setenv("A_SECRET", "from a variable")
    assert read_secret({"password_env": "A_SECRET"}, "password") == "from a variable"
    assert read_secret({"password_file": str(file)}, "password") == "from a file"
    assert read_secret({"user": "x"}, "password") == ""
    assert read_authorization({"rest_node_auth": str(file)}, "rest_node_auth") == "from a file"
    assert read_authorization({"rest_node_auth_env": "A_SECRET"}, "rest_node_auth") == "from a variable"
    opcua = {"opcua_url": "opc.tcp://x", "opcua_user": "a", "opcua_insecure": True}
    assert access_of({**opcua, "opcua_password": str(file)}).password == "from a file"
    assert access_of({**opcua, "opcua_password_env": "A_SECRET"}).password == "from a variable"


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (
            {"password_env": "NO_SUCH_SECRET"},
            "names the variable 'NO_SUCH_SECRET', which is not set",
        ),
        (
            {"password_file": "no/such/file"},
            "names the file 'no/such/file', which cannot be read",
        ),
        ({"password_env": "A", "password_file": "b"}, "has both `password_env` and `password_file`"),
    ],
)
def test_what_cannot_be_had_is_said(config: dict[str, str], why: str) -> None:
    with pytest.raises(DeviceError, match=why) as told:
        read_secret(config, "password")
    assert told.value.effects == "none"
    assert told.value.remedy


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DeviceError, match="it is not a text"):
        read_secret({"password_file": str(tmp_path / "key")}, "password")
