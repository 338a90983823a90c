"""Results appear whole; what killed runs leave beside them is removed by the next run that writes there."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from orograph.errors import OutputError
from orograph.folders import temporary
from orograph.output import Beside, _left
from orograph.processes import host


@pytest.fixture(autouse=True)
def anew():
    """As in a new process: nothing is known of the folders."""
    _left.cache_clear()


@pytest.fixture(scope="module")
def ended():
    """The number of a process that is gone."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_leftovers_of_ended_processes_go(tmp_path, ended):
    gone = [f".sky.tif.{host()}.{ended}.part.tif", f".sky.tif.{host()}.{ended}.raw", f".sky.tif.{ended}.part.tif",
            f".sky.tif.{host()}.{ended}.raw.hdr"]  # fmt: skip
    stay = [f".sky.tif.{host()}.{os.getpid()}.part.tif", f".other.tif.{host()}.{ended}.part", ".sky.tif.part",
            f".sky.tif.elsewhere.{ended}.part", f".sky.tif.{host()}.{ended}.txt", "sky.tif.1.part"]  # fmt: skip
    for name in (*gone, *stay):
        (tmp_path / name).write_text("x")
    with Beside(tmp_path / "sky.tif") as part:
        part.write_text("whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*stay, "sky.tif"])


@pytest.mark.skipif(sys.platform == "win32", reason="there a process cannot be asked whether it runs")
@pytest.mark.parametrize("how", ["light", "picture", "synth"])
def test_a_killed_run_leaves_nothing_for_long(tmp_path, how):
    """Killed in the midst of writing; then the same is written again."""
    code = {
        "light": "with Beside(out) as part: part.with_name(part.name + '.tif').write_text('x'); end()",
        "picture": "from orograph.rendering.assembly import Assembly\nwith Assembly(out, 4, 4): end()",
        "synth": "import rasterio; rasterio.open = lambda path, *a, **k: (open(path, 'w'), end())\n"
        "from orograph.dem.synth import Synth\nSynth((17, 17)).write(out)",
    }[how]
    head = f"""
import os, signal
from pathlib import Path
from orograph.output import Beside
out = Path({str(tmp_path / "sky.tif")!r})
end = lambda: os.kill(os.getpid(), signal.SIGKILL)
"""
    ran = subprocess.run([sys.executable, "-c", head + code], capture_output=True, text=True)
    assert ran.returncode == -signal.SIGKILL, ran.stderr
    assert any(f".{host()}." in p.name for p in tmp_path.iterdir())
    with Beside(tmp_path / "sky.tif") as part:
        np.zeros(3).tofile(part)
    assert [p.name for p in tmp_path.iterdir()] == ["sky.tif"]


def test_leftovers_go_wherever_the_process_is(tmp_path, monkeypatch, ended):
    """A name without a folder means another place after a change of folder."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f".sky.tif.{host()}.{ended}.part").write_text("x")
        monkeypatch.chdir(tmp_path / name)
        with Beside(Path("sky.tif")) as part:
            part.write_text("whole")
        assert [p.name for p in (tmp_path / name).iterdir()] == ["sky.tif"]


def test_temporary_folders_of_killed_processes_go(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code = "import os, signal; from orograph.folders import temporary; kept = temporary(); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "TMPDIR": str(tmp_path)}, check=False)
    assert len(list(tmp_path.iterdir())) == 1
    stays = tmp_path / f"orograph-elsewhere-{os.getpid()}-x"
    stays.mkdir()
    with temporary() as folder:
        assert sorted(tmp_path.iterdir()) == sorted([stays, Path(folder)])
    assert list(tmp_path.iterdir()) == [stays]


def test_what_is_alike_stays_if_asked_for(tmp_path):
    """Another process may have it open, and would find that it was changed."""
    out = tmp_path / "a.txt"
    for text, stays in (("one", False), ("one", True), ("two", False)):
        before = out.stat().st_ino if out.exists() else 0
        with Beside(out, keep=True) as part:
            part.write_text(text)
        assert (out.stat().st_ino == before) == stays
        assert out.read_text() == text
        assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_in_a_results_place_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (".", "..", str(tmp_path)):
        with pytest.raises(OutputError, match="It is a folder"), Beside(Path(name)):
            pass


def test_many_results_look_through_their_folder_once(tmp_path, monkeypatch):
    from pathlib import Path

    looks, iterdir = [], Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda self: looks.append(self) or iterdir(self))
    for number in range(20):
        with Beside(tmp_path / f"{number}.png") as part:
            part.write_text("x")
    assert len(looks) == 1


def test_a_file_system_that_is_read_only_is_told(tmp_path, monkeypatch):
    """Nothing can be written there, nor removed: the first is the error."""

    def refused(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "unlink", refused)
    told = pytest.raises(OutputError, match=r"The file cannot be written: Read-only file system")
    with told, Beside(tmp_path / "sky.tif"):
        refused()


@pytest.mark.parametrize("who", ["large", "synth", "storage", "owner"])
def test_what_cannot_be_removed_does_not_hide_what_went_wrong(tmp_path, monkeypatch, who):
    """A disk that became read-only while a result was written: the first error is the one that is told."""

    def refused(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    def work():
        if who == "large":
            from orograph.rendering.assembly import Assembly

            with Assembly(tmp_path / "a.png", 4, 4):
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        elif who == "synth":
            from orograph.dem.synth import Synth

            monkeypatch.setattr(Synth, "read", failing)
            Synth((17, 17)).write(tmp_path / "a.tif")
        elif who == "storage":
            from orograph.store.storage import FolderStorage

            monkeypatch.setattr(Path, "replace", failing)
            FolderStorage(tmp_path).put("a", [b"x"])
        else:
            from orograph.store.lock import _create

            monkeypatch.setattr(os, "link", failing)
            _create(tmp_path / "a", b"x")

    def failing(*_, **__):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(Exception, match=os.strerror(errno.EIO)):
        work()
