"""``orograph movie`` and ``orograph tour`` as people use them: files in, films out, and nothing broken when stopped."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

from orograph.errors import OrographError
from orograph.touring.encode import BT709, LIMITED

av = pytest.importorskip("av")

SMALL = ("--size", "160x90", "--quiet")
SPIN = ("--orbit", "--seconds", "2", "--fps", "4")


@pytest.fixture
def tour(run, hilly, tmp_path):
    """A tour of two keys, with a sun that moves."""
    path = tmp_path / "tour.json"
    code, _, err = run("tour", "new", hilly, "--orbit", "-o", path, "--size", "160x90")
    assert code == 0, err
    values = json.loads(path.read_text())
    key = {k: v for k, v in values["keys"][0].items() if k not in ("time", "path", "turns")}
    eye = key["eye"]
    path.write_text(json.dumps({"fps": 5, "keys": [
        {**key, "time": 0, "sun": [300, 30], "exaggeration": 1},
        {**key, "time": 1, "eye": [eye[0] + 300, eye[1], eye[2]], "sun": [330, 40], "exaggeration": 2}]}))  # fmt: skip
    return path


def frames_of(path):
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        return stream, [(f.time, f.to_ndarray(format="rgb24")) for f in file.decode(stream)]


@pytest.mark.cases(1)
@pytest.mark.parametrize(("ending", "codec", "near"), [("mp4", "h264", 4.0), ("webm", "vp9", 5.0), ("gif", "gif", 12)])
def test_a_film_shows_the_frames(run, hilly, tmp_path, ending, codec, near):
    """What is decoded is what is drawn, in colour too: a wrong matrix, or range, differs by much more on the greens."""
    out = tmp_path / f"orbit.{ending}"
    code, said, err = run("movie", hilly, *SPIN, "-o", out, *SMALL, "--json")
    assert code == 0, err
    assert json.loads(said)["frames"] == json.loads(said)["drawn"] == 8
    code, _, _ = run("movie", hilly, *SPIN, "-o", tmp_path / "f" / "%03d.png", *SMALL)
    assert code == 0
    stream, frames = frames_of(out)
    assert stream.codec_context.name == codec and len(frames) == 8
    assert [round(t, 3) for t, _ in frames] == [0.25 * k for k in range(8)]
    if ending != "gif":
        context = stream.codec_context
        assert context.pix_fmt == "yuv420p" and context.color_range == LIMITED
        assert context.colorspace == context.color_primaries == context.color_trc == BT709
    for k, (_, frame) in enumerate(frames):
        drawn = np.asarray(Image.open(tmp_path / "f" / f"{k:03d}.png")).astype(int)
        assert np.abs(frame - drawn).mean() < near
        inner = np.abs(frame.astype(int).mean((0, 1)) - drawn.mean((0, 1)))
        assert inner.max() < (3 if ending == "gif" else 1.5)
    assert not [f for f in tmp_path.iterdir() if f.name.startswith(".")]


def test_frames_are_what_render_draws(run, hilly, tour, tmp_path):
    code, _, err = run("movie", hilly, "--tour", tour, "-o", tmp_path / "f" / "%d.png", "--quiet", "--relief", "1")
    assert code == 0, err
    assert sorted(f.name for f in (tmp_path / "f").glob("*.png")) == [f"{k}.png" for k in range(5)]
    key = json.loads(tour.read_text())["keys"][0]
    view = tmp_path / "view.json"
    view.write_text(json.dumps({k: v for k, v in key.items() if k not in ("time", "sun", "exaggeration")}))
    code, _, err = run("render", hilly, "--view", view, "-o", tmp_path / "a.png", "--sun", "300,30", "--relief", "1")
    assert code == 0, err
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), np.asarray(Image.open(tmp_path / "f" / "0.png")))


@pytest.mark.stress
def test_frames_are_taken_up_where_they_stopped(run, hilly, tour, tmp_path):
    out = tmp_path / "f" / "%03d.png"
    whole = ("movie", hilly, "--tour", tour, "-o", out, "--quiet", "--sky")
    assert run(*whole)[0] == 0
    first = {f.name: f.read_bytes() for f in (tmp_path / "f").glob("*.png")}
    for name in ("001.png", "004.png"):
        (tmp_path / "f" / name).unlink()
    code, said, _ = run(*whole, "--json")
    assert code == 0 and json.loads(said)["drawn"] == 2 and json.loads(said)["frames"] == 5
    assert {f.name: f.read_bytes() for f in (tmp_path / "f").glob("*.png")} == first
    # A part of the film is those frames of the whole.
    assert run(*whole[:5], tmp_path / "g" / "%03d.png", *whole[6:], "--from", "0.4", "--to", "0.8")[0] == 0
    part = {f.name: f.read_bytes() for f in (tmp_path / "g").glob("*.png")}
    assert part == {name: first[name] for name in ("002.png", "003.png")}
    # Frames of another film are never mixed with these.
    code, _, err = run(*whole, "--exaggeration", "3")
    assert code == 2 and "another film" in err
    assert {f.name: f.read_bytes() for f in (tmp_path / "f").glob("*.png")} == first
    assert run(*whole, "--exaggeration", "3", "--overwrite")[0] == 0
    assert (tmp_path / "f" / "001.png").read_bytes() != first["001.png"]


def test_what_is_said_beside_the_tour_holds(run, hilly, tour, tmp_path):
    def film(name, *more):
        code, _, err = run("movie", hilly, "--tour", tour, "-o", tmp_path / name / "%d.png", "--quiet", *more)
        assert code == 0, err
        return np.asarray(Image.open(tmp_path / name / "4.png")).astype(int)

    own, given = film("own"), film("given", "--sun", "90,10", "--exaggeration", "1")
    assert np.abs(own - given).mean() > 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-o", "a.mp4", "--tour", "t.json", "--orbit"), "Give a tour or describe one"),
        (("-o", "a.mp4", "--tour", "t.json", "--seconds", "2"), "--seconds does not apply to a tour that is given"),
        (("-o", "a.mp4", "--orbit", "--turntable"), "two tours"),
        (("-o", "a.mp4", "--orbit", "--height", "5"), "--height does not apply"),
        (("-o", "a.avi", "--orbit"), ".avi"),
        (("-o", "a.mp4", "--orbit", "--size", "161x90"), "162x90"),
        (("-o", "a.gif", "--orbit", "--crf", "20"), "--crf"),
        (("-o", "%d-%d.png", "--orbit"), "one number"),
        (("-o", "a.mp4", "--orbit", "--from", "20"), "no frame"),
        (("-o", "a.mp4", "--orbit", "--wireframe"), "--method"),
        (("-o", "a.mp4", "--point", "-117,36"), "two points"),
        (("-o", "a.mp4", "--orbit", "--seconds", "-1"), "seconds"),
        (("-o", "no/a.mp4", "--orbit"), "no folder"),
        (("-o", "a.mp4", "--around", "-117,36,500", "--distance", "900"), "--around and --distance say the same"),
        (("-o", "a.mp4", "--around", "-117,36", "--line", "a.gpx"), "--around does not apply to --line"),
        (("-o", "a.mp4", "--around", "-117,89"), "km beyond the terrain's north"),
        (("-o", "a.mp4", "--around", "-117"), "LON,LAT,RADIUS"),
    ],
)
def test_wrong_options(run, hilly, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    code, said, err = run("movie", hilly, *options)
    assert code in (2, 4) and said == "" and words in err and "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_nothing_overwrites_what_it_is_made_of(run, hilly, tour):
    before = tour.read_text()
    code, _, err = run("tour", "new", hilly, "--orbit", "-o", hilly)
    assert code == 2 and "overwrite" in err
    code, _, err = run("movie", hilly, "--tour", tour, "-o", tour)
    assert code == 2 and tour.read_text() == before


def test_a_tour_that_leaves_the_terrain_is_said(run, hilly, tmp_path):
    path = tmp_path / "away.json"
    path.write_text(json.dumps({"keys": [
        {"time": 0, "eye": [9e5, 4e6, 900], "target": [9.1e5, 4e6, 900]},
        {"time": 1, "eye": [9e5, 4e6, 950], "target": [9.1e5, 4e6, 900]}]}))  # fmt: skip
    code, _, err = run("movie", hilly, "--tour", path, "-o", tmp_path / "a.mp4", *SMALL)
    assert code == 5 and "in view" in err and not (tmp_path / "a.mp4").exists()


def test_tours_are_made_and_told(run, hilly, tmp_path):
    line = tmp_path / "line.geojson"
    line.write_text(json.dumps({"type": "LineString", "coordinates": [[500_300, 3_999_700], [501_800, 3_998_000]]}))
    path = tmp_path / "t.json"
    code, said, err = run(
        "tour", "new", hilly, "--line", line, "--line-crs", "EPSG:32611", "--seconds", "9", "-o", path
    )
    assert code == 0 and "key frame" in said, err
    code, said, _ = run("tour", "info", path)
    assert code == 0 and "1280 × 720" in said and "spline" in said
    code, said, _ = run("tour", "info", path, "--json")
    assert code == 0 and json.loads(said)["duration"] == pytest.approx(9)
    code, _, err = run("tour", hilly, "-o", path)
    assert code == 2 and "orograph tour new DEM -o TOUR.json" in err
    for name, kind in (("a.json", []), ("b.json", ["--orbit"])):
        code, _, err = run("tour", "new", hilly, *kind, "-o", tmp_path / name)
        assert code == 0, err
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_tour_in_degrees_is_told_in_the_terrains_crs(run, tmp_path):
    path = tmp_path / "t.json"
    path.write_text(json.dumps({"crs": "EPSG:4326", "keys": [
        {"time": 0, "eye": [-117, 36, 900], "target": [-117, 36.1, 900]},
        {"time": 2, "target": [-117, 36.1, 900], "azimuth": 200, "pitch": 20, "distance": 5000}]}))  # fmt: skip
    code, _, err = run("tour", "info", path)
    assert code == 2 and "--crs" in err and "EPSG:4326" in err and "--assume-crs" not in err
    code, said, err = run("tour", "info", path, "--crs", "EPSG:32611")
    assert code == 0 and "2.00 s" in said and "eye (500000, 3983948" in said, err


@pytest.mark.stress
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("name", ["a.mp4", "f/%03d.png"])
def test_ctrl_c(hilly, tmp_path, name):
    out = tmp_path / name
    if name == "a.mp4":
        out.write_bytes(b"what was there")
    # Thousands of small frames: the encoder makes its file once it has seen some dozens.
    line = [sys.executable, "-m", "orograph", "movie", hilly, "--orbit", "--seconds", "300", "-o", out, "--size",
            "96x54", "--samples", "1", "--relief", "1"]  # fmt: skip
    child = subprocess.Popen(list(map(str, line)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    waiting = time.monotonic() + 240
    begun = tmp_path.glob if name == "a.mp4" else (tmp_path / "f").glob
    while not list(begun(".a.mp4*" if name == "a.mp4" else "001.png")):
        assert child.poll() is None and time.monotonic() < waiting, child.communicate()[1]
        time.sleep(0.1)
    time.sleep(0.3)
    child.send_signal(signal.SIGINT)
    said, err = child.communicate(timeout=60)
    assert child.returncode == 130 and "interrupted" in err and said == "" and "Traceback" not in err
    assert "stopped after" in err
    if name == "a.mp4":
        assert out.read_bytes() == b"what was there" and [f.name for f in tmp_path.iterdir()] == ["a.mp4"]
        assert "%05d.png" in err
        return
    frames = [f for f in (tmp_path / "f").iterdir() if f.suffix == ".png"]
    assert len(frames) > 1 and not [f for f in (tmp_path / "f").iterdir() if ".part" in f.name]
    for frame in frames:
        with Image.open(frame) as image:
            image.load()


@pytest.mark.parametrize("ending", ["mp4", "webm", "gif", "mkv"])
def test_a_video_on_a_full_disk_is_whole_or_not_there(tmp_path, small_disk, ending):
    from orograph.errors import OutputError
    from orograph.touring.encode import Video

    def write(path):
        with Video(path, (64, 48), 4) as video:
            for number, pixels in enumerate(noise):
                video.add(number, pixels)

    noise = np.random.default_rng(1).integers(0, 255, (8, 48, 64, 3)).astype(np.uint8)
    whole = tmp_path / f"whole.{ending}"
    write(whole)
    size, frames, written = whole.stat().st_size, frames_of(whole)[1], 0
    for kib in (4, size // 2048, *range(size // 1024 - 7, size // 1024 + 12, 2)):
        out = small_disk(kib) / f"out.{ending}"
        try:
            write(out)
        except OutputError as error:
            assert "No space left" in str(error) and out.name in str(error)
            assert not list(out.parent.iterdir())
        else:
            written += 1
            for (at, pixels), (then, drawn) in zip(frames_of(out)[1], frames, strict=True):  # encoders of threads vary
                assert at == then and np.abs(pixels.astype(int) - drawn).mean() < 10
    assert 0 < written < 10


@pytest.mark.stress
def test_frames_that_a_full_disk_cuts_off_are_taken_up_or_not_there(run, hilly, small_disk, tmp_path):
    disk = small_disk(40)
    code, _, err = run("movie", hilly, *SPIN, "-o", disk / "%03d.png", *SMALL)
    assert code == 4 and "No space left" in err, err
    kept = {f.name: f.stat().st_mtime_ns for f in disk.glob("*.png")}
    assert 0 < len(kept) < 8
    assert sorted(f.name for f in disk.iterdir()) == sorted([*kept, ".N.png.film"])
    subprocess.run(["mount", "-o", "remount,size=1m", disk], check=True)
    code, _, err = run("movie", hilly, *SPIN, "-o", disk / "%03d.png", *SMALL)
    assert code == 0, err
    assert all((disk / name).stat().st_mtime_ns == time for name, time in kept.items())
    assert len(list(disk.glob("*.png"))) == 8
    for kib in (4, 8):
        disk = small_disk(kib)
        code, _, err = run("movie", hilly, *SPIN, "-o", disk / "new" / "of" / "%03d.png", *SMALL)
        assert code == 4 and "No space left" in err, err
        assert not list(disk.iterdir())


@pytest.mark.stress
def test_a_film_in_parts(run, hilly, tmp_path):
    said = ("movie", hilly, *SPIN, "-o", tmp_path / "f" / "%03d.png", *SMALL)
    assert run("movie", hilly, *SPIN, "-o", tmp_path / "whole" / "%03d.png", *SMALL)[0] == 0
    code, out, err = run(*said, "--part", "2/3")
    assert code == 0 and "part 2/3 is drawn" in out, err
    code, _, err = run(*said, "--finish")
    assert code == 4 and "Parts 1, 3 of 3 are missing" in err
    for part in ("3/3", "1/3"):
        assert run(*said, "--part", part)[0] == 0
    code, out, err = run(*said, "--finish")
    assert code == 0 and "8 frames" in out, err
    names = [f"{k:03d}.png" for k in range(8)]
    assert all((tmp_path / "f" / n).read_bytes() == (tmp_path / "whole" / n).read_bytes() for n in names)
    code, _, err = run(*said, "--part", "4/3")
    assert code == 2 and "I/N" in err
    code, _, err = run(*said, "--part", "1/3", "--workers", 2)
    assert code == 2 and "exclude" in err


DAY = "2026-10-15T06:30-07:00..18:00"


def test_the_sun_of_a_day_without_a_tour_file(run, hilly, tmp_path):
    """Still, along a line and in a tour; frames differ and are those of the moments; in Python the same."""
    import orograph

    few = ("--size", "120x80", "--seconds", 2, "--fps", 2, "--quiet")
    code, _, err = run("movie", hilly, "--still", "--sun", DAY, *few, "-o", tmp_path / "a" / "%d.png")
    assert code == 0, err
    pictures = [np.asarray(Image.open(tmp_path / "a" / f"{k}.png")).astype(int) for k in range(4)]
    assert np.abs(pictures[1] - pictures[3]).mean() > 3
    tour = {"seconds": 2, "fps": 2, "keys": [{"time": 0}]}
    (tmp_path / "t.json").write_text(json.dumps({**tour, "ease": False}))
    of_file = ("--tour", tmp_path / "t.json", "--size", "120x80", "--quiet")
    assert run("movie", hilly, *of_file, "--sun", DAY, "-o", tmp_path / "b" / "%d.png")[0] == 0
    options = {"size": (120, 80), "progress": False}
    orograph.movie(hilly, tmp_path / "c" / "%d.png", still=True, sun=DAY, seconds=2, fps=2, **options)
    orograph.movie(hilly, tmp_path / "d" / "%d.png", {**tour, "sun": DAY}, **options)
    # One frame is the picture of its moment: frame 2 of 4 lies in the middle of the day.
    orograph.movie(hilly, tmp_path / "e" / "%d.png", tour, sun="2026-10-15T12:15-07:00", **options)
    for folder, number in (("b", 2), ("c", 2), ("d", 2), ("e", 2), ("b", 3), ("c", 0), ("d", 1)):
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / folder / f"{number}.png")), pictures[number])


def test_a_moving_sun_where_there_is_none(run, hilly, tmp_path):
    code, _, err = run("render", hilly, "--sun", DAY, "-o", tmp_path / "a.png")
    assert code == 2 and "orograph movie" in err
    code, _, err = run("movie", hilly, "--turntable", "--sun", DAY, "-o", tmp_path / "a.mp4")
    assert code == 2 and "turntable" in err
    code, _, err = run("movie", hilly, "--still", "--sun", "2026-10-15T18:00Z..06:00", "-o", tmp_path / "a.mp4")
    assert code == 2 and "not after its beginning" in err


def test_a_line_as_geojson_in_python(hilly, tmp_path):
    import orograph

    terrain = orograph.terrain(hilly)
    west, south, east, north = terrain.grid.bounds()
    y = (south + north) / 2
    line = [(west + 0.2 * (east - west), y), (west + 0.8 * (east - west), y)]
    crs = terrain.grid.crs
    plain = orograph.tour(terrain, line=line, line_crs=crs)
    geojson = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": line}}
    assert orograph.tour(terrain, line=geojson, line_crs=crs) == plain
    with pytest.raises(OrographError, match="no line in this GeoJSON"):
        orograph.tour(terrain, line={"type": "Point", "coordinates": [1, 2]})
