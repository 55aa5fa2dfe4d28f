"""Whether the web server slows a scan down, and whether it answers in time, under more listeners than there will be.

A campaign runs on the simulated bench while nobody listens, while 50 streams of events and 200 requests a second come
from a process of their own, and while that load comes and a dataset as well, in which the service fills what lacks; by
turns, so that whatever else the computer does meets them alike.

First the bench takes all that the computer gives, so anything costs it something: there is a turn with a process that
has nothing to do with the service and computes for as long as server and clients did. Then it takes its time as a real
one does, which waits for its stages and exposures; what it falls behind is told by the seconds that pass on the bench,
for one direction is farther away than another. What a point costs the process that drives the bench is told in CPU time
as well, and so is what the server needs for each request and for the streams.

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
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import httpx
import numpy as np

from drivers.arrays import FloatArray
from goniometer.storage.store import Store
from tests.benchmarks.figures import tell
from tests.drawn_dataset import drawn_dataset
from tests.served import LONG

STREAMS = 50
REQUESTS = 200
"""A second."""
CONNECTIONS = 20
ALONE, LOADED = "nobody listens", f"{STREAMS} streams, {REQUESTS} requests/s"
COMES, OTHER = f"{LOADED}, a dataset comes", "another program instead"
PATHS = ("/api/instrument", "/api/instrument", "/api/queue", "/api/scans", "/api/scans/1/points?limit=50")
SINGLY = 400
"""Requests of each path from which its cost is known."""
CAMPAIGN = LONG | {
    "samples": [{"name": "Sample 1", "material": "sample-1"}],
    "incident": {"start": 10, "stop": 80, "step": 1},
}
"""One scan that outlasts all turns: the fits of one that ends would slow some turns and not others."""


@dataclass(frozen=True)
class Pace:
    """How fast the bench is, and what happens by turns."""

    name: str
    command: tuple[str, str]
    """What makes Python the command line."""
    kinds: tuple[str, ...]
    seconds: float
    """Of each turn."""
    turns: int
    """Of each kind."""
    begun: int
    """Points after which it begins."""
    by_time: bool
    """Whether the time that passes on the bench says how fast it is, and not the number of points."""


_PLAIN = "-c", "from api.commands.main import main; main()"
_PACED = "-m", "tests.benchmarks.paced_bench"
PACES = (
    Pace("a bench that waits for nothing", _PLAIN, (ALONE, LOADED, COMES, OTHER), 7.0, 3, 200, False),
    Pace("a bench that waits for its stages and exposures", _PACED, (ALONE, LOADED), 20.0, 2, 5, True),
)


@dataclass
class Seen:
    """What all turns of a kind have seen together."""

    seconds: float = 0.0
    points: int = 0
    bench_seconds: float = 0.0
    """That passed on the bench."""
    bench: float = 0.0
    """Seconds that the process computed which drives it."""
    server: float = 0.0
    """Seconds that the server computed."""
    needed: float = 0.0
    """The same, from before the clients came until they had gone."""
    clients: float = 0.0
    """Seconds that the clients computed."""
    events: int = 0
    """That all streams saw."""
    latencies: dict[str, list[float]] = field(default_factory=lambda: {path: [] for path in PATHS})
    """Seconds."""

    @property
    def asked(self) -> float:
        """Seconds for which there was load."""
        return sum(map(len, self.latencies.values())) / REQUESTS


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


def done(database: Path) -> tuple[int, float]:
    """Points that are measured, and seconds that they took on the bench."""
    with contextlib.closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        count, seconds = connection.execute(
            "SELECT count(*), total(seconds) FROM points WHERE status = 'done'"
        ).fetchone()
    return int(count), float(seconds)


def at_a_point(database: Path, processes: tuple[int, int]) -> FloatArray:
    """When the next point is done: seconds, points, seconds on the bench, and those that two processes computed."""
    before = done(database)
    while (now := done(database)) == before:
        time.sleep(0.01)
    return np.array([time.monotonic(), *now, *map(cpu, processes)])


def main() -> None:
    """Print the tables."""
    for pace in PACES:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            command = [sys.executable, *pace.command, "serve", "--port", "0", "--mount-by-itself"]
            command += ["-d", str(folder / "bench.db"), "-o", str(folder / "results")]
            with (folder / "log").open("w") as log:
                process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
            try:
                assert process.stdout is not None
                url, _, token = process.stdout.readline().split()[1].partition("/#token=")
                measure(pace, folder / "bench.db", url, token, process.pid)
            finally:
                process.terminate()
                process.wait()


def begin(pace: Pace, database: Path, url: str, token: str, server: int) -> int:
    """Begin the campaign; returns the process that drives the bench."""
    headers = {"Authorization": f"Bearer {token}"}
    with httpx.Client(base_url=url, headers=headers, trust_env=False, timeout=60) as client:
        while True:
            with contextlib.suppress(httpx.TransportError):
                if client.get("/api/instrument").json()["driver"]:
                    break
            time.sleep(0.2)
        number = client.post("/api/queue", json={"campaign": CAMPAIGN}).raise_for_status().json()["id"]
        client.post(f"/api/queue/{number}/start").raise_for_status()
        while done(database)[0] < pace.begun:  # the bench is open, and the pace is even
            time.sleep(0.5)
        while spent(server, 1.0) > 0.1:  # it loads what views of datasets need
            pass
        return int(client.get("/api/instrument").json()["driver"]["process"])


def measure(pace: Pace, database: Path, url: str, token: str, server: int) -> None:
    """Run the campaign, and the turns with and without load."""
    port = int(url.rpartition(":")[2])
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    clients = context.Process(target=loading, args=(there, port, token), daemon=True)
    clients.start()
    processes = begin(pace, database, url, token, server), server
    store = Store.open(database)
    coming = [drawn_dataset("sample-4", seed=turn) for turn in range(pace.turns)]
    seen = {kind: Seen() for kind in pace.kinds}
    for turn in range(len(pace.kinds) * pace.turns):
        kind = pace.kinds[turn % len(pace.kinds)]
        all_of_it, before, other = seen[kind], cpu(server), None
        if kind in {LOADED, COMES}:
            here.send(pace.seconds + 1)
        elif kind == OTHER:
            loaded = seen[LOADED]
            share = (loaded.needed + loaded.clients) / loaded.asked
            other = context.Process(target=compute, args=(share,), daemon=True)
            other.start()
        if kind == COMES:  # at once, for the service looks every few seconds for what has come
            store.add_dataset(None, coming.pop())
        time.sleep(1)
        began = at_a_point(database, processes)
        time.sleep(pace.seconds)
        seconds, points, bench_seconds, bench, served = at_a_point(database, processes) - began
        all_of_it.seconds += seconds
        all_of_it.points += int(points)
        all_of_it.bench_seconds += bench_seconds
        all_of_it.bench += bench
        all_of_it.server += served
        if kind in {LOADED, COMES}:
            told, events, computed = here.recv()
            all_of_it.events += events
            all_of_it.clients += computed
            all_of_it.needed += cpu(server) - before
            for path, values in told.items():
                all_of_it.latencies[path] += values
        elif other is not None:
            other.kill()
            other.join()
    store.close()
    here.send(None)
    clients.join()
    show(pace, seen)
    if not pace.by_time:
        show_costs(server, port, token)


def show_costs(server: int, port: int, token: str) -> None:
    """Print what the server computes for a request and for the streams, while the campaign goes on."""
    idle = spent(server, 5.0) / 5.0
    for path in dict.fromkeys(PATHS):
        began = time.monotonic(), cpu(server)
        asyncio.run(one_by_one(port, token, path))
        needed = cpu(server) - began[1] - idle * (time.monotonic() - began[0])
        print(f"{path:34} {1000 * needed / SINGLY:6.2f} ms CPU a request")
    began = time.monotonic(), cpu(server)
    heard = asyncio.run(listen_only(port, token, 10.0))
    needed = cpu(server) - began[1] - idle * (time.monotonic() - began[0])
    print(f"{'event of a stream':34} {1000 * needed / heard:6.3f} ms CPU, with {STREAMS} that hear it\n")


def show(pace: Pace, seen: dict[str, Seen]) -> None:
    """Print what was measured."""
    print(f"{pace.name}; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; ", end="")
    print(f"{pace.turns} turns of {pace.seconds:g} s of each kind\n")
    print(f"{'':50} {'points/s':>9} {'falls by':>9} {'bench CPU ms/point':>19} {'bench CPU':>10} {'server CPU':>11}")
    alone = None
    for kind, each in seen.items():
        speed = (each.bench_seconds if pace.by_time else each.points) / each.seconds
        alone = alone or speed
        falls = 100 * (1 - speed / alone)
        print(
            f"{kind:50} {each.points / each.seconds:9.2f} {falls:7.1f} % {1000 * each.bench / each.points:19.2f} "
            f"{100 * each.bench / each.seconds:8.0f} % {100 * each.server / each.seconds:9.0f} %"
        )
        if kind == ALONE:
            tell(f"{pace.name}: points a second while nobody listens", each.points / each.seconds)
        else:
            aim, because = ("< 5", "it takes all that two cores give") if kind == LOADED else ("", "")
            tell(f"{pace.name}, {kind}: falls by", falls, "%", aim, because)
    print()
    for kind, each in seen.items():
        if not each.events:
            continue
        loaded = each.asked
        print(
            f"{kind}: a stream saw {each.events / pace.turns / STREAMS:.0f} events a turn; CPU time of {loaded:.0f} s:"
        )
        print(
            f"the server computed {100 * each.needed / loaded:.0f} %, the clients {100 * each.clients / loaded:.0f} %"
        )
        print(f"{'latency, ms':34} {'requests':>9} {'median':>8} {'99 %':>8} {'worst':>8}")
        for path, values in each.latencies.items():
            median, high, worst = 1000 * np.percentile(values, [50, 99, 100])
            print(f"{path:34} {len(values):9} {median:8.1f} {high:8.1f} {worst:8.1f}")
            tell(f"{pace.name}, {kind}: `{path}`, 99 %", high, f"ms (worst {worst:.0f})", "< 50")
        print()


if __name__ == "__main__":
    main()
