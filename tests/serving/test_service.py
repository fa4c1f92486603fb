"""The service without sockets: what lines mean, what is kept, what is bounded."""

import asyncio
import contextlib
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sigmax.descriptions.local import with_local
from sigmax.errors import InputError
from sigmax.files.description import LocalPart
from sigmax.files.table import Table
from sigmax.records import load_plots
from sigmax.serving import Checkpoint, Feed, Service
from sigmax.serving.ends import End, parse_end
from sigmax.serving.lines import Line, Splitter, quoted
from sigmax.serving.numbers import LocalRows
from sigmax.serving.outbox import Outbox
from sigmax.serving.tree import dumped, loaded
from tests.serving.feed import TOML, lines, written


@pytest.fixture(scope="module")
def feed(tmp_path_factory):
    return Feed(written(tmp_path_factory.mktemp("feed")))


def tracked(service, some):
    """All updates of lines, given a few at a time."""
    updates = []
    for i in range(0, len(some), 7):
        service.accept([Line(line, True) for line in some[i : i + 7]])
        updates += list(service.work())
    return updates


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_a_stream_is_cut_the_same_however_it_comes(size):
    data = b'{"a":1}\r\n\n' + b"x" * 50 + b'\n{"b":2}\n{"c":' + b" " * 9 + b"3}"
    splitter, found = Splitter(20), []
    for i in range(0, len(data), size):
        found += splitter.feed(data[i : i + size])
        assert len(splitter._held) <= 20
    found += splitter.last()
    assert [line.whole for line in found] == [True, False, True, True]
    assert found[0].text == b'{"a":1}'
    assert found[1].text == b"x" * 20


def test_what_is_quoted_shows_no_control_characters():
    assert quoted(b"\x1b[31m\xff" + b"a" * 400).startswith(r"\x1b[31m")
    assert len(quoted(b"a" * 400)) == 201


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"nonsense", "no JSON"),
        (b"[1]", "not an array"),
        (b"null", "not null"),
        (b"true", "not true or false"),
        (b"3", "not a number"),
        (b'"x"', "not text"),
        (b'{"n_km": 1, "e_km": 2}', "needs a time"),
        (b'{"t": "soon", "n_km": 1}', "is no time"),
        (b'{"t": 1, "n_km": "1"}', "is no number"),
        (b'{"t": 1, "n_km": 1e300}', "beyond all measure"),
        (b'{"t": 1, "n_km": NaN}', "radar has n_km, e_km"),
        (b'{"t": 1, "n_km": NaN, "e_km": Infinity}', "beyond all measure"),
        (b'{"t": 1, "n_km": NaN, "e_km": 1' + b"0" * 400 + b"}", "beyond all measure"),
        (b'{"t": NaN, "n_km": 1}', "needs a time"),
        (b'{"t": 1, "n_km": NaN, }', "no JSON"),
        (b'{"t": 1, "plots": [{"n_km": NaN, "e_km": -Infinity}]}', "beyond all measure"),
        (b'{"t": 1, "other": 1}', "radar has n_km, e_km"),
        (b'{"t": 1, "sensor": "sonar", "n_km": 1}', "sonar"),
        (b'{"t": 1, "plots": 3}', "list of objects"),
        (b'{"t": 1, "n_km": 1, "serial": "x"}', "whole number"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * 5000, "no JSON"),
    ],
)
def test_a_malformed_line_is_refused_with_the_reason_and_changes_nothing(feed, line, why):
    service = Service(feed)
    (verdict,) = service.accept([Line(line, True)])
    assert not verdict.taken
    assert why in verdict.why
    assert list(service.work()) == []
    assert service.counts == {"refused": 1}


def test_malformed_lines_between_change_no_track(feed):
    good = lines(12)
    mixed = [x for line in good for x in (b"{", line, b'{"t": 5}')]
    one, two = Service(feed), Service(feed)
    assert tracked(one, good) == tracked(two, mixed)
    assert two.counts == {"taken": len(good), "refused": 2 * len(good)}


def test_rows_and_whole_scans_say_the_same(feed):
    rows, whole = Service(feed), Service(feed)
    tracked(rows, [*lines(12), b'{"flush": true}'])
    tracked(whole, lines(12, whole=True))
    assert rows.latest == whole.latest
    tracks = json.loads(whole.latest)["tracks"]
    truth = np.array([[0.0, 0], [8, 3]]) + 22.0 * np.array([[0.1, 0.05], [-0.1, 0.08]])
    place = np.array([t["mean"][:2] for t in tracks]) / 1e3
    assert all(np.linalg.norm(place - t, axis=1).min() < 0.1 for t in truth)


def test_a_timestamp_is_its_seconds(feed):
    message = feed.read(b'{"t": "1970-01-01T00:01:00+00:00", "n_km": 1.5, "e_km": null}')
    assert message.plots[0].time == 60.0
    assert message.plots[0].z[0] == 1500.0
    assert np.isnan(message.plots[0].z[1])


@pytest.mark.parametrize("nothing", ["null", "NaN", None])
def test_whatever_stands_for_nothing_in_a_line_is_missing(feed, nothing):
    """Of a plot or of a scan: the same as if the key were not there."""
    part = "" if nothing is None else f', "e_km": {nothing}'
    for line, whole in (
        (f'{{"t": 1, "n_km": 1{part}}}', '{"t": 1, "n_km": 1}'),
        (f'{{"t": 1, "plots": [{{"n_km": 1{part}}}, {{"n_km": 2, "e_km": 3}}]}}',
         '{"t": 1, "plots": [{"n_km": 1}, {"n_km": 2, "e_km": 3}]}'),
    ):  # fmt: skip
        one, two = feed.read(line.encode()), feed.read(whole.encode())
        z = [p.z for p in one.plots] if one.scan is None else one.scan.z
        np.testing.assert_array_equal(z, [p.z for p in two.plots] if two.scan is None else two.scan.z)
        assert np.isnan(z[0][1])


def test_a_feed_takes_places_on_the_earth_dates_and_numbers_that_mean_none(tmp_path):
    """The same as a table with the same description."""
    local = (
        '[local]\nlatitude = { column = "lat", unit = "deg", missing = 91 }\n'
        'longitude = { column = "lon", unit = "deg" }\norigin = ["52 deg", "4 deg"]\n\n[sensors.radar]'
    )
    text = TOML.replace("[sensors.radar]", local).replace(
        'north = { column = "n_km", unit = "km" }, east = { column = "e_km", unit = "km" }',
        'north = { column = "local.north", missing = 0 }, east = "local.east"',
    )
    text = text.replace('time = "t"', 'time = { column = "t", format = "%d/%m/%Y %H:%M:%S" }')
    (tmp_path / "feed.toml").write_text(text)
    (tmp_path / "plots.csv").write_text("t,lat,lon\n01/05/2024 12:00:00,52.01,4.02\n01/05/2024 12:00:02,52.011,4.021\n")
    there = Feed(tmp_path / "feed.toml")
    (table,) = [load_plots(str(tmp_path / "feed.toml"))]
    for scan, line in zip(table.scans, (("12:00:00", 52.01, 4.02), ("12:00:02", 52.011, 4.021)), strict=True):
        row = {"t": f"01/05/2024 {line[0]}", "lat": line[1], "lon": line[2]}
        message = there.read(json.dumps(row).encode())
        np.testing.assert_allclose(message.plots[0].z, scan.z[0], rtol=1e-12)
        whole = there.read(json.dumps({"t": row["t"], "plots": [row]}).encode())
        np.testing.assert_allclose(whole.scan.z, scan.z, rtol=1e-12)
    assert (there.read(b'{"t": "01/05/2024 12:00:00", "lat": 52.01, "lon": 4.02}').plots[0].time) == 1714564800
    for wrong, why in (('"lat": 91, "lon": 4', "radar has"), ('"lat": 95, "lon": 4', "no place on the earth"),
                       ('"lat": 0, "lon": 4', "radar has"), ('"lat": "x", "lon": 4', "no number")):  # fmt: skip
        with pytest.raises(InputError, match=why):
            there.read(f'{{"t": "01/05/2024 12:00:00", {wrong}}}'.encode())
    with pytest.raises(InputError, match="such as 31/01/2026 12:00:00"):
        there.read(b'{"t": "2024-05-01", "lat": 52, "lon": 4}')


def test_a_delayed_sensor_measured_before_its_lines(tmp_path):
    late = TOML.replace('east = "30 m" }', 'east = "30 m" }\ndelay = "0.5 s"')
    (tmp_path / "feed.toml").write_text(late)
    feed = Feed(tmp_path / "feed.toml")
    assert feed.read(b'{"t": 10, "n_km": 1, "e_km": 2}').plots[0].time == 9.5
    assert feed.read(b'{"t": 10, "plots": [{"n_km": 1, "e_km": 2}]}').scan.time == 9.5
    other = late.split("[sensors.radar]")[1].split("[tracking]")[0].replace("0.5 s", "2 s")
    two = late.replace("[tracking]", f"[sensors.lidar]{other}[tracking]", 1)
    (tmp_path / "feed.toml").write_text(two + "[tracking.sensors.lidar]\ndetection = 0.9\nclutter = 1e-9\n")
    with pytest.raises(InputError, match=r"late must be at least what the delays of sensors differ by, 1\.5 s"):
        Feed(tmp_path / "feed.toml")


def test_a_number_taken_before_is_acknowledged_but_not_tracked_again(feed):
    once, twice = Service(feed), Service(feed)
    some = lines(8)
    assert tracked(once, some) == tracked(twice, [*some[:20], *some])
    assert twice.counts["repeated"] == 20


@pytest.mark.parametrize("stop", [3, 17, 40])
def test_a_service_goes_on_bit_for_bit_from_its_journal_and_from_its_state(feed, tmp_path, stop):
    some = lines(16)
    whole = Service(feed)
    expected = tracked(whole, some)
    first = Checkpoint(tmp_path, feed.digest)
    before = Service(feed, first)
    got = tracked(before, some[:stop])
    if stop == 17:
        before.keep()
    first.close()
    second = Checkpoint(tmp_path, feed.digest)
    after = Service(feed, second)
    got += tracked(after, some)
    second.close()
    assert got == expected
    assert after.counts["taken"] == len(some)


def test_a_torn_end_of_the_journal_is_dropped(feed, tmp_path):
    first = Checkpoint(tmp_path, feed.digest)
    first.append([b"one", b"two"])
    first.close()
    (journal,) = tmp_path.glob("journal-*")
    with journal.open("ab") as file:
        file.write(b"00000000 thr")
    second = Checkpoint(tmp_path, feed.digest)
    assert second.lines == [b"one", b"two"]
    assert second.torn == 12
    second.append([b"three"])
    second.close()
    third = Checkpoint(tmp_path, feed.digest)
    assert third.lines == [b"one", b"two", b"three"]
    with pytest.raises(InputError, match="in use"):
        Checkpoint(tmp_path, feed.digest)
    third.close()
    with pytest.raises(InputError, match="another description"):
        Checkpoint(tmp_path, "other")


def kept(folder, feed):
    """A checkpoint with lines in its journal."""
    checkpoint = Checkpoint(folder, feed.digest)
    tracked(Service(feed, checkpoint), lines(3))
    checkpoint.close()
    (journal,), (state,) = folder.glob("journal-*"), folder.glob("state-*")
    return journal, state


def test_a_damaged_journal_is_told_from_a_torn_one_and_kept(feed, tmp_path):
    journal, _ = kept(tmp_path, feed)
    damaged = bytearray(journal.read_bytes())
    damaged[damaged.index(b"\n") + 20] ^= 1
    journal.write_bytes(damaged)
    again = Checkpoint(tmp_path, feed.digest)
    assert (len(again.lines), again.beyond) == (1, len(lines(3)) - 2)
    again.close()
    assert [path.read_bytes() for path in tmp_path.glob("damaged-*")] == [damaged]


def test_any_damage_of_a_saved_value_is_told_the_same_way():
    whole, rng = dumped(("x", np.arange(5.0), {"a": [1, None]})), np.random.default_rng(0)
    for k in range(len(whole)):
        damaged = bytearray(whole)
        damaged[k] ^= int(rng.integers(1, 256))
        with contextlib.suppress(InputError):
            loaded(bytes(damaged))


@pytest.mark.parametrize("harm", ["gone", "cut", "empty", "folder"])
def test_a_state_that_is_damaged_is_refused_and_nothing_is_removed(feed, tmp_path, harm):
    journal, state = kept(tmp_path, feed)
    before = state.read_bytes()
    state.unlink()
    if harm == "folder":
        state.mkdir()
    elif harm != "gone":
        state.write_bytes(before[: len(before) // 2] if harm == "cut" else b"")
    with pytest.raises(InputError, match=re.escape(str(tmp_path))):
        Checkpoint(tmp_path, feed.digest)
    assert journal.stat().st_size > 0


def test_a_full_disk_is_an_error_for_people(feed, tmp_path):
    checkpoint = Checkpoint(tmp_path, feed.digest)
    service = Service(feed, checkpoint)
    checkpoint._journal.close()
    checkpoint._journal = open("/dev/full", "wb", buffering=0)  # noqa: SIM115  closed with the checkpoint
    with pytest.raises(InputError, match=r"cannot be written: .*space"):
        service.accept([Line(lines(1)[0], True)])
    checkpoint.close()


def test_a_scan_that_cannot_be_tracked_is_told_and_left_out(feed, monkeypatch):
    whole, some = Service(feed), lines(6, whole=True)
    step = whole.tracker.step

    def failing(scan):
        if scan.time == 4.0:
            raise FloatingPointError("out of all bounds")
        return step(scan)

    monkeypatch.setattr(whole.tracker, "step", failing)
    updates = tracked(whole, some)
    assert list(whole.failures) == ["radar at 4 s: out of all bounds"]
    assert whole.counts["failed"] == 1
    without = tracked(Service(feed), [line for line in some if json.loads(line)["t"] != 4.0])
    assert updates == without


def test_memory_stays_bounded(feed):
    service = Service(feed)
    tracked(service, lines(60))
    assert len(service.tracker.history) <= 2
    assert not service._due
    assert len(dumped(service.tracker.save())) < 200_000


def test_values_come_back_bit_for_bit(feed):
    service = Service(feed)
    tracked(service, lines(10))
    saved = service.tracker.save()
    assert dumped(loaded(dumped(saved))) == dumped(saved)
    with pytest.raises(InputError, match="no saved value"):
        loaded(b"PK nonsense")
    with pytest.raises(InputError, match="cannot be saved"):
        dumped(object())


def test_a_consumer_that_does_not_read_loses_the_oldest_and_is_told():
    async def read():
        box = Outbox(room=1000)
        for k in range(100):
            box.put(b"%03d" % k + b"x" * 97)
        told = await box.get()
        return told, await box.get(), box.idle

    told, following, idle = asyncio.run(read())
    assert told.startswith(b'{"missed":90}\n090x')
    assert following.startswith(b"091x")
    assert not idle


def test_ends_are_on_loopback_unless_told():
    assert parse_end("tcp:7700", "--from") == End("tcp", "127.0.0.1", 7700)
    assert parse_end("tcp:0.0.0.0:7700", "--from") == End("tcp", "0.0.0.0", 7700)
    assert parse_end("nats:4222/plots", "--from") == End("nats", "127.0.0.1", 4222, "plots")
    assert parse_end("tcp:[::1]:7", "--to") == End("tcp", "::1", 7)
    for wrong in ("", "tcp", "tcp:x", "tcp:70000", "nats:4222", "tcp:1/x", "udp:1"):
        with pytest.raises(InputError, match="--to is"):
            parse_end(wrong, "--to")


@pytest.mark.parametrize("frame", ["plane", "utm"])
def test_places_of_a_line_are_those_of_a_table(frame: str) -> None:
    """With heights, speeds and courses, in a plane and on the grid of UTM."""
    columns = {"latitude": "deg", "longitude": "deg", "height": "ft", "speed": "kn", "course": "deg"}
    given = {name: {"column": name, "unit": unit} for name, unit in columns.items()}
    part = LocalPart(**given, origin=["52.1 deg", "4.3 deg", "20 m"], frame=frame)
    rows = pd.DataFrame(
        {
            "latitude": [52.2, 52.05],
            "longitude": [4.1, 4.6],
            "height": [300.0, 1e3],
            "speed": [12.0, 3.0],
            "course": [40.0, 275.0],
        }
    )
    table = with_local(Table(Path("rows.csv"), rows, 2), part).columns
    made = [LocalRows(part).row(row) for row in rows.to_dict("records")]
    for name in ("local.east", "local.north", "local.up", "local.down", "local.velocity_east", "local.velocity_north"):
        np.testing.assert_allclose([row[name] for row in made], table[name], rtol=1e-12, err_msg=name)
