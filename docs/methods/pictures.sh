#!/bin/sh
# Make the pictures of one view on these pages: sh docs/methods/pictures.sh, in the checkout's folder.
set -e
orograph demo --output orograph-demo
compare() {
    picture=$1
    shift
    orograph compare orograph-demo/jacksboro.tif --views docs/methods/views.json --tolerance 3 "$@" \
        --picture "docs/images/methods/$picture.jpg"
}
compare compare --methods soar,restricted-quadtree,smart,bdam,quadtin
compare triangle-patches --methods soar,triangle-patches
for method in top-down roam threshold-spheres stateless soar restricted-quadtree smart chunked-lod; do
    compare "$method" --method "$method"
done
