"""Odd values for every option of every verb: the right code, one clear message, nothing written (run as a script).

Arguments: folder, cases, seed, verbs. Each case is a fork of this process, which has no threads: one option of a line
that works gets a value that nobody expects.
"""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1") | {"OROGRAPH_COMPILE_AHEAD": "0"}

import click
from attacked import crop
from attacks import HARSH, files

from orograph.cli import VERBS, cli, main

ODD = [
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1e308", "1e-308", "1e400", "99999999999999999999", "-" + "9" * 20, "",
    " ", "٣", "Ω", "💥", "0x10", "1,5", "1_000", "+7", "None", "[]", "{}", "nowhere.tif", "/", ".", "/dev/null", "-",
    "--", "a" * 5000, "\udcff", "\n", "1:2", "2:1", "nan:nan", "1,2,3", "nan,nan", "0,0", "1e9,1e9", "inf,inf,inf",
    "1x1", "0x0", "99999x99999", "-5x5", "nanxnan", "auto", "none", "true", "%s%n", "$(date)", "*", "../..", "C:\\x",
    "file\x01name", "1/0", "3/2", "0/0", "-1/2", "1GiB", "-1GiB", "0B", "1e99GiB", "2026-13-45", "2026-02-30T25:61",
    "0001-01-01T00:00Z", "EPSG:0", "EPSG:4326", "EPSG:99999", "+proj=nonsense", "T+D+U+", "T9", "name=,=", "a=b=c",
    ",,,,", "roam,error=nan", "soar,nothing=1", "raycast", "180,90", "-181,91,1", "7.5,45.9,7.4,45.8", "179,0,-179,1",
    "NaN,1,2,3",
]  # fmt: skip
NUMBERS = ["nan", "inf", "-inf", "-1", "0", "-0.0", "1e308", "1e-308", "1e300", "1e9", "1e6", "0.001", "0.5", "2", "7",
           "1000", "99999999999999999999", "-1e9", "360", "-90", "90", "89.9999", "180", "1e-12"]  # fmt: skip
KEYED = {
    "--data": ("ridge.tif", "variable band time member value exceeds layer geometry style colormap range classes "
               "breaks height above size width opacity name unit"),
    "--drape": ("ridge.tif", "opacity blend colormap range band nodata visible name"),
    "--ghost": ("ridge.tif", "color opacity hidden name band vertical_unit"),
    "--uncertainty": ("ridge.tif", "variable band time member range style"),
    "--focus": ("lens", "at radius priority blend distance width"),
    "--detail": ("fractal", "seed exemplar"),
    "--method": ("soar", "error metric tolerance bins leaf order"), "--aids": ("poles", "metres grid"),
    "--for": ("soar", "error metric"), "--panel": ("ridge.tif", "name"),
}  # fmt: skip
"""Options that are a thing and keys with values: these get the odd values, too."""

CODES = {0, 2, 3, 4, 5, 6}


def lines(home: Path) -> dict[str, list[str]]:
    """Lines that work, by what stands before the options."""
    ridge = str(crop("lsd-topo/Mega_divide.tif", home / "ridge.tif", 700, 500, 60, 50))
    ground = str(home / "ground.oro")
    cli.main(args=["-q", "build", ridge, "-o", ground, "-j", "1"], standalone_mode=False)
    (home / "target.geojson").write_text('{"type": "Point", "coordinates": [0, 0]}')
    at = "{},{}".format(*middle(ridge))
    tiny = ["--size", "40x30"]
    return {
        "build": [ridge, "-o", "o.oro"], "render": [ridge, "-o", "o.png", *tiny], "info": [ridge],
        "bake": ["ground.oro", "--products", "visible-sky", "--azimuths", "4"],
        "light": [ridge, "--product", "slope", "-o", "o.tif"], "check": ["ground.oro"],
        "export": [ridge, "-o", "o.tif"], "manifest": [ridge, "-o", "o.manifest.geojsonl"],
        "movie": [ridge, "--orbit", "--seconds", "0.1", "--fps", "10", *tiny, "-o", "o.gif"],
        "tour new": [ridge, "--orbit", "-o", "o.json"], "tin": [ridge, "--max-error", "20", "-o", "o.ply"],
        "tessellate": [ridge, "-o", "o.npz", *tiny], "compare": [ridge, "--method", "soar", *tiny],
        "synth": ["--size", "40x30", "-o", "o.tif"], "best-view": [ridge, "--target", "target.geojson", "-o", "o.json"],
        "measure pick": [ridge, at], "measure profile": [ridge, at, at], "measure viewshed": [ridge, at, "-o", "o.tif"],
        "measure slope": [ridge, "--sigma", "2", "-o", "o.tif"],
        "measure flood": [ridge, "--level", "3000", "-o", "o.tif"],
        "measure contours": [ridge, "--sigma", "2", "-o", "o.tif"], "measure los": [ridge, at, at],
        "fetch": ["--bbox", "7.5,45.9,7.6,46.0", "-o", "o.tif", "--product", "copernicus-90"], "methods": [],
        "publish": ["ground.oro", "s3://nowhere/o.oro"], "doctor": [], "measure area": [ridge, "--bbox", "1,2,3,4"],
    }  # fmt: skip


def middle(path: str) -> tuple[float, float]:
    import rasterio

    with rasterio.open(path) as file:
        return file.xy(file.height // 2, file.width // 2)


def options_of(verb: str) -> list[click.Option]:
    command: click.Command = cli
    for name in verb.split():
        found = command.get_command(click.Context(command), name)  # type: ignore[attr-defined]
        assert found is not None
        command = found
    return [p for p in command.params if isinstance(p, click.Option) and not p.is_flag and p.name not in SPARED]


SPARED = {"workers", "dask"}
"""What would start other processes."""


def case(home: Path, line: list[str], number: int) -> tuple[int, str, float]:
    """Run a line in a fork; its code, what it said and how long it took."""
    folder = home / f"case{number}"
    (folder / "tmp").mkdir(parents=True)
    pid = os.fork()
    if pid == 0:
        with contextlib.suppress(BaseException):
            os.chdir(folder)
            Path("target.geojson").symlink_to(home / "target.geojson")
            shutil.copytree(home / "ground.oro", "ground.oro")
            said = os.open(home / f"said{number}", os.O_CREAT | os.O_WRONLY)
            os.dup2(said, 1)
            os.dup2(said, 2)
            os.environ.update(TMPDIR=str(folder / "tmp"), OROGRAPH_CACHE=str(folder / "cache"))
            tempfile.tempdir = None
            resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 29, 1 << 29))
            resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))
            sys.argv = ["orograph", "-q", *line]
            try:
                main()
            except SystemExit as stop:
                sys.stdout.flush()
                os._exit(stop.code if isinstance(stop.code, int) else 1)
            os._exit(98)
        os._exit(99)
    began = time.monotonic()
    done, status = 0, 0
    while not done and time.monotonic() - began < LIMIT:
        done, status = os.waitpid(pid, os.WNOHANG)
        time.sleep(0.002)
    if not done:
        os.kill(pid, signal.SIGKILL)
        status = os.waitpid(pid, 0)[1]
    code = os.waitstatus_to_exitcode(status) if done else 97
    text = (home / f"said{number}").read_text(errors="replace")
    (home / f"said{number}").unlink()
    return code, text.strip(), time.monotonic() - began


LIMIT = 40.0


def odd(option: click.Option, rng: random.Random, home: Path) -> str:
    """A value that nobody expects of an option; of the kind that gets past its first check, where there is one."""
    keyed = KEYED.get(max(option.opts, key=len))
    if keyed is not None and rng.random() < 0.8:
        what, keys = keyed
        what = str(home / what) if "." in what else what
        return f"{what},{rng.choice(keys.split())}={rng.choice(ODD + NUMBERS)}"
    numeric = isinstance(option.type, click.types.FloatParamType | click.types.IntParamType)
    return rng.choice(NUMBERS if numeric and rng.random() < 0.8 else ODD)


def attack(home: Path, cases: int, seed: int, chosen: list[str]) -> int:
    rng = random.Random(seed)
    known = {verb: line for verb, line in lines(home).items() if not chosen or verb in chosen}
    places = [(verb, option) for verb in known for option in options_of(verb)]
    os.environ["AWS_ENDPOINT_URL"] = "http://127.0.0.1:9"
    table = home / "table.toml"
    table.write_text('[copernicus-90]\nbase = "http://127.0.0.1:9/x"\n')
    os.environ["OROGRAPH_PRODUCTS"] = str(table)
    codes, found, slow = Counter[int](), [], []
    for number in range(cases):
        verb, option = rng.choice(places)
        value = odd(option, rng, home)
        line = [*verb.split(), *known[verb]]
        name = max(option.opts, key=len)
        for own in option.opts:  # in place of the value that works
            if own in line:
                del line[line.index(own) : line.index(own) + 2]
        line = [*line, name, value] if rng.random() < 0.5 else [*line, f"{name}={value}"]
        line = [part.replace("\0", "") for part in line]
        before = files(home / "ground.oro")
        code, said, seconds = case(home, line, number)
        codes[code] += 1
        shown = " ".join(part if len(part) < 60 else part[:20] + "…" for part in line).encode("unicode_escape").decode()
        folder = home / f"case{number}"
        results = [p.name for p in folder.iterdir() if p.name not in ("tmp", "cache", "target.geojson", "ground.oro")]
        if HARSH.search(said) or code not in CODES:
            found.append(f"rc {code}: {shown}\n      {said[-700:]}")
        elif code and not re.search(r"(?i)error|orograph: |usage", said):
            found.append(f"rc {code} and silent: {shown}\n      {said[-300:]}")
        elif code and any(name.startswith("o") or ".part" in name for name in results):
            found.append(f"rc {code} and something written: {results}: {shown}\n      {said[-300:]}")
        elif code and verb != "bake" and files(folder / "ground.oro") != before:
            found.append(f"rc {code}, and the store is another: {shown}")
        elif code == 0 and re.search(r"nan|np\.float", said) and verb not in ("info", "methods"):
            found.append(f"rc 0 and nan: {shown}\n      {said[-300:]}")
        if seconds > 12:
            slow.append(f"{seconds:.0f} s: rc {code}: {shown}")
        if os.environ.get("TELL"):
            print(code, shown, "→", said[-200:].replace("\n", " | "), flush=True)
        shutil.rmtree(folder)
    print(cases, "cases", dict(codes), flush=True)
    for text in [*slow, *found]:
        print("!!", text, flush=True)
    return len(found)


if __name__ == "__main__":
    where = Path(sys.argv[1]).resolve()
    where.mkdir(parents=True)
    unknown = [verb for verb in VERBS if verb not in ("view", "demo")]
    for verb in unknown:
        with contextlib.suppress(Exception):
            cli.get_command(click.Context(cli), verb)
    sys.exit(bool(attack(where, int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])))
