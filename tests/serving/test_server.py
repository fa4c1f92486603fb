"""The service as a process: sockets, pipes, kills, slow consumers, NATS."""

import contextlib
import json
import os
import random
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest

from sigmax.serving import Feed, Service
from tests.serving.feed import lines, written
from tests.serving.test_service import tracked

WAIT = 120


@contextlib.contextmanager
def process(folder, *arguments, **streams):
    """`sigmax serve` on the feed for tests; ended in any case."""
    command = [sys.executable, "-m", "sigmax.cli", "serve", str(written(folder)), *arguments]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, **streams)
    try:
        yield run
    finally:
        run.kill()
        run.wait()
        for stream in (run.stdin, run.stdout, run.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


def addresses(run):
    """Where it says that it listens."""
    for raw in run.stderr:
        text = raw.decode()
        if "plots from" in text:
            found = [part.split()[0].rstrip(",") for part in text.split("tcp:")[1:]]
            return [(host, int(port)) for host, port in (f.rsplit(":", 1) for f in found)]
    raise AssertionError("the service ended before it listened")


def reader(address):
    connection = socket.create_connection(address, timeout=WAIT)
    return connection, connection.makefile("rwb")


def until_update(file, number):
    for raw in file:
        told = json.loads(raw)
        if told.get("update", 0) >= number:
            return told
    raise AssertionError("the service ended the connection")


def sent_until_killed(run, some, from_serial, seconds):
    """Send lines, and kill the process after some time; the last line acknowledged, counted from the first."""
    (plots, _) = addresses(run)
    acknowledged = from_serial
    with contextlib.closing(socket.create_connection(plots, timeout=WAIT)) as connection:
        connection.setblocking(False)
        data = b"".join(line + b"\n" for line in some[from_serial : from_serial + 5000])
        ended, heard, killed = time.monotonic() + seconds, b"", False
        while not killed:
            killed = time.monotonic() > ended
            if killed:
                run.send_signal(signal.SIGKILL)
                run.wait()
            with contextlib.suppress(BlockingIOError, ConnectionError):
                if data and not killed:
                    data = data[connection.send(data[:400]) :]
            with contextlib.suppress(BlockingIOError, ConnectionError):
                heard += connection.recv(1 << 16)
            time.sleep(0.0005)
    for raw in heard.split(b"\n")[:-1]:
        acknowledged = max(acknowledged, from_serial + json.loads(raw).get("ack", 0))
    return acknowledged


def killed_often(tmp_path, kills, seed):
    """Tracks after kills at random moments equal those without; each start sends what was not acknowledged."""
    some = lines(400 * kills, whole=False)
    rng = random.Random(seed)
    ends = ("--from", "tcp:0", "--to", "tcp:0", "--checkpoint", str(tmp_path / "state"), "--quiet", "1000")
    at = 0
    for kill in range(kills):
        print(f"kill {kill + 1}: {at} lines acknowledged", flush=True)
        with process(tmp_path, *ends) as run:
            if rng.random() < 0.2:
                # While it starts, or takes up what was.
                time.sleep(rng.uniform(0, 4))
            else:
                at = sent_until_killed(run, some, at, rng.uniform(0, 0.3))
        # Enough is left for all the others.
        assert at < len(some) - 400
    # Beyond what can have been taken without its acknowledgement having been heard.
    stop = at + 400
    with process(tmp_path, *ends) as run:
        plots, updates = addresses(run)
        with contextlib.ExitStack() as stack:
            sender, answers = reader(plots)
            stack.enter_context(sender)
            taken = json.loads(answers.readline())
            # Nothing that was acknowledged is missing.
            assert taken["serials"].get("", -1) >= at - 1
            consumer, told = reader(updates)
            stack.enter_context(consumer)
            sender.sendall(b"".join(line + b"\n" for line in [*some[at:stop], b'{"flush": true}']))
            sender.shutdown(socket.SHUT_WR)
            last = until_update(told, -(-stop // 4))
        run.send_signal(signal.SIGTERM)
        assert run.wait(WAIT) == 0
    service = Service(Feed(written(tmp_path)))
    tracked(service, [*some[:stop], b'{"flush": true}'])
    expected = json.loads(service.latest)
    assert last == expected
    assert stop > 400
    return stop


def test_killed_at_random_moments_it_goes_on_with_the_same_tracks(tmp_path):
    killed_often(tmp_path, 3, seed=1)


@pytest.mark.slow
def test_killed_a_hundred_times_it_goes_on_with_the_same_tracks(tmp_path):
    killed_often(tmp_path, 100, seed=2)


def test_a_consumer_that_stops_reading_slows_nothing_but_itself(tmp_path):
    """A consumer beside a silent one misses no update, and the sender waits for neither; bad lines are told."""
    some = lines(400, whole=True)
    with process(tmp_path, "--from", "tcp:0", "--to", "tcp:0", "--max-line", "2000") as run:
        plots, updates = addresses(run)
        with contextlib.ExitStack() as stack:
            silent = stack.enter_context(socket.create_connection(updates, timeout=WAIT))
            silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            consumer, told = reader(updates)
            stack.enter_context(consumer)
            sender, answers = reader(plots)
            stack.enter_context(sender)
            sender.sendall(b"x" * 100_000 + b"\nnonsense\n")
            assert json.loads(answers.readline())["taken"] == 0
            for _ in range(2):
                complaint = json.loads(answers.readline())
                while "refused" not in complaint:
                    complaint = json.loads(answers.readline())
            assert complaint == {"refused": 2, "why": complaint["why"], "line": "nonsense"}
            sender.sendall(b"".join(line + b"\n" for line in some))
            assert json.loads(told.readline())["state"] == ["north", "east", "vnorth", "veast"]
            seen = [json.loads(told.readline()).get("update") for _ in range(len(some))]
            assert seen == list(range(1, len(some) + 1))
            run.send_signal(signal.SIGTERM)
            assert run.wait(WAIT) == 0
        assert b"2 refused, 400 taken" in run.stderr.read()


def test_from_pipe_to_pipe_every_update_comes(tmp_path):
    some = lines(20)
    given = b"".join(line + b"\n" for line in some[:-1]) + b"{}\n" + some[-1]
    with process(tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as run:
        out, err = run.communicate(given, timeout=WAIT)
    assert run.returncode == 0
    assert [json.loads(raw).get("update") for raw in out.splitlines()] == [None, *range(1, 21)]
    assert b"1 refused, 80 taken" in err


@pytest.mark.slow
def test_nats(tmp_path):
    """Plots and updates over a real server; a request is answered once its lines are kept."""
    pytest.importorskip("nats")
    server = shutil.which("nats-server") or pytest.skip("nats-server is not installed: apt-get install nats-server")
    import asyncio

    import nats

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    broker = subprocess.Popen([server, "-a", "127.0.0.1", "-p", str(port)], stderr=subprocess.DEVNULL)
    some = lines(30, whole=True)

    async def exchange():
        client = await nats.connect(f"nats://127.0.0.1:{port}")
        updates = await client.subscribe("tracks")
        bad = json.loads((await client.request("plots", b"nonsense", timeout=WAIT)).data)
        assert bad["refused"][0]["line"] == "nonsense"
        for line in some:
            assert json.loads((await client.request("plots", line, timeout=WAIT)).data) == {"ack": 1}
        told = [json.loads((await updates.next_msg(timeout=WAIT)).data) for _ in some]
        await client.close()
        return told

    try:
        for _ in range(200):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
                break
            time.sleep(0.05)
        ends = ("--from", f"nats:{port}/plots", "--to", f"nats:{port}/tracks")
        with process(tmp_path, *ends, "--checkpoint", str(tmp_path / "state")) as run:
            for raw in run.stderr:
                if b"plots from" in raw:
                    break
            told = asyncio.run(exchange())
            run.send_signal(signal.SIGTERM)
            assert run.wait(WAIT) == 0
    finally:
        broker.terminate()
        broker.wait()
    service = Service(Feed(written(tmp_path)))
    assert told == [json.loads(update) for update in tracked(service, some)]


def test_wrong_ends_are_told_before_anything_begins(tmp_path):
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        with process(tmp_path, "--from", f"tcp:{port}", "--to", "-", stdout=subprocess.PIPE) as run:
            assert run.wait(WAIT) == 2
            assert b"cannot listen" in run.stderr.read()
    assert os.listdir(tmp_path) == ["radar.toml"]


def test_it_ends_quietly_and_at_once_when_senders_are_connected(tmp_path):
    with process(tmp_path, "--from", "tcp:0", "--to", "tcp:0") as run:
        source, sink = addresses(run)
        (connection, file), (other, _) = reader(source), reader(sink)
        file.write(b'{"t": 0, "n_km":')
        file.flush()
        file.readline()
        run.send_signal(signal.SIGTERM)
        assert run.wait(WAIT) == 0
        told = run.stderr.read().decode()
        connection.close()
        other.close()
    assert "Traceback" not in told


@pytest.mark.parametrize(("end", "most"), [(0, 64), (1, 256)], ids=["senders", "consumers"])
def test_who_finds_no_room_is_told(tmp_path, end, most):
    with process(tmp_path, "--from", "tcp:0", "--to", "tcp:0") as run, contextlib.ExitStack() as open_ones:
        address = addresses(run)[end]
        for _ in range(most):
            connection, file = reader(address)
            open_ones.enter_context(connection)
            assert "closed" not in json.loads(file.readline())
        connection, file = reader(address)
        open_ones.enter_context(connection)
        # Lines already on their way do not cost it the reason.
        file.write(b'{"t": 0, "n_km": 1, "e_km": 1}\n' * 100)
        with contextlib.suppress(OSError):
            file.flush()
        assert f"{most} " in json.loads(file.readline())["closed"]
        assert file.readline() == b""


@pytest.mark.slow
def test_a_thousand_connections_and_hostile_lines_change_no_track(tmp_path):
    """They come and go, say nonsense, half a line or nothing; the plots of one who means it are tracked as alone."""
    some, rng = lines(100), np.random.default_rng(4)
    nonsense = [
        b"\x00" * 1000, b"{" * 100_000, b"[" * 100_000, b'"' + b"a" * 100_000, b"\xff\xfe\xfd", b"null", b"1e999",
        b'{"t": 1e308, "n_km": 1e308, "e_km": -1e308}', b'{"t": NaN}', b'{"t": 1, "plots": [[[]]]}', b"}" * 100,
        b'{"flush": false, "serial": -1}', b'{"t": "9999-12-31T23:59:59Z", "n_km": null, "e_km": NaN}', b"GET /",
        b'{"t": 1, "n_km": 1' + b"0" * 5000 + b', "e_km": 1}', b'{"t": 1, "sensor": "' + b"x" * 5000 + b'"}',
    ]  # fmt: skip
    with process(tmp_path, "--from", "tcp:0", "--to", "tcp:0", "--max-line", "20000") as run:
        plots, updates = addresses(run)
        with contextlib.ExitStack() as stack:
            consumer, told = reader(updates)
            stack.enter_context(consumer)
            sender, answers = reader(plots)
            stack.enter_context(sender)
            json.loads(answers.readline())
            for k in range(1000):
                passing = socket.create_connection(plots if k % 3 else updates, timeout=WAIT)
                with passing, contextlib.suppress(OSError):
                    passing.sendall(nonsense[k % len(nonsense)] + b"\n" * int(rng.integers(2)))
                    if k % 5 == 0:
                        # The end of a connection without any courtesy.
                        passing.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                if k % 10 == 0:
                    sender.sendall(some[k // 10] + b"\n")
            sender.sendall(b"".join(line + b"\n" for line in [*some[100:], b'{"flush": true}']))
            last = until_update(told, -(-len(some) // 4))
        run.send_signal(signal.SIGTERM)
        assert run.wait(WAIT) == 0
        assert b"Traceback" not in run.stderr.read()
    service = Service(Feed(written(tmp_path)))
    tracked(service, [*some, b'{"flush": true}'])
    assert last == json.loads(service.latest)


@pytest.mark.slow
def test_it_ends_when_the_work_fails_and_lines_wait(tmp_path):
    """Nobody takes the lines of standard input any more: their end is not waited for."""
    code = """
import asyncio, sys, time
from pathlib import Path
from sigmax.serving import Feed, Service, serve
from sigmax.serving.ends import End
from sigmax.serving.server import Limits

class Failing(Service):
    def accept(self, lines):
        time.sleep(1.0)
        raise OSError("no space")

asyncio.run(serve(Failing(Feed(Path(sys.argv[1]))), End("pipe"), End("pipe"), Limits(), print))
"""
    for count in (100, 128):
        given = b"".join(line + b"\n" for line in lines(count // 4))
        run = subprocess.run(
            [sys.executable, "-c", code, str(written(tmp_path))], input=given, capture_output=True, timeout=WAIT
        )
        assert run.returncode == 1
        assert b"no space" in run.stderr


def test_sigterm_ends_it_though_nobody_reads_the_pipe(tmp_path):
    with process(tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as run:
        addresses(run)
        os.set_blocking(run.stdin.fileno(), False)
        given, sent, until = b"".join(line + b"\n" for line in lines(5000)), 0, time.monotonic() + 4.0
        while time.monotonic() < until and sent < len(given):
            with contextlib.suppress(BlockingIOError):
                sent += os.write(run.stdin.fileno(), given[sent : sent + 4096])
            time.sleep(0.001)
        run.send_signal(signal.SIGTERM)
        assert run.wait(30) == 0
        assert b"Traceback" not in run.stderr.read()
