"""Exported C: it compiles without a warning, is clean under sanitizers, and computes what Python does."""

import re
import shutil
import subprocess
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax import InputError
from sigmax.export import export_c
from sigmax.models.builtin import BUILTIN, builtin
from sigmax.spaces import conjugate, exponential, multiply, rotate
from tests.laws import test_fusion as fusion
from tests.own_records import write_csv, write_radar
from tests.test_cli import cli

STRICT = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def exported(name, filter, folder, **options):
    made = builtin(name)
    return export_c(
        filter, made.model, made.prior, folder, name=name, dt=made.dt, inputs=made.inputs, about=made.about, **options
    )


def difference(folder, *flags, compiler=("cc",), run=()):
    """Compile the test program strictly and run it; the largest difference it found."""
    (program,) = (p for p in folder.glob("test_*.c"))
    source = program.with_name(program.name.removeprefix("test_"))
    command = [*compiler, *STRICT, *flags, "-o", str(folder / "program"), str(program), str(source), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[:2000]
    assert built.stderr == ""
    done = subprocess.run([*run, str(folder / "program")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = re.search(r"difference (\S+) \(", done.stdout)
    assert found is not None
    return float(found[1])


@needs_cc
@pytest.mark.parametrize(
    ("name", "filter"),
    [
        ("radar-ct", "SRECKFB"),
        ("radar-ct", "CKF"),
        ("rover-beacon", "SRUKFB"),
        ("radar-ca", "EIF"),
        ("position-cv", "KF"),
        ("radar-offset", "TSCKF"),
    ],
)
@pytest.mark.one_in(2)
def test_exported_filters_compile_strictly_and_agree(name, filter, tmp_path):
    done = exported(name, filter, tmp_path)
    assert {p.name for p in done.files} == {p.name for p in tmp_path.iterdir()}
    assert difference(tmp_path, "-O2") < 1e-10


@needs_cc
@pytest.mark.parametrize(("filter", "biased"), [("TSCIF", True), ("CKF", False)])
def test_sensors_that_are_fused_are_one_function(filter, biased, tmp_path):
    """Compressed, stacked, with a bias, with gaps: C puts the measurements together as the library does."""
    names = ("west", "sonar", "east")
    together = sigmax.models.fused(fusion.model(names, bias=biased))
    done = export_c(filter, together, fusion.PRIOR, tmp_path, name="stations", dt=0.7)
    assert set(done.operations) == {"predict", "update"}
    text = (tmp_path / "stations.h").read_text()
    assert "const double z[5]" in text
    for words in ("west_left, west_right, sonar_range, east_left", "west compressed, east compressed, sonar stacked"):
        assert words in text
    assert difference(tmp_path, "-O2") < 1e-9


@needs_cc
def test_the_radar_model_agrees_to_twelve_digits(tmp_path):
    exported("radar-ct", "SRECKFB", tmp_path)
    assert difference(tmp_path, "-O2") < 3e-12


@needs_cc
def test_exported_code_is_clean_under_sanitizers(tmp_path):
    exported("radar-ct", "SRUKFB", tmp_path)
    probe = tmp_path / "probe"
    probe.mkdir()
    (probe / "p.c").write_text("int main(void) { return 0; }\n")
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    if subprocess.run(["cc", *flags, str(probe / "p.c"), "-o", str(probe / "p")], capture_output=True).returncode:
        pytest.skip("the compiler has no sanitizers")
    difference(tmp_path, *flags)


def hostile(filter, compiler, folder, sequences):
    """Numbers that nobody should send, to a filter under the sanitizers of a compiler; what the program printed."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    exported("radar-ct", filter, folder)
    made = builtin("radar-ct")
    text = (folder / "test_radar_ct.c").read_text()
    priors = re.findall(r"static const double prior_(?:mean|cov)\[\] = .*?;\n", text, re.S)
    z = np.asarray(made.model.sensors[""](jnp.asarray(made.prior.mean)))
    lines = [
        '#include "radar_ct.h"',
        *priors,
        f"static const double measured[] = {{{', '.join(map(repr, z.tolist()))}}};",
    ]
    lines += ["typedef radar_ct_state STATE;", "typedef radar_ct_update_told TOLD;", "enum { SIZE = 5, MEASURED = 3 };"]
    lines += [f"#define {name.upper()} radar_ct_{name}" for name in ("start", "predict", "update")]
    (folder / "hostile.h").write_text("\n".join(lines) + "\n")
    source = Path(__file__).with_name("hostile.c")
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1", "-Wno-overlength-strings"]
    program = str(folder / "hostile")
    command = [compiler, "-std=c99", "-Wall", *flags, f"-I{folder}", str(source), str(folder / "radar_ct.c")]
    built = subprocess.run([*command, "-o", program, "-lm"], capture_output=True, text=True, check=False)
    if "cannot find" in built.stderr or "libclang_rt" in built.stderr:
        pytest.skip(f"{compiler} has no sanitizers")
    assert built.returncode == 0, built.stderr[:2000]
    done = subprocess.run([program, str(sequences)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"status {done.returncode}: {done.stdout}{done.stderr[:2000]}"
    return done.stdout


@needs_cc
def test_no_number_makes_exported_code_break_its_promises(tmp_path):
    """Infinities, NaN, 1e308, denormals: nothing undefined happens, a refused step leaves the state as it was."""
    assert "refused" in hostile("SRECKFB", "gcc", tmp_path, 2000)


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("filter", ["SRECKFB", "UKF", "SREIF"])
def test_no_number_makes_any_exported_code_break_its_promises(filter, compiler, tmp_path):
    hostile(filter, compiler, tmp_path, 20_000)


@needs_cc
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
def test_exported_code_is_clean_under_valgrind(tmp_path):
    exported("radar-ct", "SRECKFB", tmp_path)
    difference(tmp_path, "-g", run=("valgrind", "-q", "--error-exitcode=9", "--leak-check=full"))


@needs_cc
def test_single_precision(tmp_path):
    exported("radar-ct", "SRECKFB", tmp_path, dtype="float32")
    assert "double" not in (tmp_path / "radar_ct.c").read_text().split("*/", 1)[1]
    assert difference(tmp_path, "-O2") < 1e-2


@needs_cc
@pytest.mark.parametrize("filter", ["SREKFB", "CIF"])
@pytest.mark.slow
def test_an_attitude_is_exported(filter, tmp_path):
    """Its mean has the numbers of a quaternion, its factor and residuals have those of deviations."""
    model = sigmax.Model(
        motion=lambda x, dt, u: multiply(x, exponential(u * dt)),
        sensor={"sun": lambda x: rotate(conjugate(x), jnp.array([1.0, 0.0, 0.0])), "stars": lambda x: x},
        state=[sigmax.rotation("attitude")],
        measurement={"stars": [sigmax.rotation("seen")]},
        Q=[1e-4, 2e-4, 3e-4],
        R={"sun": [0.01, 0.01, 0.02], "stars": [0.001, 0.002, 0.003]},
    )
    prior = sigmax.Gaussian([1.0, 0, 0, 0], [0.1, 0.2, 0.1])
    sigmax.export_c(filter, model, prior, tmp_path, dt=0.5, inputs=[0.1, -0.2, 0.3])
    text = (tmp_path / "filter.h").read_text()
    assert "mean[4]; /* attitude_w, attitude_x" in text
    assert "factor[6]; /* of attitude_roll, attitude_pitch, attitude_yaw */" in text
    assert "residual[3]; /* seen_roll" in text
    done = subprocess.run(["make", "-C", str(tmp_path), "test"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_makefile_tests(tmp_path):
    exported("position-cv", "SREKF", tmp_path)
    done = subprocess.run(["make", "-C", str(tmp_path), "test"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "60 steps" in done.stdout


def test_the_text_is_the_same_on_every_export(tmp_path):
    for folder in ("a", "b"):
        exported("radar-ct", "SREKFB", tmp_path / folder)
    for file in ("radar_ct.c", "radar_ct.h", "Makefile"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    text = (tmp_path / "a" / "radar_ct.c").read_text()
    assert "malloc" not in text
    assert set(re.findall(r"#include <(\w+)\.h>", text)) == {"math", "stddef"}
    for word in ("SREKFB", "north", "turn_rate", "multiplications", "the motion, linearised"):
        assert word in text


@needs_cc
def test_several_sensors_and_functions_of_the_user(tmp_path):
    heights = jnp.asarray(np.sin(np.arange(12.0)))
    model = sigmax.Model(
        motion=lambda x, dt, u: jnp.stack([x[0] + dt * x[1] + u[0], x[1]]),
        sensor={
            "terrain": lambda x: jnp.interp(x[:1], jnp.arange(12.0), heights),
            "2nd gauge": lambda x: jnp.stack([x[0], x[1] ** 2]),
        },
        Q=lambda x, dt: jnp.diag(jnp.stack([0.01 * dt, 0.01 * dt * (1 + x[1] ** 2)])),
        R={"terrain": lambda x: jnp.stack([0.01 + 0 * x[0]]), "2nd gauge": [[0.5, 0.1], [0.1, 0.3]]},
        state=("sin", "double"),
        measurement={"terrain": ("log",), "2nd gauge": ("v2", "v²")},
    )
    export_c("SRUKF", model, sigmax.Gaussian([2.0, 0.1], np.eye(2)), tmp_path, name="2 floats", dt=0.5, inputs=[0.01])
    assert "_2_floats_update__2nd_gauge" in (tmp_path / "_2_floats.h").read_text()
    assert difference(tmp_path) < 1e-9


def test_what_cannot_be_exported_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prior = sigmax.Gaussian([0.0, 1.0], np.eye(2))
    model = sigmax.Model(motion=lambda x, dt: x, sensor=jnp.sort, Q=[1.0, 1.0], R=[1.0, 1.0])
    with pytest.raises(InputError, match="'sort' cannot be lowered"):
        export_c("EKF", model, prior, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    for arguments, words in {
        ("radar-cd",): "is no model: give a built-in one (radar-ct",
        ("radar-ct", "-f", "SRCKFBB"): "did you mean SRCKFB",
        ("gone.py:make",): "there is no file gone.py",
        ("radar-ct", "-f", "EKF:fixed=speed"): "fixed components belong to sigmax track",
    }.items():
        assert cli("export", "c", *arguments) == 2
        assert words in capsys.readouterr().err
    (tmp_path / "own.py").write_text("def make():\n    return 1\n")
    assert cli("export", "c", "own.py:make") == 2
    assert "must give a pair" in capsys.readouterr().err
    (tmp_path / "export").write_text("in the way")
    assert cli("export", "c", "position-cv", "-f", "KF") == 2
    assert "cannot be written" in capsys.readouterr().err


@needs_cc
def test_the_command_line_exports_models_of_every_kind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_radar(tmp_path)
    (tmp_path / "own.py").write_text(
        "import numpy as np, sigmax\n"
        "def make():\n"
        "    model = sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x**2, Q=[0.01], R=[0.1])\n"
        "    return model, sigmax.Gaussian([1.0], [[1.0]])\n"
    )
    for model, name in (("radar-ct", "radar_ct"), ("radar.toml", "radar"), ("own.py:make", "own")):
        assert cli("export", "c", model, "--filter", "EKF", "--out", f"out/{name}") == 0
        assert difference(Path("out") / name) < 1e-9


def rover(folder, beacons=((0.0, 0.0), (60.0, 10.0), (20.0, 50.0))):
    """A rover by odometry that hears one beacon at a time: a single row's inputs would make it unobservable."""
    rng, x, rows = np.random.default_rng(2), np.array([20.0, 10.0, 0.5]), []
    for k in range(300):
        x = x + (0.2 if k else 0.0) * np.array([2 * np.cos(x[2]), 2 * np.sin(x[2]), 0.15])
        beacon = beacons[k // 3 % len(beacons)] if k % 3 == 0 else (np.nan, np.nan)
        distance = np.hypot(x[0] - beacon[0], x[1] - beacon[1]) + 0.3 * rng.standard_normal()
        rows.append((0.2 * k, 2.0, 0.15, distance, *beacon))
    columns = ["t", "speed", "turn_rate", "range", "beacon_x", "beacon_y"]
    write_csv(folder / "rover.csv", {name: [row[i] for row in rows] for i, name in enumerate(columns)})
    (folder / "rover.toml").write_text(
        'data = "rover.csv"\ntime = "t"\n[motion]\nkind = "unicycle"\n'
        'noise = { position = "5 cm", heading = "1 deg" }\n'
        'inputs = { speed = "speed", turn_rate = "turn_rate" }\n[sensors.radio]\nkind = "range_only"\n'
        'columns = { range = "range" }\nnoise = { range = "30 cm" }\n'
        'inputs = { beacon_x = "beacon_x", beacon_y = "beacon_y" }\n[prior]\nx = { mean = 20, std = 1 }\n'
        'y = { mean = 10, std = 1 }\nheading = { mean = 0.5, std = "5 deg" }\n'
    )
    return folder / "rover.toml"


@needs_cc
@pytest.mark.parametrize("filter", ["EKF", "SREKF", "SREKFB"])
def test_the_test_of_a_record_runs_over_its_own_rows(filter, tmp_path, monkeypatch):
    """Measurements, inputs and times of the record, in the order in which they came."""
    monkeypatch.chdir(tmp_path)
    path = rover(tmp_path)
    assert cli("export", "c", path.name, "-f", filter, "-o", "out") == 0
    text = (tmp_path / "out" / "test_rover.c").read_text()
    record = sigmax.records.load(str(path))
    found = {}
    for name in ("dt", "u", "z_radio"):
        numbers = re.search(rf"{name}\[\] = \{{(.*?)\}};", text, re.S)[1]
        found[name] = [np.nan if "NAN" in word else float(word) for word in numbers.split(",")]
    count = len(found["dt"])
    assert count >= 150
    np.testing.assert_array_equal(found["dt"], record.dt[0, 1 : count + 1])
    np.testing.assert_array_equal(found["u"], record.inputs[0, 1 : count + 1].ravel())
    np.testing.assert_array_equal(found["z_radio"], record.z["radio"][0, 1 : count + 1].ravel())
    # It needs no wider limit than any other.
    assert "at most %.0e" in text
    assert difference(tmp_path / "out", "-O2") < 1e-9


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_test_of_every_correct_export_passes(name, dtype, tmp_path):
    """The whole catalogue on every built-in model: the limit of the test knows how far rounding is carried."""
    wrong, refused = [], []
    for filter in sigmax.names():
        folder = tmp_path / filter
        try:
            exported(name, filter, folder, dtype=dtype)
        except InputError as error:
            refused.append(f"{filter}: {error}")
            continue
        done = subprocess.run(["make", "-C", str(folder), "test"], capture_output=True, text=True, check=False)
        if done.returncode:
            wrong.append(f"{filter}: {done.stdout}{done.stderr}")
    assert not wrong, "\n".join(wrong)
    # What a filter is not for is refused; most are for most models.
    assert len(refused) < len(sigmax.names()) / 2, refused


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("beacons", [((0.0, 0.0),), ((0.0, 0.0), (60.0, 10.0))])
def test_the_test_of_every_export_of_a_range_only_record_passes(beacons, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = rover(tmp_path, beacons)
    for filter in sigmax.names():
        if cli("export", "c", path.name, "-f", filter, "-o", filter) == 0:
            done = subprocess.run(["make", "-C", filter, "test"], capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{filter}: {done.stdout}{done.stderr}"


@needs_cc
def test_the_test_of_an_export_finds_a_filter_with_other_noise(tmp_path):
    for folder, variance in (("right", 1.0), ("other", 1.00001)):
        model = sigmax.Model(
            motion=lambda x, dt: jnp.stack([x[0] + dt * x[1], x[1]]), sensor=lambda x: x[:1], Q=[0.1, 0.1], R=[variance]
        )
        export_c("EKF", model, sigmax.Gaussian([0.0, 1.0], np.eye(2)), tmp_path / folder)
    shutil.copy(tmp_path / "other" / "filter.c", tmp_path / "right" / "filter.c")
    done = subprocess.run(["make", "-C", str(tmp_path / "right"), "test"], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "largest difference" in done.stdout


@pytest.mark.slow
@needs_cc
@pytest.mark.skipif(
    shutil.which("arm-linux-gnueabihf-gcc") is None or shutil.which("qemu-arm") is None,
    reason="needs the Debian packages gcc-arm-linux-gnueabihf and qemu-user",
)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_exported_filters_run_on_a_32_bit_arm(tmp_path, dtype):
    exported("radar-ct", "SRECKFB", tmp_path, dtype=dtype)
    worst = difference(tmp_path, "-O2", "-static", compiler=("arm-linux-gnueabihf-gcc",), run=("qemu-arm",))
    assert worst < (1e-10 if dtype == "float64" else 1e-2)


def test_every_filter_says_what_it_costs(tmp_path):
    costs = {f: exported("radar-ct", f, tmp_path / f).operations for f in ("SREKFB", "SRECKFB", "SRCKFB")}
    assert costs["SREKFB"]["update"] < costs["SRCKFB"]["update"]
    assert costs["SRECKFB"]["predict"] == costs["SREKFB"]["predict"] < costs["SRCKFB"]["predict"]
