"""Many followers of the stream of events in one process: they read, count events and throw them away.

``python -m tests.benchmarks.follower_process URL COUNT AFTER``, where one event stands behind AFTER; says
``ready`` when all are served, and the number of events that each has got since (least, most) when its
standard input ends.
"""

from __future__ import annotations

import selectors
import socket
import sys
from urllib.parse import urlsplit

MARK = b"\ndata: "


def connect(url: str, after: int) -> socket.socket:
    parts = urlsplit(url)
    assert parts.hostname
    assert parts.port
    link = socket.create_connection((parts.hostname, parts.port), timeout=30)
    request = f"GET /api/v1/events/stream?after={after} HTTP/1.1\r\nhost: {parts.netloc}\r\n\r\n"
    link.sendall(request.encode())
    return link


def main(url: str, count: int, after: int) -> None:
    seen: dict[int, int] = {}
    tails: dict[int, bytes] = {}
    with selectors.DefaultSelector() as selector:
        links: list[socket.socket] = []
        for _ in range(count):
            link = connect(url, after)
            links.append(link)
            seen[link.fileno()], tails[link.fileno()] = 0, b""
            selector.register(link, selectors.EVENT_READ)
        for link in links:  # the first event is there already: all are served from here on
            head = b""
            while MARK not in head:
                head += link.recv(4096)
            seen[link.fileno()] += head.count(MARK) - 1
            tails[link.fileno()] = head[-len(MARK) + 1 :]
            link.setblocking(False)
        selector.register(sys.stdin, selectors.EVENT_READ)
        print("ready", flush=True)
        while True:
            for key, _ in selector.select():
                if key.fileobj is sys.stdin:
                    print(min(seen.values()), max(seen.values()), flush=True)
                    return
                assert isinstance(key.fileobj, socket.socket)
                data = key.fileobj.recv(262_144)
                if not data:
                    selector.unregister(key.fileobj)
                    continue
                seen[key.fd] += (tails[key.fd] + data).count(MARK)
                tails[key.fd] = data[-len(MARK) + 1 :]


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
