"""Somebody on the bus who says what a test wants, in a process of his own: what is local to a session is
never refused. He uses Zenoh as it is. A line of JSON in, a line of JSON out."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

ANSWER = b"forged"


class Stranger:
    """The test's end of it."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.stranger"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )

    def __call__(self, do: str, who: str, *args: Any) -> Any:
        """Let ``who`` do something; returns what comes of it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([do, who, *args]) + "\n")
        self._process.stdin.flush()
        said = json.loads(self._process.stdout.readline())
        assert "fault" not in said, said["fault"]
        return said["is"]

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(10)
        finally:
            self._process.kill()
            self._process.stdout.close()


class _Session:
    """One session of his, with the certificate in a folder, or with none."""

    def __init__(
        self, endpoint: str, folder: str, mode: Literal["client", "peer", "router"] = "client"
    ) -> None:
        import zenoh

        from labos.bus import Security
        from labos.bus._opening import config_of
        from labos.pki import Credentials

        security = Security(Credentials(Path(folder))) if folder else None
        config = config_of(mode, (), (endpoint,), None)
        for key, value in security.make_settings("client").items() if security is not None else ():
            config.insert_json5(key, json.dumps(value))
        self._session: Any = zenoh.open(config)
        self._declared: list[Any] = []
        self._received: list[str] = []

    def answer(self, key: str) -> None:
        """Serve a key."""
        from zenoh.handlers import Callback

        def reply(query: Any) -> None:
            with query:
                self._received.append(str(query.key_expr))
                query.reply(query.key_expr, ANSWER)

        self._declared.append(
            self._session.declare_queryable(key, Callback(reply, indirect=False), complete=True)
        )
        self._settle()

    def put(self, key: str, payload: str) -> None:
        self._session.put(key, payload.encode())
        self._settle()

    def token(self, key: str) -> None:
        self._declared.append(self._session.liveliness().declare_token(key))
        self._settle()

    def listen(self, keys: str) -> None:
        from zenoh.handlers import Callback

        def note(sample: Any) -> None:
            self._received.append(str(sample.key_expr))

        receive: Any = Callback(note, indirect=False)
        self._declared.append(self._session.declare_subscriber(keys, receive))
        self._declared.append(self._session.liveliness().declare_subscriber(keys, receive, history=True))
        self._settle()

    def get(self, key: str, payload: str) -> list[str]:
        replies = self._session.get(key, payload=payload.encode(), timeout=2.0)
        return [reply.ok.payload.to_string() if reply.ok else "error" for reply in replies]

    def sees(self, key: str) -> bool:
        """Whether somebody shows a living key."""
        return any(reply.ok for reply in self._session.liveliness().get(key, timeout=2.0))

    def list_heard(self) -> list[str]:
        self._settle()
        return self._received

    def rest(self) -> None:
        """Take everything back."""
        for declared in self._declared:
            declared.undeclare()
        self._declared.clear()
        self._received.clear()
        self._settle()

    def close(self) -> None:
        self._session.close()

    def _settle(self) -> None:
        """Until the bus has seen what was declared and what was said before. Zenoh sends declarations before
        messages, so a round trip of one kind proves nothing of the other."""
        list(self._session.liveliness().get("labos/@round-trip", timeout=1.0))
        list(self._session.get("labos/@round-trip", timeout=1.0))


def _main() -> None:
    sessions: dict[str, _Session] = {}
    for line in sys.stdin:
        do, who, *args = json.loads(line)
        try:
            if do == "open":
                sessions[who] = _Session(*args)
                done: Any = None
            else:
                done = getattr(sessions[who], do)(*args)
            said = {"is": done}
        except Exception as error:
            said = {"fault": f"{type(error).__name__}: {error}"}
        print(json.dumps(said), flush=True)
    for session in sessions.values():
        session.close()


if __name__ == "__main__":
    _main()
