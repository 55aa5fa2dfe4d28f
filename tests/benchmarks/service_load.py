"""Whether the web server slows a scan down, and whether it answers in time, under more listeners than there will be.

A campaign runs on the simulated bench, as fast as the computer can, while nobody listens, while 50 streams of events
and 200 requests a second come from a process of their own, and while a process that has nothing to do with it computes
for as long as server and clients did; by turns, so that whatever else the computer does meets them alike. The last says
what any program costs a scan that takes all that two cores give; a real bench waits for its stages. What a point costs
the process that drives the bench is told in CPU time as well, and so is what the server needs for each request and for
the streams.

    python -m tests.benchmarks.service_load
"""

import asyncio
import contextlib
import json
import multiprocessing
import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from multiprocessing.connection import Connection
from pathlib import Path

import httpx
import numpy as np

from tests.benchmarks.figures import tell
from tests.served import LONG

STREAMS = 50
REQUESTS = 200
"""A second."""
CONNECTIONS = 20
TURN = 5.0
"""Seconds of each turn."""
TURNS = 4
"""Of each kind."""
KINDS = ("nobody listens", f"{STREAMS} streams, {REQUESTS} requests/s", "another program instead")
PATHS = ("/api/instrument", "/api/instrument", "/api/queue", "/api/scans", "/api/scans/1/points?limit=50")
SINGLY = 400
"""Requests of each path from which its cost is known."""
CAMPAIGN = LONG | {"samples": [{"name": "Sample 1", "material": "sample-1", "repeats": 20}]}


async def answer(reader: asyncio.StreamReader) -> int:
    """Read one answer with a known length; returns its status."""
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    length = next(int(line.split(":")[1]) for line in head.lower().splitlines() if line.startswith("content-length"))
    await reader.readexactly(length)
    return int(head.split()[1])


def request(port: int, token: str, path: str) -> bytes:
    """What asks for a path."""
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\n\r\n".encode()


@contextlib.asynccontextmanager
async def listening(port: int, token: str) -> AsyncIterator[list[int]]:
    """Follow the streams of events in the background; each event that one of them tells counts in the list."""
    seen = [0]

    async def listen() -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(request(port, token, "/api/events"))
        try:
            while chunk := await reader.read(1 << 16):
                seen[0] += chunk.count(b"\nevent: ")
        finally:
            writer.close()

    streams = [asyncio.ensure_future(listen()) for _ in range(STREAMS)]
    try:
        yield seen
    finally:
        for stream in streams:
            stream.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*streams)


async def listen_only(port: int, token: str, seconds: float) -> int:
    """Events that all streams together see in this time."""
    async with listening(port, token) as seen:
        await asyncio.sleep(seconds)
        return seen[0]


async def one_by_one(port: int, token: str, path: str) -> None:
    """Ask for a path, again and again."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for _ in range(SINGLY):
        writer.write(request(port, token, path))
        assert await answer(reader) == 200, path
    writer.close()


async def load(port: int, token: str, seconds: float) -> tuple[dict[str, list[float]], int]:
    """Latencies of each path, seconds, and the number of events that all streams together have seen."""
    latencies: dict[str, list[float]] = {path: [] for path in PATHS}
    begin = time.perf_counter() + 1  # the streams are open by then

    async def ask(number: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        turn = number
        while (moment := begin + turn / REQUESTS) < begin + seconds:
            await asyncio.sleep(max(0.0, moment - time.perf_counter()))
            path = PATHS[turn // CONNECTIONS % len(PATHS)]
            writer.write(request(port, token, path))
            status = await answer(reader)
            assert status == 200, (path, status)
            latencies[path].append(time.perf_counter() - moment)  # from when it was due: waiting for its turn counts
            turn += CONNECTIONS
        writer.close()

    async with listening(port, token) as seen:
        await asyncio.gather(*map(ask, range(CONNECTIONS)))
        return latencies, seen[0]


def loading(connection: Connection, port: int, token: str) -> None:
    """Be the clients whenever a number of seconds comes."""
    while (seconds := connection.recv()) is not None:
        began = os.times()
        found = asyncio.run(load(port, token, seconds))
        ended = os.times()
        connection.send((*found, ended.user + ended.system - began.user - began.system))


def compute(share: float) -> None:
    """Take this share of a processor for ever, as a program does that has nothing to do with the service."""
    text = [{str(number): [float(number)] * 50} for number in range(400)]
    while True:
        began = time.perf_counter()
        json.loads(json.dumps(text))
        time.sleep((time.perf_counter() - began) * (1 - share) / share)


def cpu(process: int) -> float:
    """Seconds that a process has computed for."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def spent(process: int, seconds: float) -> float:
    """Seconds that a process computes for in so many seconds from now on."""
    before = cpu(process)
    time.sleep(seconds)
    return cpu(process) - before


def points(database: Path) -> int:
    """Points that are measured."""
    with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
        return int(connection.execute("SELECT count(*) FROM points WHERE status = 'done'").fetchone()[0])


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = [sys.executable, "-c", "from api.commands.main import main; main()", "serve", "--port", "0"]
        command += ["--mount-by-itself", "-d", str(folder / "bench.db"), "-o", str(folder / "results")]
        with (folder / "log").open("w") as log:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            assert process.stdout is not None
            url, _, token = process.stdout.readline().split()[1].partition("/#token=")
            measure(folder / "bench.db", url, token, process.pid)
        finally:
            process.terminate()
            process.wait()


def measure(database: Path, url: str, token: str, server: int) -> None:
    """Run the campaign, and the turns with and without load."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    clients = context.Process(target=loading, args=(there, int(url.rpartition(":")[2]), token), daemon=True)
    clients.start()
    with httpx.Client(
        base_url=url, headers={"Authorization": f"Bearer {token}"}, trust_env=False, timeout=60
    ) as client:
        while True:
            with contextlib.suppress(httpx.ConnectError):
                if client.get("/api/instrument").json()["driver"]:
                    break
            time.sleep(0.2)
        number = client.post("/api/queue", json={"campaign": CAMPAIGN}).raise_for_status().json()["id"]
        client.post(f"/api/queue/{number}/start").raise_for_status()
        while points(database) < 200:  # the bench is open, and the pace is even
            time.sleep(0.5)
        while spent(server, 1.0) > 0.1:  # it loads what views of datasets need
            pass
        bench = client.get("/api/instrument").json()["driver"]["process"]
    rows: dict[str, list[tuple[int, float, float, float]]] = {kind: [] for kind in KINDS}
    latencies: dict[str, list[float]] = {path: [] for path in PATHS}
    events, client_cpu, needed, other = 0, 0.0, 0.0, None
    for turn in range(len(KINDS) * TURNS):
        kind = KINDS[turn % len(KINDS)]
        before = cpu(server)
        if kind == KINDS[1]:
            here.send(TURN + 1)
        elif kind == KINDS[2]:
            other = context.Process(target=compute, args=((needed + client_cpu) / asked(latencies),), daemon=True)
            other.start()
        time.sleep(1)
        began = time.monotonic(), points(database), cpu(bench), cpu(server)
        time.sleep(TURN)
        ended = time.monotonic(), points(database), cpu(bench), cpu(server)
        rows[kind].append((ended[1] - began[1], ended[0] - began[0], ended[2] - began[2], ended[3] - began[3]))
        if kind == KINDS[1]:
            told, seen, computed = here.recv()
            events, client_cpu, needed = events + seen, client_cpu + computed, needed + cpu(server) - before
            for path, values in told.items():
                latencies[path] += values
        elif other is not None:
            other.kill()
            other.join()
            other = None
    here.send(None)
    clients.join()
    show(rows, latencies, events)
    loaded = asked(latencies)
    print(f"\nCPU time of {loaded:.0f} s of load: server {needed:.1f} s, clients {client_cpu:.1f} s", end="")
    print(f" ({100 * needed / loaded:.0f} % and {100 * client_cpu / loaded:.0f} % of a core)\n")
    show_costs(server, int(url.rpartition(":")[2]), token)


def asked(latencies: dict[str, list[float]]) -> float:
    """Seconds for which there was load."""
    return sum(map(len, latencies.values())) / REQUESTS


def show_costs(server: int, port: int, token: str) -> None:
    """Print what the server computes for a request and for the streams, while the campaign goes on."""
    idle = spent(server, TURN) / TURN
    for path in dict.fromkeys(PATHS):
        began = time.monotonic(), cpu(server)
        asyncio.run(one_by_one(port, token, path))
        needed = cpu(server) - began[1] - idle * (time.monotonic() - began[0])
        print(f"{path:34} {1000 * needed / SINGLY:6.2f} ms CPU a request")
    began = time.monotonic(), cpu(server)
    seen = asyncio.run(listen_only(port, token, 2 * TURN))
    needed = cpu(server) - began[1] - idle * (time.monotonic() - began[0])
    print(f"{'event of a stream':34} {1000 * needed / seen:6.3f} ms CPU, with {STREAMS} that hear it")


def show(
    rows: dict[str, list[tuple[int, float, float, float]]],
    latencies: dict[str, list[float]],
    events: int,
) -> None:
    """Print what was measured."""
    print(
        f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {TURNS} turns of {TURN:g} s of each kind\n"
    )
    print(f"{'':28} {'points/s':>9} {'falls by':>9} {'bench CPU ms/point':>19} {'bench CPU':>10} {'server CPU':>11}")
    alone = None
    for kind in KINDS:
        done, seconds, bench, server = np.array(rows[kind]).sum(axis=0)
        alone = alone or done / seconds
        print(
            f"{kind:28} {done / seconds:9.1f} {100 * (1 - done / seconds / alone):7.1f} % {1000 * bench / done:19.2f} "
            f"{100 * bench / seconds:8.0f} % {100 * server / seconds:9.0f} %"
        )
        if kind == KINDS[0]:
            tell("points a second while nobody listens", alone)
        else:
            aim, because = ("< 5", "the simulated bench takes all of a core") if kind == KINDS[1] else ("", "")
            tell(f"{kind}: points a second fall by", 100 * (1 - done / seconds / alone), "%", aim, because)
    print(f"a stream saw {events / TURNS / STREAMS:.0f} events a turn\n")
    print(f"{'latency, ms':34} {'requests':>9} {'median':>8} {'99 %':>8} {'worst':>8}")
    for path, values in latencies.items():
        median, high, worst = 1000 * np.percentile(values, [50, 99, 100])
        print(f"{path:34} {len(values):9} {median:8.1f} {high:8.1f} {worst:8.1f}")
        tell(f"`{path}`, 99 %", high, f"ms (worst {worst:.0f})", "< 50")


if __name__ == "__main__":
    main()
