"""``--data``, ``--uncertainty`` and ``--priority`` on the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.cli import scenes
from orograph.geovis.data.dataset import Uncertainty

PLACE = Affine(30, 0, 500_000, 0, -30, 4_000_000)
SMALL = ("--size", "160x90", "--quiet")


def write(path, bands, name="float32"):
    bands = np.asarray(bands, name)
    with rasterio.open(
        path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], count=len(bands), dtype=name,
        crs="EPSG:32611", transform=PLACE,
    ) as file:  # fmt: skip
        file.write(bands)
    return path


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(0)
    write(tmp_path / "dem.tif", [500 + 100 * np.sin(np.arange(6400).reshape(80, 80) / 900)])
    write(tmp_path / "rain.tif", rng.uniform(0, 1, (5, 80, 80)))
    write(tmp_path / "sigma.tif", [np.full((80, 80), 0.3)])
    return tmp_path


@pytest.mark.stress
def test_an_uncertainty_belongs_to_the_data_before_it(run, files, monkeypatch):
    seen = {}
    own = scenes.scene_of
    monkeypatch.setattr("orograph.cli.render.scene_of", lambda *a: seen.update(a[2]) or own(*a))
    rain, sigma = str(files / "rain.tif"), str(files / "sigma.tif")
    code, _, words = run(
        "render", str(files / "dem.tif"), "-o", str(files / "o.png"), *SMALL, "--uncertainty", "spread", "--data", rain,
    )  # fmt: skip
    assert code == 2
    assert "before it" in words
    code, _, words = run(
        "render", str(files / "dem.tif"), "-o", str(files / "o.png"), *SMALL, "--data", f"{rain},band=all",
        "--uncertainty", "ci90,style=whiteness", "--data", f"{rain},band=2,opacity=0.5", "--priority", "T+D-U-",
        "--data", f"{rain},band=3,style=isolines", "--uncertainty", f"{sigma},range=0:1",
    )  # fmt: skip
    assert code == 0, words
    first, second, third = seen["data"]
    assert first.uncertainty == Uncertainty("ci90", style="whiteness")
    assert second.uncertainty is None and second.opacity == 0.5
    assert third.uncertainty == Uncertainty(sigma, range=(0.0, 1.0))
    assert (files / "o.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--data", "nix.tif"), "no such file"),
        (("--data", "rain.tif,stile=cells"), "style"),
        (("--data", "rain.tif,band=9"), "1 to 5"),
        (("--data", "rain.tif", "--uncertainty", "spread", "--uncertainty", "ci90"), "Each --data may have one"),
        (("--data", "rain.tif,band=1", "--uncertainty", "spread"), "members"),
        (("--priority", "T+X-"), r"T+D-U-"),
    ],
)
def test_what_cannot_be_meant_is_said(run, files, monkeypatch, more, words):
    monkeypatch.chdir(files)
    code, _, said = run("render", "dem.tif", "-o", "o.png", *SMALL, *more)
    assert code in (2, 3), said
    assert words in said
    assert not (files / "o.png").exists()


def test_films_have_data(run, files):
    pytest.importorskip("av")
    films = []
    for name, more in (("a", ("--data", f"{files / 'rain.tif'},style=continuous")), ("b", ())):
        out = files / f"{name}.gif"
        code, _, words = run(
            "movie", files / "dem.tif", "-o", out, "--orbit", "--seconds", "1", "--fps", "2", *SMALL, *more
        )  # fmt: skip
        assert code == 0, words
        films.append(out.read_bytes())
    assert films[0] != films[1]


def test_films_say_what_they_play(run, files):
    code, out, words = run(
        "movie", files / "dem.tif", "-o", files / "f" / "%02d.png", "--still", "--seconds", "2", "--fps", "2",
        "--data", f"{files / 'rain.tif'},band=all", "--uncertainty", "spread,style=members,rate=1", "--json",
        "--size", "160x90",
    )  # fmt: skip
    assert code == 0, words
    assert json.loads(out)["played"] == [{"members": 5, "changes_per_second": 1.0, "name": "rain"}]
    assert len(list((files / "f").glob("*.png"))) == 4
    assert "rain: 5 members in turn, 1 a second" in words
    assert "Not every member of rain is seen: that takes 5 s" in words
