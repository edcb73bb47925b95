"""The credentials that a program sends to the lab, where they are stored, and which certificates are
trusted."""

from __future__ import annotations

import os
import ssl
import stat
from pathlib import Path

import msgspec

from labos.errors import BadInput
from labos.private import make_folder, replace_file
from labos.settings import CA, HOME_KEY, TOKEN, TOKEN_FILE, last_kernel


def tokens_file() -> Path:
    """The file in which `labos login` stores tokens: one for each lab."""
    folder = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(folder) / "labos" / "tokens.json"


def find_token(url: str, home: Path | None = None) -> str:
    """The token for the lab at an address: LABOS_TOKEN, else the content of the file that LABOS_TOKEN_FILE
    names, else the token that `labos login` has stored for it, else the key in the lab's folder. Empty if
    there is none. Raises BadInput for a file that others can read."""
    if token := os.environ.get(TOKEN, "").strip():
        return token
    if named := os.environ.get(TOKEN_FILE, ""):
        return _private_text(Path(named)).strip()
    kept = find_kept_token(place_of(url, home))
    if kept or home is None:
        return kept
    key = home / HOME_KEY
    return _private_text(key).strip() if key.is_file() else ""


def place_of(url: str, home: Path | None) -> str:
    """The name of a lab in the file of tokens: its folder, because such a lab may change its port, else its
    address."""
    return str(home) if home is not None else url


def find_kept_token(place: str) -> str:
    """The token that `labos login` has stored for a lab; empty if there is none."""
    return _read_kept().get(place, "")


def keep_token(place: str, token: str) -> None:
    """Store a token for a lab; an empty one deletes the stored token."""
    kept = {**_read_kept(), place: token}
    if not token:
        kept.pop(place, None)
    file = tokens_file()
    make_folder(file.parent)
    replace_file(file, msgspec.json.format(msgspec.json.encode(kept)) + b"\n")


def _read_kept() -> dict[str, str]:
    file = tokens_file()
    if not file.is_file():
        return {}
    try:
        return msgspec.json.decode(_private_text(file), type=dict[str, str])
    except msgspec.MsgspecError:
        raise BadInput(
            f"The file {file} does not hold tokens.",
            remedy="Remove it, and sign in again with `labos login`.",
        ) from None


def _private_text(file: Path) -> str:
    """The text of a file that only its owner can read. Raises BadInput."""
    try:
        with file.open(encoding="utf-8") as opened:
            mode = os.fstat(opened.fileno()).st_mode
            if os.name != "nt" and stat.S_IMODE(mode) & 0o077:
                raise BadInput(
                    f"Other users can read the file {file}, which contains a token.",
                    remedy=f"Run: chmod 600 {file}. If others use this computer, revoke the token too.",
                )
            return opened.read(100_000)
    except FileNotFoundError:
        raise BadInput(f"There is no file {file}.", remedy=f"Correct {TOKEN_FILE}.") from None


def find_trusted(home: Path | None) -> ssl.SSLContext | None:
    """The trusted certificates: those of the authority whose file LABOS_CA names; for a lab in a folder of
    this computer, the certificate that its own note names. None for the default authorities of the system."""
    if named := os.environ.get(CA, ""):
        try:
            return ssl.create_default_context(cafile=named)
        except (OSError, ssl.SSLError) as error:
            raise BadInput(
                f"The file {named} holds no certificate ({error}).", remedy=f"Correct {CA}: a PEM file."
            ) from None
    known = last_kernel(home) if home is not None else None
    if known is None or not known.certificate:
        return None
    context = ssl.create_default_context(cafile=known.certificate)
    # Exactly this certificate, whatever the lab's host name in the address: it comes from the lab's own
    # folder.
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.check_hostname = False
    return context
