"""What people write: each public function in its usual ways."""

import datetime as dt
from pathlib import Path

import numpy as np
import xarray as xr
from affine import Affine

import orograph
from orograph import Dem, Grid, Picture, Terrain, View

print(orograph.__version__)
dem: Dem = orograph.read("dem.tif", band=1, nodata="none", assume_crs="EPSG:4326", max_bytes="1GiB")
print(dem.heights.mean(), dem.grid.crs, dem.grid.shape, dem.vertical, dem.name)
grid = Grid((40, 50), Affine(30, 0, 500_000, 0, -30, 4_000_000), dem.grid.crs)
made = Dem(np.zeros((40, 50), np.float32), grid, name="flat")
terrain: Terrain = orograph.terrain(made)
for source in (
    "dem.tif",
    Path("dem.tif"),
    ["a.tif", Path("b.tif")],
    made,
    terrain,
    np.zeros((4, 5)),
    xr.DataArray([[1.0]]),
):
    orograph.terrain(source, progress=False, max_memory="512MiB", jobs=2, bbox=(7, 45, 8, 46), crs="EPSG:32632")
low, high = terrain.height_range
window = terrain.read(0, 0, 10, 0, 10)
print(window[0, 0], terrain.levels, terrain.valid_fraction, low, high, terrain.attribution)

store = orograph.build(
    ["a.tif", "b.tif"], "area.oro", errors=("exact",), overwrite=True, max_error="auto", codec="compact"
)
print(store.url, store.errors)
with orograph.open("area.oro") as opened:
    print(opened.grid.bounds())
orograph.build("points.laz", "p.oro", resolution=1.0, max_edge=50.0)
baked = orograph.bake(store.url, "sky-view-factor", azimuths=16)
print(baked)
damaged = orograph.check("area.oro")
print(len(damaged))
orograph.publish("area.oro", "s3://bucket/area.oro")
path: Path = orograph.export(terrain, "out.tif", bbox="7,45,8,46", overwrite=True)
print(path.stem)
listed = orograph.manifest("tiles", "tiles.manifest.geojsonl", skip_damaged=True)
print(listed.files, listed.damaged)
fetched = orograph.fetch((7.5, 45.9, 7.8, 46.1), product="copernicus-30", output="area.tif")
print(fetched.grid)
area_dem: Dem = orograph.fetch(at=(7.65, 45.98), radius=5_000)
print(area_dem.heights.max())
facts = orograph.info("dem.tif", exact=True)
print(facts["kind"], facts["shape"])

view: View = orograph.camera.around(terrain, (1280, 720), azimuth=225, pitch=30, distance=None)
whole = orograph.camera.whole(terrain)
plan = orograph.camera.plan(terrain, "800x600")
standing = orograph.camera.standing(terrain, (1280, 720), (7.6, 45.9, 2000.0), (7.7, 46.0))
custom = View((500_000.0, 4_000_000.0, 9000.0), (501_000.0, 4_000_000.0, 100.0), fov_y=30.0)
picture: Picture = orograph.render(
    terrain,
    view,
    size="1280x720",
    sun=(315, 45),
    exaggeration=1.5,
    sky=True,
    furniture=True,
    contours="auto",
    range=(0, 800),
    layers=[orograph.Layer("photo.tif")],
    data=[orograph.Dataset("t.tif", uncertainty="spread")],
    method="soar",
    tolerance=1.0,
    progress=False,
)
for one in (whole, plan, standing, custom, None, "plan", "VIEW.json"):
    orograph.render("dem.tif", one)
print(picture.pixels.shape, picture.depth.max(), picture.attribution, picture.view.eye)
saved: Path = picture.save("p.png", dpi=300)
picture.save_depth("d.tif")
pixels = np.asarray(picture)
table = picture.to_xarray()
print(pixels.dtype, table.dims, saved)
axes = picture.plot()
axes.set_title("map")
picture.show()
bar = picture.colorbar
print(bar)

orograph.render(
    terrain, sun=orograph.Sun(315.0, 45.0), contours=orograph.Contours(50.0), silhouettes=orograph.Silhouettes()
)
orograph.render(terrain, focus=orograph.Focus("area.geojson"), aids=orograph.Aids(), ghosts=[orograph.Ghost("old.tif")])
base = orograph.basemap("OpenTopoMap")
orograph.render(terrain, layers=base)

slope = orograph.light(terrain, "slope")
slope.save("slope.tif")
shade = orograph.light(np.zeros((5, 5)), "hillshade", cell=30.0)
orograph.light("dem.tif", "shadow", sun=dt.datetime(2026, 6, 21, 12, tzinfo=dt.UTC))
print(shade.max())

profile = orograph.measure.profile(terrain, [(0.0, 0.0), (1.0, 1.0)])
print(profile.length, profile.rows(every=100))
area = orograph.measure.area(terrain, [(0, 0), (1, 0), (1, 1)], level=100)
print(area.surface, area.to_dict())
shed = orograph.measure.viewshed(terrain, (500_100, 3_999_000), radius=2000)
print(shed.values().sum(), shed.summary())
sight = orograph.measure.line_of_sight(terrain, (0, 0), (1, 1))
print(sight)
hit = orograph.measure.pick(terrain, view, (640, 360))
if hit is not None:
    print(hit.point)
print(orograph.measure.heights(terrain, [(0.0, 0.0)]))
flood = orograph.measure.flood(terrain, 100.0, [(0, 0)])
print(flood)
likely = orograph.measure.probable_viewshed(terrain, (0, 0), orograph.measure.HeightError(sigma=2.0, range=100.0))
print(likely.values)

lines = orograph.contours(terrain, 20, output="c.gpkg")
print(lines)
change = orograph.difference("after.tif", "before.tif", "d.tif", onto="finer")
print(change.statistics.nmad, change.values.max(), change.to_xarray().dims, change.name)
change.render(limit=5).save("d.png")

mesh = orograph.tessellate(terrain, view, method="soar", tolerance=2, check=True)
print(mesh.stats["report"], mesh.triangles.shape, mesh.vertices.shape)
mesh.save("m.npz")
tin = orograph.tin(terrain, max_error=10, output="t.stl", model_size=180)
print(len(tin.triangles))
found = orograph.compare(terrain, [view], methods=["soar", "roam"])
print(found)
views = orograph.best_view(terrain, [(0.0, 0.0)], k=2)
print(views[0].view, len(views))
views.save("views.json")
tour = orograph.tour(terrain, seconds=2, size=(160, 100))
tour.save("tour.json")
film = orograph.movie(terrain, "m.mp4", tour, fps=25)
print(film)
hills = orograph.synth(size=257, seed=7)
print(hills.heights.max())
print(orograph.synth("hills.tif", size=(513, 257)).stem)
print(orograph.synth(exemplar="lidar.tif", jitter=[0.5, 0.2]).grid)
print(orograph.methods())
print(orograph.doctor()["orograph"])
widget = orograph.view(terrain)
print(widget)

try:
    orograph.read("absent.tif")
except orograph.errors.OrographError as error:
    print(error.what, error.remedy)

# What is misspelt, or of the wrong kind, is found before it runs (an ignored line with nothing wrong is an error).
orograph.render(terrain, exageration=1.5)  # type: ignore[call-overload]  # pyright: ignore[reportCallIssue]
orograph.render(terrain, bbox="7,45,8,46", light="rays")  # type: ignore[call-overload]  # pyright: ignore[reportArgumentType]
