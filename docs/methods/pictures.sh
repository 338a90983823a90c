#!/bin/sh
# Make the pictures of one view on these pages: sh docs/methods/pictures.sh, in the checkout's folder.
set -e
orograph demo --output orograph-demo
compare() {
    picture=orograph-demo/$1.png
    shift
    orograph compare orograph-demo/jacksboro.tif --views docs/methods/views.json --tolerance 3 "$@" --picture "$picture"
    python -c '
import sys, pathlib, PIL.Image as image
path = pathlib.Path(sys.argv[1])
image.open(path).convert("RGB").save(f"docs/images/methods/{path.stem}.jpg", quality=80)' "$picture"
}
compare compare --methods soar,restricted-quadtree,smart,bdam,quadtin
compare triangle-patches --methods soar,triangle-patches
for method in top-down roam threshold-spheres stateless soar restricted-quadtree smart chunked-lod; do
    compare "$method" --method "$method"
done
