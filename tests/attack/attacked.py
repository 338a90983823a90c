"""The verbs that write, on crops of real data (run as a script: folder, trials, seed, kinds, verbs)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1") | {"OROGRAPH_COMPILE_AHEAD": "0"}

import rasterio
from attacks import KINDS, Files, Verb, attack
from rasterio.windows import Window

DATA = Path(os.environ.get("OROGRAPH_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


COLD = {"viewshed", "flood", "demo", "publish", "fetch", "fetch-store"}
"""What GDAL starts threads for, which no fork would have."""


def crop(source: str, out: Path, col: int, row: int, width: int, height: int, add: float = 0) -> Path:
    """A part of a raster, as a file of its own."""
    window = Window(col, row, width, height)
    with rasterio.open(DATA / source) as file:
        heights = file.read(1, window=window)
        with rasterio.open(
            out, "w", "GTiff", width, height, 1, file.crs, file.window_transform(window), heights.dtype,
            nodata=file.nodata,
        ) as made:  # fmt: skip
            made.write(heights + heights.dtype.type(add), 1)
    return out


SERVER = """
import sys, time
sys.path.insert(0, {store!r})
from buckets import bucket_server
with bucket_server() as server:
    print(server.url, flush=True)
    sys.stdin.read()
"""


def bucket(home: Path) -> str:
    """A server of S3, a process of its own that ends with this one; its address."""
    code = SERVER.format(store=str(Path(__file__).parents[1] / "store"))
    server = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    url = server.stdout.readline().strip()
    SERVERS.append(server)
    os.environ |= {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_ENDPOINT_URL": url,
    }
    return url


SERVERS: list[object] = []


def asked(url: str, method: str = "GET") -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, method=method), timeout=20) as answer:
        return bytes(answer.read())


def emptied(url: str) -> None:
    asked(f"{url}/moto-api/reset", "POST")
    asked(f"{url}/terrain", "PUT")


def objects(url: str) -> Files:
    """What the bucket holds of the store, but for its lock."""
    code = (
        "import boto3, json, hashlib\nbucket = boto3.resource('s3', region_name='us-east-1').Bucket('terrain')\n"
        "print(json.dumps({o.key: hashlib.sha256(o.get()['Body'].read()).hexdigest() "
        "for o in bucket.objects.all() if 'lock' not in o.key}))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return {key.removeprefix("out.oro/"): digest.encode() for key, digest in json.loads(told).items()}


def served(home: Path) -> Path:
    """A server of two tiles as Copernicus has them; a table that names it."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "fetching"))
    from sources import copernicus, heights
    from tileserver import tiles

    server = tiles(home / "served")
    site = server.__enter__()
    SERVERS.append(server)
    for name in ("N38W121", "N38W120"):
        path, data = copernicus(name, heights(DATA, name)[:1200, :1200])
        site.files[f"copernicus-90/{path}"] = data
    table = home / "table.toml"
    table.write_text(f'[copernicus-90]\nbase = "{site.url}/copernicus-90"\n')
    return table


def verbs(home: Path) -> list[Verb]:
    lidar = crop("lsd-topo/gabilan.tif", home / "gabilan.tif", 100, 100, 700, 600)
    ridge = crop("lsd-topo/Mega_divide.tif", home / "ridge.tif", 360, 840, 180, 150)
    degrees = crop("california-3s-tiles/N39W121.tif", home / "degrees.tif", 300, 400, 260, 230)
    tiles = [crop("lsd-topo/gabilan.tif", home / f"tile{i}{j}.tif", 100 + 350 * i, 100 + 300 * j, 350, 300)
             for i in range(2) for j in range(2)]  # fmt: skip
    table = home / "points.csv"
    with rasterio.open(ridge) as file:
        heights = file.read(1)
        places = [(r, c) for r in range(0, 150, 4) for c in range(0, 180, 4) if heights[r, c] > -9000]
        lines = ["{},{},{}".format(*file.xy(r, c), heights[r, c]) for r, c in places]
    table.write_text("x,y,z\n" + "\n".join(lines) + "\n")
    drape = home / "drape.tif"
    shutil.copy(crop("lsd-topo/gabilan.tif", home / "part.tif", 100, 100, 350, 300), drape)

    def store(name: str, *line: str) -> Path:
        at = home / name
        run(["build", *line, "-o", str(at), "-j", "1"])
        return at

    small = ["--max-memory", "200MiB"]
    ground = store("ground.oro", str(lidar), *small, "--errors", "none")
    again = store("again.oro", *map(str, tiles), *small, "--update")
    crop("lsd-topo/gabilan.tif", tiles[3], 450, 400, 350, 300, add=2)  # changed since
    tour = home / "tour.json"
    run(["tour", "new", str(ridge), "--orbit", "--seconds", "1", "-o", str(tour)])
    target = home / "target.geojson"
    target.write_text(json.dumps({"type": "Point", "coordinates": list(middle(ridge))}))
    damaged = home / "damaged.oro"
    shutil.copytree(ground, damaged)
    for shard in (damaged / "heights").rglob("c/0/0"):
        data = bytearray(shard.read_bytes())
        data[len(data) // 3] ^= 4
        shard.write_bytes(data)

    def have(source: Path) -> object:
        return lambda folder: shutil.copytree(source, folder / "out.oro")

    out, place = ["-o", "out.oro"], "{},{}".format(*centre(ridge))
    url, table_of = bucket(home), str(served(home))
    fetch = ["fetch", "--bbox", "-120.3,38.3,-119.8,38.6", "--product", "copernicus-90", "--table", table_of, "-o"]
    film = ["movie", str(ridge), "--orbit", "--seconds", "0.5", "--fps", "12", "--size", "160x96"]
    return [
        Verb("build", ["build", str(lidar), *out, *small]),
        Verb("build-degrees", ["build", str(degrees), *out, *small, "--max-error", "0.1", "--codec", "compact"]),
        Verb("build-points", ["build", str(table), *out, *small, "--resolution", "60"]),
        Verb("build-overwrite", ["build", str(lidar), *out, *small, "--overwrite"], have(again)),
        Verb("build-bake", ["build", str(ridge), *out, *small, "--bake", "sky-view-factor"], in_place=True),
        Verb("update", ["build", *map(str, tiles), *out, *small, "--update"], have(again)),
        Verb("update-new", ["build", *map(str, tiles), *out, *small, "--update"]),
        Verb("repair", ["build", *out, "--repair"], have(damaged), in_place=True),
        Verb("colors", ["build", *out, str(lidar), "--color-errors", "--drape", str(drape), *small], in_place=True),
        Verb(
            "bake",
            ["bake", "out.oro", "--products", "sky-view-factor,aperture", "--azimuths", "8"],
            have(ground),
            in_place=True,
        ),
        Verb(
            "light",
            ["light", str(lidar), "--product", "slope,sky-view-factor,shadow", "--azimuths", "16", "-o", "l.tif"],
        ),
        Verb(
            "light-store",
            [
                "light",
                str(lidar),
                "--product",
                "sky-view-factor",
                "--azimuths",
                "8",
                "-o",
                "l.tif",
                "--max-memory",
                "120MiB",
            ],
        ),
        Verb(
            "light-resume", ["light", str(ground), "--product", "openness,sky-view-factor", "-o", "l.tif", "--resume"]
        ),
        Verb("movie", [*film, "-o", "film.mp4"]),
        Verb("movie-gif", [*film, "-o", "film.gif"]),
        Verb("movie-frames", [*film, "-o", "frames/%03d.png"]),
        Verb("tin", ["tin", str(ridge), "--max-error", "3", "-o", "t.glb"]),
        Verb("tin-ply", ["tin", str(lidar), "--max-error", "1", "-o", "t.ply"]),
        Verb("tessellate", ["tessellate", str(ridge), "-o", "t.glb", "--tolerance", "0.3"]),
        Verb("tessellate-obj", ["tessellate", str(lidar), "-o", "t.obj"]),
        Verb("export", ["export", str(ground), "-o", "e.tif"]),
        Verb("export-data", ["export", str(ridge), "-o", "e.nc", "--data", str(ridge)]),
        Verb("manifest", ["manifest", *map(str, tiles), str(lidar), "-o", "a.manifest.geojsonl"]),
        Verb("synth", ["synth", "--size", "500x400", "-o", "s.tif"]),
        Verb("synth-example", ["synth", "--exemplar", str(ridge), "--size", "200x150", "-o", "s.tif"]),
        Verb("render", ["render", str(ridge), "-o", "r.png", "--size", "300x200", "--furniture"]),
        Verb(
            "render-large",
            ["render", str(lidar), "-o", "r.png", "--size", "2600x2000", "--max-memory", "250MiB", "--samples", "1"],
        ),
        Verb("render-tif", ["render", str(lidar), "-o", "r.tif", "--projection", "plan", "--size", "1500x1200"]),
        Verb("compare", ["compare", str(ridge), "--method", "roam", "--size", "200x100", "--picture", "c.png"]),
        Verb("tour", ["tour", "new", str(ridge), "--orbit", "-o", "t.json"]),
        Verb(
            "best-view",
            [
                "best-view",
                str(ridge),
                "--target",
                str(target),
                "-o",
                "v.json",
                "--azimuths",
                "8",
                "--pieces",
                "50",
                "--size",
                "120x80",
            ],
        ),
        Verb(
            "viewshed",
            ["measure", "viewshed", str(ridge), place, "-o", "v.tif", "--picture", "v.png", "--size", "200x100"],
        ),
        Verb("flood", ["measure", "flood", str(ridge), "--level", "3000", "-o", "f.tif"]),
        Verb(
            "publish",
            ["publish", str(ground), "s3://terrain/out.oro"],
            lambda folder: emptied(url),
            results=lambda folder: objects(url),
        ),
        Verb("fetch", [*fetch, "f.tif"]),
        Verb("demo", ["demo", "-o", "shown"]),
    ]


def centre(path: Path) -> tuple[float, float]:
    with rasterio.open(path) as file:
        return file.xy(file.height // 2, file.width // 2)


def middle(path: Path) -> tuple[float, float]:
    from pyproj import Transformer

    with rasterio.open(path) as file:
        return Transformer.from_crs(file.crs, 4326, always_xy=True).transform(*centre(path))


def run(line: list[str]) -> None:
    from orograph.cli import cli

    cli.main(args=["-q", *line], standalone_mode=False)


def warm(listed: list[Verb], home: Path) -> None:
    """Compile everything here, by one thread: forks are safe only of a process that has one."""
    import click

    from orograph.cli import cli

    here = Path.cwd()
    for verb in listed:
        if verb.name in COLD:
            continue
        folder = home / "warm" / verb.name
        folder.mkdir(parents=True)
        verb.given(folder)
        os.chdir(folder)
        command = cli.get_command(click.Context(cli), verb.line[0])
        line = list(verb.line)
        if "-j" in line:
            line[line.index("-j") + 1] = "1"
        elif any("-j" in p.opts for p in command.params):
            line += ["-j", "1"]
        try:
            run(line)
        except BaseException as error:
            print(f"{verb.name}: {type(error).__name__}: {error}", flush=True)
        os.chdir(here)
        shutil.rmtree(folder)
        threads = [task.name for task in Path("/proc/self/task").iterdir()]
        if len(threads) > 1:
            print(verb.name, "left threads", threads, flush=True)


if __name__ == "__main__":
    where, trials, seed = Path(sys.argv[1]).resolve(), int(sys.argv[2]), int(sys.argv[3])
    kinds = tuple(sys.argv[4].split(",")) if len(sys.argv) > 4 and sys.argv[4] else KINDS
    chosen = sys.argv[5].split(",") if len(sys.argv) > 5 else []
    where.mkdir(parents=True)
    os.environ["OROGRAPH_CACHE"] = str(where / "cache")
    listed = [verb for verb in verbs(where) if not chosen or verb.name in chosen]
    warm(listed, where)
    total, found = attack(listed, where, trials, seed, kinds, lambda text: print(text, flush=True))
    print("total", dict(total))
    print(len(found), "broken")
    sys.exit(bool(found))
