"""Odd requests without an end, and questions: ``python -m tests.benchmarks.fuzzer_process URL…``.

Says how many were answered, by their status, when its standard input ends.
"""

from __future__ import annotations

import json
import random
import sys
import threading
from collections import Counter

import httpx

FLOW = "labos: 1\nname: f\nsteps:\n  - {name: x, module: %s, action: act}\n"
WORDS = ("R1", "idle/m0", "nobody", "\u0000", "x" * 300, "../..", "1e999", "P1", "[]", "{")
LOOKS = ("/state?waits=false", "/runs", "/events?last=100", "/health", "/users", "/shares", "/inventory")
POSTS = (
    "/runs",
    "/runs/{}/cancel",
    "/runs/{}/pause",
    "/experiments/{}/end",
    "/interventions/{}/resolve",
    "/control/pause",
    "/stations/load",
    "/modules/{}/put-back",
    "/campaigns",
    "/groups",
)


def body(odd: random.Random) -> bytes:
    """Anything but what would be carried out."""
    match odd.randrange(4):
        case 0:
            return odd.randbytes(odd.randrange(200))
        case 1:
            return b"[" * odd.randrange(2000)
        case 2:
            return json.dumps({"workflow": {"text": FLOW % odd.choice(WORDS)}, "payload": {}}).encode()
        case _:
            return json.dumps({odd.choice(WORDS): odd.choice(WORDS) for _ in range(3)}).encode()


def main(urls: list[str]) -> None:
    odd, seen = random.Random(1), Counter[int]()
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    with httpx.Client(timeout=60) as client:
        print("ready", flush=True)
        while not over.is_set():
            url = f"{odd.choice(urls)}/api/v1"
            if odd.random() < 0.3:
                answer = client.get(url + odd.choice(LOOKS))
            else:
                path = odd.choice(POSTS).format(odd.choice(("R1", "nobody", "x")))
                headers = {"content-type": odd.choice(("application/json", "text/plain"))}
                if odd.random() < 0.3:
                    headers["idempotency-key"] = str(odd.randrange(1000))
                answer = client.post(url + path, content=body(odd), headers=headers)
            seen[answer.status_code] += 1
    print(", ".join(f"{count} × {status}" for status, count in sorted(seen.items())), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
