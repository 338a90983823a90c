"""The command line as a whole: help, exit codes, the demo."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from PIL import Image

from orograph.cli import VERBS


def orograph(*args, **kwargs):
    line = [sys.executable, "-m", "orograph", *map(str, args)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120, **kwargs)


def test_help_lists_the_verbs_and_the_exit_codes():
    ran = orograph("--help")
    assert ran.returncode == 0 and ran.stderr == ""
    for verb, what in VERBS.items():
        assert verb in ran.stdout and what in ran.stdout
    for code in ("0 done", "2 wrong command line", "3 input", "4 output", "5 nothing", "130 interrupted"):
        assert code in " ".join(ran.stdout.split())


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_every_verb_has_help_that_fits(verb):
    ran = orograph(verb, "--help", env={**os.environ, "COLUMNS": "100"})
    assert ran.returncode == 0 and ran.stderr == ""
    assert ran.stdout.startswith("Usage:") and max(map(len, ran.stdout.splitlines())) <= 100
    assert "--help" in ran.stdout and "TODO" not in ran.stdout


def test_help_is_quick_because_it_loads_nothing():
    code = "import sys; from orograph.cli import main\ntry: main(['render', '--help'])\nexcept SystemExit: pass\n" \
           "print([m for m in ('numba', 'scipy', 'rasterio', 'numpy', 'zarr', 'pickle') " \
           "if m in sys.modules])"  # fmt: skip
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert ran.stdout.strip().endswith("[]"), ran.stdout[-200:]


def test_info_is_quick_because_it_loads_no_compiler(tmp_path):
    orograph("synth", "-o", tmp_path / "a.tif", "--size", "40x50")
    code = f"import sys; from orograph.cli import main\ntry: main(['info', {str(tmp_path / 'a.tif')!r}])\n" \
           "except SystemExit: pass\nprint([m for m in ('numba', 'scipy', 'zarr', 'rich', 'urllib.request', " \
           "'orograph.store.build') if m in sys.modules])"  # fmt: skip
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "samples" in ran.stdout and ran.stdout.strip().endswith("[]"), ran.stdout[-200:]


def test_version_and_wrong_verbs():
    ran = orograph("--version")
    assert ran.returncode == 0 and "orograph" in ran.stdout and "0." in ran.stdout
    ran = orograph("rendr")
    assert ran.returncode == 2 and "rendr" in ran.stderr and ran.stdout == "" and "Traceback" not in ran.stderr
    assert "Did you mean render" in ran.stderr
    ran = orograph("xyzzy")
    assert ran.returncode == 2 and "info" in ran.stderr and "Did you mean" not in ran.stderr
    assert orograph("render").returncode == 2
    assert orograph().returncode == 2


@pytest.mark.stress
def test_synth_replaces_nothing(tmp_path):
    out = tmp_path / "a.tif"
    assert orograph("synth", "-o", out, "--size", "40x50").returncode == 0
    first = out.read_bytes()
    ran = orograph("synth", "-o", out, "--size", "40x50", "--seed", 2)
    assert ran.returncode == 4 and "--overwrite" in ran.stderr and out.read_bytes() == first
    assert orograph("synth", "-o", out, "--size", "40x50", "--seed", 2, "--overwrite").returncode == 0
    assert out.read_bytes() != first
    ran = orograph("synth", "-o", tmp_path / "a.xyz", "--size", "40x50")
    assert ran.returncode == 2 and ".tif" in ran.stderr and not (tmp_path / "a.xyz").exists()


def test_what_is_there_is_kept_with_one_code(tmp_path):
    dem, store = tmp_path / "dem.tif", tmp_path / "a.oro"
    first = (("synth", "-o", dem, "--size", "40x50"), ("build", dem, "-o", store))
    for command in first:
        assert orograph(*command).returncode == 0
    for command in (*first, ("export", store, "-o", dem), ("synth", "-o", store, "--size", "40x50")):
        ran = orograph(*command)
        assert ran.returncode == 4 and "there already" in ran.stderr and "--overwrite" in ran.stderr, command


def test_the_demo(tmp_path):
    pytest.importorskip("matplotlib")
    ran = orograph("demo", "--output", tmp_path / "new" / "demo")
    assert ran.returncode == 0, ran.stderr
    picture = tmp_path / "new" / "demo" / "jacksboro.png"
    with Image.open(picture) as image:
        assert image.size == (1280, 720)
    assert str(picture) in ran.stdout and "Try next" in ran.stdout
    steps = [line for line in ran.stderr.splitlines() if line.rstrip().endswith(" s")]
    assert len(steps) >= 4 and any("metres" in line for line in steps)
    # What it proposes works.
    proposed = next(line.split() for line in ran.stdout.splitlines() if "orograph info" in line)
    assert orograph(*proposed[1:]).returncode == 0


def test_the_demo_where_it_cannot_write(tmp_path):
    (tmp_path / "file").write_text("")
    ran = orograph("demo", "-o", tmp_path / "file" / "demo")
    assert ran.returncode == 4 and "folder cannot be made" in ran.stderr and "Traceback" not in ran.stderr


def test_faults_of_orograph_say_so(monkeypatch, capsys):
    from orograph import cli

    def fail(*args, **kwargs):
        raise RuntimeError("something unforeseen.")

    def leave(code):
        raise SystemExit(code)

    monkeypatch.setattr(cli, "_leave", leave)
    monkeypatch.setattr(cli, "spare_imports", lambda s3: None)
    monkeypatch.setattr(cli.cli, "main", fail)
    for argv, shown in ((["info", "x"], False), (["info", "x", "--debug"], True)):
        with pytest.raises(SystemExit) as stop:
            cli.main(argv)
        err = capsys.readouterr().err
        assert stop.value.code == 1 and "something unforeseen." in err and ("Traceback" in err) == shown
        assert shown or "fault of Orograph itself" in err
