"""Servers that are busy, slow, cut short or gone: what is tried again, what is said, what is kept for the next run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sources import copernicus

import orograph
from orograph.dem import read
from orograph.errors import OutputError, ReadError
from orograph.fetching import asking, cached, register
from orograph.store.kept import entries, make_room

BOX = (-119.3, 36.8, -118.6, 37.25)


def kept_files():
    return sorted(cached.tiles_folder().rglob("*.tif"))


@pytest.fixture
def truth(california):
    dem = orograph.fetch(BOX, "copernicus-90")
    for file in sorted(cached.tiles_folder().rglob("*"), reverse=True):
        file.unlink() if file.is_file() else file.rmdir()
    california.set()
    return dem.heights


@pytest.mark.cases(3)
@pytest.mark.parametrize("fault", ["429", "503", "drop", "cut", "slow"])
def test_what_passes_is_tried_again(california, truth, fault):
    california.set(faults=[fault] * 3)
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)


@pytest.mark.cases(1)
@pytest.mark.parametrize("fault", ["503", "cut", "drop"])
def test_reads_that_fail_now_and_then_are_made_again(california, truth, fault):
    california.set(faults=[fault, "", fault, "", "", fault], only_reads=True)
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)


def tile(web, name="N37_00_W119"):
    return next(path for path in web.files if name in path)


@pytest.mark.parametrize(
    ("fault", "said"),
    [("503", "the server answers 503"), ("403", "the server answers 403"), ("drop", "there is no connection")],
)
def test_what_does_not_pass_is_told_with_product_tile_address_cause_and_remedy(california, fault, said):
    california.set(always={tile(california): fault})
    with pytest.raises(ReadError, match=rf"copernicus-90, tile N37W119: {said}") as told:
        orograph.fetch(BOX, "copernicus-90")
    assert told.value.path == f"{california.url}/{tile(california)}"
    assert told.value.remedy


def test_bodies_that_are_always_cut_are_told_and_nothing_of_them_is_kept(california):
    california.set(always={tile(california): "cut"}, only_reads=True)
    with pytest.raises(ReadError, match=r"tile N37W119: it (cannot be opened|repeatedly cannot be read)"):
        orograph.fetch(BOX, "copernicus-90")
    assert not [file for file in kept_files() if file.parent.name == "N37W119"]


def test_a_server_that_is_not_there(web):
    register("copernicus-90", base="http://127.0.0.1:9")
    with pytest.raises(ReadError, match="there is no connection"):
        orograph.fetch(BOX, "copernicus-90")


def test_passwords_in_addresses_are_not_told(california):
    register("copernicus-90", base=california.url.replace("//", "//someone:secret@") + "/copernicus-90")
    orograph.fetch((-118.6, 36.1, -118.5, 36.2), "copernicus-90")
    assert california.authorizations == {"Basic c29tZW9uZTpzZWNyZXQ="}
    california.set(always={tile(california): "403"})
    with pytest.raises(ReadError) as told:
        orograph.fetch((-118.9, 37.1, -118.8, 37.2), "copernicus-90")
    assert "secret" not in str(told.value)


def test_a_second_run_needs_no_network(california, truth):
    orograph.fetch(BOX, "copernicus-90")
    california.set()
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)
    assert california.total == 0
    inside = orograph.fetch((-119.2, 36.9, -118.7, 37.2), "copernicus-90")
    np.testing.assert_array_equal(inside.heights, truth[60:421, 120:721])
    assert california.total == 0


def aged(seconds):
    """All that is kept was asked for so many seconds earlier."""
    for file in cached.tiles_folder().rglob("tile.json"):
        told = json.loads(file.read_text())
        file.write_text(json.dumps({**told, "asked": told["asked"] - seconds}))


def test_after_a_week_it_is_asked_whether_a_tile_is_what_it_was(california, truth):
    orograph.fetch(BOX, "copernicus-90")
    aged(6.9 * 86400)
    california.set()
    orograph.fetch(BOX, "copernicus-90")
    assert california.total == 0
    aged(86400)
    orograph.fetch(BOX, "copernicus-90")
    assert len(california.conditional) == 4  # one request of each tile
    assert california.total == 4
    california.set()
    orograph.fetch(BOX, "copernicus-90")
    assert california.total == 0


def test_a_tile_that_was_replaced_is_read_anew(california, cut_tiles, truth):
    orograph.fetch(BOX, "copernicus-90")
    aged(8 * 86400)
    path, data = copernicus("N37W119", cut_tiles["N37W119"] + 7)
    california.files[f"copernicus-90/{path}"] = data
    dem = orograph.fetch(BOX, "copernicus-90")
    np.testing.assert_array_equal(dem.heights[:300, 360:], truth[:300, 360:] + 7)
    np.testing.assert_array_equal(dem.heights[301:], truth[301:])


def test_what_is_kept_for_long_serves_without_a_network(california, truth):
    orograph.fetch(BOX, "copernicus-90")
    aged(30 * 86400)
    california.set(always=dict.fromkeys(california.files, "503"))
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)


def test_only_what_is_needed_is_read_by_few_at_once_and_by_name(california):
    size = sum(map(len, california.files.values()))
    orograph.fetch((-118.95, 37.9, -118.9, 37.95), "copernicus-90")
    assert 0 < california.sent < size / 6
    assert {agent.split("/")[0] for agent in california.agents} == {"orograph"}
    assert california.at_once <= 4


@pytest.mark.stress
def test_a_run_that_is_killed_is_continued(california, truth, tmp_path):
    """The second run asks for what the first had not read, and the result is the same."""
    script = (
        "import sys, orograph\nfrom orograph.fetching import register\n"
        f"register('copernicus-90', base={california.url + '/copernicus-90'!r})\n"
        f"orograph.fetch({BOX}, 'copernicus-90', connections=1)"
    )
    california.set(always=dict.fromkeys(california.files, "slow"), only_reads=True)
    process = subprocess.Popen([sys.executable, "-c", script], env=dict(os.environ))
    end = time.monotonic() + 60
    while len(kept_files()) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    begun = {file: file.stat().st_mtime_ns for file in kept_files()}
    assert begun
    california.set()
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)
    assert len(kept_files()) > len(begun)
    assert {file: file.stat().st_mtime_ns for file in begun} == begun
    assert not [f for f in cached.tiles_folder().rglob("*.part*") if str(os.getpid()) in f.name]


def test_the_cache_keeps_within_its_size_and_what_was_used_last_stays(california, monkeypatch):
    orograph.fetch((-119.5, 37.2, -119.4, 37.3), "copernicus-90")
    first = entries()[0].path
    orograph.fetch((-118.6, 36.2, -118.5, 36.3), "copernicus-90")
    os.utime(first, (1, 1))
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", str(sum(entry.size for entry in entries()) - 1))
    orograph.fetch((-118.6, 36.2, -118.5, 36.3), "copernicus-90")
    assert [entry.path.name for entry in entries()] == ["N36W119"]
    assert not list(Path(first.parent).glob(".*"))


def test_nothing_is_removed_while_a_fetch_needs_it(california, monkeypatch):
    orograph.fetch((-119.5, 37.2, -119.4, 37.3), "copernicus-90")
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", "1")
    with cached.in_use():
        make_room()
        assert entries()
    make_room()
    assert not entries()


def test_accounts_come_from_netrc_and_from_gdals_settings(web, monkeypatch, shared_data, tmp_path):
    web.files["aster/ASTGTMV003_N37W119_dem.tif"] = b"x"
    web.set(always={"aster/ASTGTMV003_N37W119_dem.tif": "401"})
    with pytest.raises(ReadError, match="needs an account: NASA Earthdata") as told:
        orograph.fetch((-118.9, 37.1, -118.8, 37.2), "aster")
    assert "netrc" in told.value.remedy
    assert "urs.earthdata.nasa.gov" in told.value.remedy
    monkeypatch.setenv("GDAL_HTTP_BEARER", "token")
    with pytest.raises(ReadError):
        orograph.fetch((-118.9, 37.1, -118.8, 37.2), "aster")
    assert "Bearer token" in web.authorizations


def test_a_server_may_say_how_long_to_wait():
    assert asking._wait({"Retry-After": "7"}) == 7
    assert asking._wait({"Retry-After": "Wed, 21 Oct 2015 07:28:00 GMT"}) == 0
    assert asking._wait({}) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
def test_what_is_kept_is_whole_wherever_the_disk_ends(tmp_path):
    """GDAL does not say that a file's last blocks found no room."""
    import resource

    kept = object.__new__(cached.KeptTile)
    kept.path = tmp_path / "tile"
    header = cached.Header((300, 400), 0, 0, (256, 256), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0), "", "float32", None)
    heights = np.random.default_rng(3).random((300, 400), np.float32)
    kept.put_part(header, 0, 0, heights)
    file = kept.part(0, 0)
    size = file.stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in (400, size // 2, size - 9000, size - 300, size - 1, size):
        file.unlink(missing_ok=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            kept.put_part(header, 0, 0, heights)
        except OutputError as error:
            assert "What was read cannot be cached" in str(error)
            assert "OROGRAPH_CACHE" in str(error)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert [p.name for p in kept.path.iterdir()] == [file.name] * (room >= size)
    np.testing.assert_array_equal(read(file).heights, heights)


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
def test_what_is_fetched_is_whole_wherever_the_disk_ends(california, tmp_path):
    import resource

    out = tmp_path / "a.tif"
    small = (-118.9, 37.1, -118.7, 37.2)
    orograph.fetch(small, "copernicus-90", output=out)
    size, expected = out.stat().st_size, read(out).heights
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in (size // 3, size - 5000, size - 200, size - 1):
        out.unlink(missing_ok=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            with pytest.raises(OutputError, match="cannot be written"):
                orograph.fetch(small, "copernicus-90", output=out)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert [p.name for p in tmp_path.iterdir() if "a.tif" in p.name] == []
    orograph.fetch(small, "copernicus-90", output=out)
    np.testing.assert_array_equal(read(out).heights, expected)


@pytest.mark.stress
def test_fetches_at_the_same_time_do_not_disturb_each_other(california, truth, tmp_path):
    """All read what the server has, and keep the same parts in the same place."""
    script = (
        "import sys, orograph\nfrom orograph.fetching import register\n"
        f"register('copernicus-90', base={california.url + '/copernicus-90'!r})\n"
        f"orograph.fetch({BOX}, 'copernicus-90', output=sys.argv[1])"
    )
    outs = [tmp_path / f"{number}.tif" for number in range(4)]
    all_of_them = [
        subprocess.Popen([sys.executable, "-c", script, out], env=dict(os.environ), stderr=subprocess.PIPE, text=True)
        for out in outs
    ]
    for process, out in zip(all_of_them, outs):
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        np.testing.assert_array_equal(read(out).heights, truth)


def test_a_part_that_another_process_puts_there_anew_is_read(california, truth, monkeypatch):
    """Its file is another while it is being read."""
    from orograph.fetching import raster

    real, times = raster.Source.read, []

    def disturbed(source, *window, **how):
        if not times and "tiles" in source.path:
            times.append(1)
            data = Path(source.path).read_bytes()
            Path(source.path).unlink()
            Path(source.path).write_bytes(data)
        return real(source, *window, **how)

    monkeypatch.setattr(raster.Source, "read", disturbed)
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)
    assert times


def test_a_kept_part_that_is_damaged_is_told_and_read_again(california, truth):
    orograph.fetch(BOX, "copernicus-90")
    file = kept_files()[0]
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(ReadError, match="run it again") as told:
        orograph.fetch(BOX, "copernicus-90")
    assert told.value.path == str(file)
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)


@pytest.mark.stress
def test_ctrl_c_ends_at_once_and_leaves_nothing_broken(california, truth, tmp_path):
    table, out = tmp_path / "table.toml", tmp_path / "area.tif"
    table.write_text(f'[copernicus-90]\nbase = "{california.url}/copernicus-90"\n')
    california.set(always=dict.fromkeys(california.files, "slow"), only_reads=True)
    line = [sys.executable, "-m", "orograph", "fetch", "--bbox", "-119.3,36.8,-118.6,37.25", "--product",
            "copernicus-90", "--table", str(table), "-o", str(out), "--connections", "1"]  # fmt: skip
    process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while not kept_files() and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert process.wait(20) == 130
    assert time.monotonic() - began < 3
    assert "interrupted" in process.stderr.read()
    assert not out.exists()
    assert not list(tmp_path.glob(".*"))
    assert not list(cached.tiles_folder().rglob(".*.part*"))
    california.set()
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)


def test_a_login_of_netrc_is_used_for_all_that_is_read(california, truth, tmp_path):
    california.set(always=dict.fromkeys(california.files, "login"))
    with pytest.raises(ReadError, match="401"):
        orograph.fetch(BOX, "copernicus-90")
    netrc = tmp_path / "netrc"
    netrc.write_text("machine 127.0.0.1 login someone password secret\n")
    netrc.chmod(0o600)
    np.testing.assert_array_equal(orograph.fetch(BOX, "copernicus-90").heights, truth)
    assert "Basic c29tZW9uZTpzZWNyZXQ=" in california.authorizations


def test_a_product_that_has_nothing_there_is_an_error_and_no_hole(web):
    with pytest.raises(ReadError, match=r"3DEP 1 arc-second has no heights at 7.5°E to 7.6°E"):
        orograph.fetch((7.5, 46.5, 7.6, 46.6), "3dep-30")
