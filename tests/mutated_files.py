"""Files that a user can write, damaged in every way; and a process that hands them to the commands that read them.

Run as a program it takes the folder of sound files, and on standard input a line ``<file> <number>`` for every mutant.
It answers each with a line ``begin ...`` and a line of JSON: exit status, standard error, seconds of processor time,
memory at the peak. Its address space is limited, so that a mutant cannot take the machine's memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

CAMERA = """\
[camera]
name = "small"
width = 40
height = 30
fov_deg = 60.0
distortion = [-0.02, 0.0, 0.0, 0.0, 0.0]
[platform]
altitude_km = 500.0
altitude_sigma_km = 1.0
[optics]
f_number = 4.0
transmission = 0.8
psf_sigma_px = 0.7
[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.6
nodes = 2
[detector]
kind = "cmos"
pixel_pitch_um = 5.5
exposure_s = 2e-4
quantum_efficiency = 0.6
full_well_e = 13500
read_noise_e = 13
dark_current_e_per_s = 125
bits = 10
black_level_dn = 32
"""

SCENE = """\
# A scene of the tests.
[scene]
name = "hand"
seed = 7
[camera]
file = "camera.toml"
mount_roll_deg = 60.0
[camera.detector]
exposure_s = 1e-4
[platform]
epoch_utc = 2026-03-20T12:00:00Z
latitude_deg = 10.0
longitude_deg = -20.0
altitude_km = 500.0
heading_deg = 90.0
[attitude]
roll_deg = 1.0
pitch_deg = -2.0
[atmosphere]
profile = "us_standard"
[surface]
kind = "uniform"
albedo = 0.3
[render]
subsamples = 1
nodes = 16
orders = "single"
[prior]
altitude_sigma_km = 2.0
position_sigma_km = 1.0
attitude_sigma_deg = [5.0, 5.0, 2.0]
climate = "by_latitude_month"
"""

SUITE = """\
[suite]
name = "small"
title = "A suite of the tests"
seed = 3
estimators = ["altitude-free", "mine"]
draws = 2
keep = "failures"
[defaults]
camera = { file = "camera.toml", mount_roll_deg = 60.0 }
platform = { epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }
render = { subsamples = 1, nodes = 16, orders = "single" }
[[estimator]]
name = "mine"
command = "./mine {image} {camera}"
[[frame]]
scene = { name = "first" }
estimators = ["mine"]
[[cases]]
name = "grid"
base = { attitude = { roll_deg = 2.0 } }
grid = { "platform.latitude_deg" = { from = -10, to = 10, step = 10.0 }, "attitude.pitch_deg" = [0.0, 1.5] }
[[cases]]
name = "drawn"
sobol = { n = 4, ranges = { "sun.zenith_deg" = [10.0, 50.0], "sun.azimuth_deg" = [0.0, 90.0] } }
[[cases]]
name = "flown"
orbit = { tle = "elements.txt", n = 4, duration_s = 600.0 }
[[cases]]
name = "circle"
[cases.orbit]
epoch_utc = 2026-03-20T12:00:00Z
altitude_km = 500.0
inclination_deg = 97.4
ltan_h = 10.5
n = 3
[cases.orbit.attitude]
pointing = "nadir"
offset_deg = [0.0, 1.0, 2.0]
[[figure]]
kind = "sweep"
cases = "grid"
x = "platform.latitude_deg"
[stability]
altitude_km = 500.0
positions = 8
months = [1, 7]
[[stability.band]]
name = "co2"
lo_um = 14.0
hi_um = 16.25
"""

REGRESSION = """\
[suite]
name = "night"
estimators = ["altitude-free"]
[defaults]
camera = { file = "camera.toml", mount_roll_deg = 60.0 }
platform = { altitude_km = 500.0 }
[[cases]]
name = "day"
sobol = { n = 4, ranges = { "sun.zenith_deg" = [10.0, 50.0], "platform.latitude_deg" = [-75.0, 75.0] } }
[regression]
replicates = 6
most_batches = 2
[[regression.gate]]
name = "replay-accuracy"
lane = "replay"
metric = "nadir_error"
cases = ["day"]
margin = 20.0
unit = "arcsec"
reason = "a fifth of what is specified"
"""

STUDY = """\
[study]
name = "small"
seed = 1
estimators = ["altitude-free"]
frame_rate_hz = 2.0

[[requirement]]
id = "R1"
error_deg = 0.05
availability = 0.9

[defaults]
camera = { file = "camera.toml", mount_roll_deg = 60.0 }
[design.choices]
pixels = [
  { name = "small", camera.camera = { width = 40, height = 30 } },
  { name = "large", camera.camera = { width = 80, height = 60 } },
]
[design.grid]
"camera.camera.fov_deg" = [60.0, 90.0]
[frames]
orbit = { epoch_utc = 2026-01-01T00:00:00Z, altitude_km = 500.0, sun_synchronous = true, ltan_h = 10.5, n = 1 }
[frames.sobol]
n = 4
ranges = { "orbit.true_anomaly_deg" = [0.0, 360.0] }
"""

PROFILE_SCENE = SCENE.replace('profile = "us_standard"', 'profile_file = "{}"')

ELEMENTS = """\
ISS (ZARYA)
1 25544U 98067A   24079.07757601  .00016717  00000+0  30771-3 0  9997
2 25544  51.6412  26.6190 0004853  29.5014  87.1346 15.49719313444639
"""

RAYS = '''\
note,obs_x_km,obs_y_km,obs_z_km,dir_x,dir_y,dir_z,sun_x,sun_y,sun_z
a,6871,0,0,-0.35,0.93,0,1,0,0
b,6871,0,0,-0.36,0.92,0,0.5,0.5,0
"the ""third""",6871,0,0,-1,0,0,1,0,0.1
d,6871.5,1e1,-0,-.375,0.91,0.01,-1,0.2,0
'''


def atmosphere() -> str:
    """Return an atmosphere file of a few levels."""
    altitude = [0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0]
    density = [2.7 ** (-z / 8.0) for z in altitude]
    band = {
        "name": "550nm",
        "wavelength_nm": 550.0,
        "scattering_per_m": [1.16e-5 * d for d in density],
        "absorption_per_m": [1e-9 * d for d in density],
        "phase": "rayleigh",
        "particle_scattering_per_m": [1e-5 * d**4 for d in density],
        "asymmetry": 0.7,
    }
    content = {
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": altitude,
        "temperature_K": [288.0, 275.0, 255.0, 223.0, 217.0, 251.0, 199.0],
        "refractivity": [2.8e-4 * d for d in density],
        "bands": [band],
        "surface": {"albedo": 0.3, "temperature_K": 288.15, "emissivity": 1.0},
    }
    return json.dumps(content, indent=1)


def profile(suffix: str) -> str:
    """Return a profile file, as CSV or JSON."""
    altitude = [5.0 * i for i in range(16)]
    pressure = [101325.0 * 2.7 ** (-z / 7.6) for z in altitude]
    columns = {
        "altitude_km": altitude,
        "temperature_K": [250.0 + i for i in range(16)],
        "pressure_Pa": pressure,
        "ozone_ppmv": [0.03 * i for i in range(16)],
    }
    if suffix == "json":
        return json.dumps(columns, indent=1)
    rows = [",".join(columns), *(",".join(map(repr, row)) for row in zip(*columns.values(), strict=True))]
    return "\n".join(rows) + "\n"


COMMANDS: dict[str, str] = {
    "scene.toml": "check scene.toml",
    "camera.toml": "estimate image.png --camera camera.toml --estimator altitude-free",
    "suite.toml": "check suite.toml",
    "regression.toml": "check regression.toml",
    "study.toml": "check study.toml",
    "rays.csv": "radiance rays.csv --atmosphere atmosphere.json -o out.csv",
    "atmosphere.json": "radiance rays.csv --atmosphere atmosphere.json -o out.csv",
    "profile.csv": "check profile-csv.toml",
    "profile.json": "check profile-json.toml",
    "elements.txt": "check suite.toml",
    "image.png": "estimate image.png --camera camera.toml --estimator altitude-free",
    "image.tiff": "estimate image.tiff --camera camera.toml --estimator altitude-free",
    "image.jpg": "estimate image.jpg --camera camera.toml --estimator altitude-free",
    "foreign.exr": "estimate foreign.exr --camera camera.toml --estimator altitude-free",
    "image.exr": "estimate image.exr --estimator altitude-free",
    "frame.exr": "observe frame.exr -o out.exr --seed 1",
    "exported.json": "estimate exported.png --estimator altitude-free",
    "exported.png": "estimate exported.png --estimator altitude-free",
    "exported.fits": "estimate exported.fits --estimator altitude-free",
    "packed.fits": "estimate packed.fits --camera camera.toml --estimator altitude-free",
    "image.npy": "estimate image.npy --camera camera.toml --estimator altitude-free",
    "image.npz": "estimate image.npz --camera camera.toml --estimator altitude-free",
    "image.csv": "estimate image.csv --camera camera.toml --estimator altitude-free",
}
"""The file that is damaged, and the command that reads it."""

TEXTS = (".toml", ".csv", ".json", ".txt")


def write_sound_files(folder: Path) -> None:
    """Write the texts that mutants are made of; pictures are written beside them by the tests."""
    texts = {
        "scene.toml": SCENE,
        "camera.toml": CAMERA,
        "suite.toml": SUITE,
        "regression.toml": REGRESSION,
        "study.toml": STUDY,
        "rays.csv": RAYS,
        "atmosphere.json": atmosphere(),
        "profile.csv": profile("csv"),
        "profile.json": profile("json"),
        "profile-csv.toml": PROFILE_SCENE.format("profile.csv"),
        "profile-json.toml": PROFILE_SCENE.format("profile.json"),
        "elements.txt": ELEMENTS,
        "mine": "#!/bin/sh\necho '{}'\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)


# What a number, word or value of a text is replaced by.
WORDS = (
    "1e308", "-1e308", "1e309", "nan", "-nan", "inf", "-inf", "NaN", "Infinity", "-Infinity", "0", "-0.0", "-1",
    "1e-320", "9" * 400, "9" * 5000, "0x10", "1_000", "true", "null", '"text"', "[]", "[1, 2]", "{}", '{"a": 1}',
    "2026-03-20", "1000000", "1000000000000", "16384", "3.7", '""', "'", '"', "\\", "\u00b2", "\u0663",
    "\U0001f30d", "..", "/dev/zero", '"/dev/zero"', '"/etc/shadow"', '"a/b"', "1e-9", "179.999", "360",
    "2147483648", "-2147483649", "18446744073709551616",
)  # fmt: skip

# Those that a file of the kind may hold: the mutant is still TOML, JSON or CSV.
_VALUES = (
    "1e308", "-1e308", "0", "-0.0", "-1", "1", "2", "1e-320", "1e-9", "3.7", "90", "-90", "179.999", "360", "1e4",
    "1e6", "1000000", "1000000000000", "16384", "2147483648", "-2147483649", "18446744073709551616", "9" * 400,
)  # fmt: skip
_TEXTS = (
    '""', '"text"', '".."', '"/dev/zero"', '"/etc/shadow"', '"a/b"', '"all"', '"none"', '"earth"', '"\\u0000"',
    '"\\u00e9"', '"by_latitude_month"', '"' + "x" * 300 + '"', "true", "false", "[]", "[1, 2]", "[1.0, 2.0, 3.0]",
    '["a"]', "[[]]", "{}", "[{}]",
)  # fmt: skip
VALUES = {
    ".toml": (
        *_VALUES,
        *_VALUES,
        *_TEXTS,
        "nan",
        "inf",
        "-inf",
        "2026-03-20",
        "0001-01-01T00:00:00Z",
        "12:00:00",
        "0xff",
    ),
    ".json": (*_VALUES, *_VALUES, *_TEXTS, "NaN", "Infinity", "-Infinity", "null", "1e309", '{"henyey_greenstein": 1}'),
    ".csv": (*_VALUES, "nan", "inf", "", " ", "x", '"1"', "1e309", "0x10", "1_0"),
    ".txt": ("0", "9", ".", "-", " ", "99999.99999999"),
}

_VALUE = re.compile(rb'(?<=[=:,\[\s])-?[0-9][0-9.eE+-]*(?=[\s,\]}])|(?<=[=:,\[\s])"[^"\n]*"(?=[\s,\]}])')

_TOKEN = re.compile(rb'-?[0-9][0-9.eE+-]*|"[^"\n]*"|[A-Za-z_][A-Za-z0-9_]*')


def _flip_bits(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 8))):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def _truncate(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    return bytes(data[: rng.randrange(len(data) + 1)])


def _cut_out(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    start = rng.randrange(len(data) + 1)
    return bytes(data[:start] + data[start + rng.choice((1, 4, 40)) :])


def _overwrite(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    start = rng.randrange(len(data) + 1)
    filling = rng.choice((b"\0", b"\xff", b"\x7f\xff\xff\xff", rng.randbytes(8)))
    return bytes(data[:start] + filling + data[start + len(filling) :])


def _insert(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    start = rng.randrange(len(data) + 1)
    filling = rng.choice(
        (b"\0", b"\xef\xbb\xbf", b"\xff\xfe", b"\x1b[31m", b"\r", "\u202e\u00e9".encode(), b"\x85", b",")
    )
    return bytes(data[:start] + filling + data[start:])


def _change_lines(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    lines = bytes(data).splitlines(keepends=True) or [b""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            del lines[i]
        case 1:
            lines.insert(j, lines[i])
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            lines[i : i + 1] = [lines[i]] * rng.choice((2, 200, 5000))
    return b"".join(lines)


def _change_word(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    places = list(_TOKEN.finditer(data))
    if not places:
        return bytes(data)
    place = rng.choice(places)
    return bytes(data[: place.start()] + rng.choice(WORDS).encode() + data[place.end() :])


def _change_value(data: bytearray, rng: random.Random, suffix: str) -> bytes:
    places = list(_VALUE.finditer(data))
    if not places:
        return bytes(data)
    place = rng.choice(places)
    return bytes(data[: place.start()] + rng.choice(VALUES[suffix]).encode() + data[place.end() :])


def _swap_words(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    places = list(_TOKEN.finditer(data))
    if len(places) < 2:
        return bytes(data)
    first, second = sorted(rng.sample(places, 2), key=lambda place: place.start())
    middle = data[first.end() : second.start()]
    return bytes(data[: first.start()] + second[0] + middle + first[0] + data[second.end() :])


def _nest(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    depth = rng.choice((50, 2000, 200_000))
    opening, closing = rng.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"{a=", b"}"), (b"a.", b"")))
    nested = opening * depth + b"1" + closing * depth
    places = list(_TOKEN.finditer(data))
    if not places or rng.random() < 0.2:
        return nested
    place = rng.choice(places)
    return bytes(data[: place.start()] + nested + data[place.end() :])


def _lengthen(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    long = rng.choice((b"x", b"9", b" ", b"\t", b"#", b"\xc3\xa9", b", 1.0", b'"')) * rng.choice(
        (300, 140_000, 1_000_000)
    )
    start = rng.randrange(len(data) + 1)
    return bytes(data[:start] + long + data[start:])


def _line_ends(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    return bytes(data).replace(b"\n", rng.choice((b"\r\n", b"\r", b"\n\n", b"\n\r\n", b"\0")))


def _encode(data: bytearray, rng: random.Random, _: list[bytes]) -> bytes:
    text = bytes(data).decode("latin-1")
    return text.encode(rng.choice(("utf-16", "utf-32", "utf-8-sig", "utf-7", "utf-16-be")))


def _other_file(data: bytearray, rng: random.Random, others: list[bytes]) -> bytes:
    other = rng.choice(others)
    match rng.randrange(4):
        case 0:
            return other
        case 1:
            return bytes(data) + other
        case 2:
            start = rng.randrange(len(data) + 1)
            return bytes(data[:start]) + other[rng.randrange(len(other) + 1) :]
        case _:
            return b""


Change = Callable[[bytearray, random.Random, list[bytes]], bytes]
BINARY: tuple[Change, ...] = (_flip_bits, _truncate, _cut_out, _overwrite, _insert, _other_file)
TEXT: tuple[Change, ...] = (
    *BINARY, _change_lines, _change_word, _change_word, _change_word, _change_word, _swap_words, _nest, _lengthen,
    _line_ends, _encode,
)  # fmt: skip


def mutant(name: str, number: int, sound: dict[str, bytes]) -> bytes:
    """Return the bytes of a damaged file; the same name and number give the same damage."""
    seed = hashlib.sha256(f"{name} {number}".encode()).digest()
    rng = random.Random(seed)
    text = name.endswith(TEXTS)
    others = [content for other, content in sorted(sound.items()) if other != name]
    data = sound[name]
    if text and rng.random() < 0.6:
        for _ in range(rng.choice((1, 1, 2, 4))):
            data = _change_value(bytearray(data), rng, Path(name).suffix)
        return data
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        # Half of the damage to pictures is in the first kilobyte, where the headers are.
        head = len(data) if text or rng.random() < 0.5 else 1024
        change = rng.choice(TEXT if text else BINARY)
        data = change(bytearray(data[:head]), rng, others) + data[head:]
    return data


@dataclass(frozen=True)
class Judged:
    """A mutant and what its command made of it; ``fault`` is empty where all is well."""

    name: str
    number: int
    status: int
    seconds: float
    memory_mb: float
    fault: str


MOST_SECONDS, MOST_MB, MOST_CHARACTERS = 10.0, 1000.0, 1500


def faults(status: int, errors: str, seconds: float, memory_mb: float) -> str:
    """Return what is wrong with a command's answer to a damaged file; empty if nothing is.

    A file that is still valid may be worked on. Otherwise the status is 2, and each mistake has one line.
    """
    wrong = []
    lines = errors.splitlines()
    if "Traceback" in errors or status not in (0, 1, 2):
        wrong.append(f"status {status}: {errors[-1500:]}")
    elif status == 2:
        if not lines or not all(line.startswith("horizonval: error: ") for line in lines) or len(lines) > 21:
            wrong.append(f"{len(lines)} lines: {errors[:1500]}")
        if any(len(line) > MOST_CHARACTERS for line in lines):
            wrong.append(f"a line of {max(map(len, lines))} characters: {errors[:300]}")
        if any(not character.isprintable() for line in lines for character in line):
            wrong.append(f"control characters: {errors[:300]!r}")
    elif any(not line.startswith("horizonval: ") for line in lines):
        wrong.append(f"status {status}, but said {errors[:600]}")
    if seconds > MOST_SECONDS:
        wrong.append(f"{seconds:.1f} s")
    if memory_mb > MOST_MB:
        wrong.append(f"{memory_mb:.0f} MB")
    return "; ".join(wrong)


def judge(folder: Path, mutants: list[tuple[str, int]]) -> Iterator[Judged]:
    """Hand mutants of the sound files in a folder to their commands, in a process that may die of them."""
    waiting = list(mutants)
    while waiting:
        worker = subprocess.Popen(
            [sys.executable, __file__, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert worker.stdin is not None
        assert worker.stdout is not None
        worker.stdin.write("".join(f"{name} {number}\n" for name, number in waiting))
        worker.stdin.close()
        begun = None
        for line in worker.stdout:
            if line.startswith("begin"):
                begun = waiting.pop(0)
                continue
            answer = json.loads(line)
            if "refused" in answer:
                raise RuntimeError(f"a sound file is refused: {answer['refused']}")
            assert begun is not None
            fault = faults(answer["status"], answer["errors"], answer["seconds"], answer["memory_mb"])
            yield Judged(*begun, answer["status"], answer["seconds"], answer["memory_mb"], fault)
            begun = None
        status = worker.wait()
        if begun is not None:
            yield Judged(*begun, status, 0.0, 0.0, f"the process died with status {status}")
        elif waiting:
            raise RuntimeError(f"the worker ended with status {status} before it began")


def _work(sound_folder: Path) -> None:
    from horizonval import cli

    sound = {path.name: path.read_bytes() for path in sorted(sound_folder.iterdir()) if path.is_file()}
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    with tempfile.TemporaryDirectory() as place, tempfile.TemporaryFile() as said:
        os.chdir(place)
        for name in sound:
            shutil.copy(sound_folder / name, name)
        for number in (1, 2):
            os.dup2(said.fileno(), number)
        wanted = [line.split() for line in sys.stdin]
        # What is loaded once and kept is no part of a mutant's memory.
        for name in dict.fromkeys(name for name, _ in wanted):
            if cli.run_command_line(COMMANDS[name].split()) == 2:
                said.seek(0)
                answers.write(json.dumps({"refused": f"{name}: {said.read().decode()}"}) + "\n")
                return
        _limit_memory()
        for name, number in wanted:
            Path(name).write_bytes(mutant(name, int(number), sound))
            answers.write(f"begin {name} {number}\n")
            answers.write(json.dumps(_answer(COMMANDS[name].split(), said)) + "\n")
            shutil.copy(sound_folder / name, name)
            for made in set(os.listdir()) - set(sound):
                shutil.rmtree(made) if os.path.isdir(made) else os.unlink(made)


def _answer(arguments: list[str], said: object) -> dict[str, object]:
    from horizonval import cli

    os.ftruncate(2, 0)
    os.lseek(2, 0, os.SEEK_SET)
    before, start = _memory_mb("VmRSS"), time.process_time()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    signal.alarm(60)
    try:
        status = cli.run_command_line(arguments)
    except BaseException:
        status = 70
        traceback.print_exc()
    signal.alarm(0)
    sys.stdout.flush()
    sys.stderr.flush()
    seconds = time.process_time() - start
    os.lseek(2, 0, os.SEEK_SET)
    output = os.read(2, 1 << 20).decode("utf-8", "replace")
    errors = "".join(line for line in output.splitlines(keepends=True) if _is_error(line, status))
    return {"status": status, "errors": errors, "seconds": seconds, "memory_mb": _memory_mb("VmHWM") - before}


def _is_error(line: str, status: int) -> bool:
    # Standard output shares the file: what a command that works prints is no error.
    return status == 2 or "Traceback" in line or line.startswith("horizonval:") or status == 70


def _memory_mb(key: str) -> float:
    status = Path("/proc/self/status").read_text()
    return float(re.search(rf"^{key}:\s+(\d+) kB", status, re.MULTILINE)[1]) / 1e3  # type: ignore[index]


def _limit_memory() -> None:
    import resource

    size = int(_memory_mb("VmSize") * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (size + 3 * 2**30, resource.RLIM_INFINITY))


if __name__ == "__main__":
    import horizonval.renderer  # noqa: F401  (names the LLVM library before anything imports Dr.Jit)

    _work(Path(sys.argv[1]).resolve())
