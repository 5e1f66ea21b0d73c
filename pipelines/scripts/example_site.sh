#!/bin/sh
# The files of a made-up site in a folder: `sh scripts/example_site.sh data`, beside example-site.yaml.
# What outcrop.yaml and calibrate-site.yaml read stands in the folder, what trier-cliff.yaml reads in its folder `trier`.
set -e
to=${1:?name the folder to write}
pipeline=$(dirname "$0")/../example-site.yaml
mkdir -p "$to/real" "$to/trier"
rockface run "$pipeline" --quiet

take() { # output, file
  rm -f "$2"
  rockface export "$pipeline" "$1" "$2" --plain > /dev/null
}
take face.mesh "$to/face.ply"
# The images of the pipelines are called cam1 and cam2.
take rig.cameras "$to/left_right.json"
sed -e 's/"left"/"cam1"/g' -e 's/"right"/"cam2"/g' "$to/left_right.json" > "$to/cameras.json"
take errors.covariance "$to/left_right.json"
sed -e 's/"left\./"cam1./' -e 's/"right\./"cam2./' "$to/left_right.json" > "$to/bba_covariance.json"
rm "$to/left_right.json"
number=0
while rockface export "$pipeline" "quiet[reference=$number].raster" "$to/real/$(printf %02d $number).tif" --plain > /dev/null 2>&1; do
  number=$((number + 1))
done
take cliff.mesh "$to/trier/cliff_trier_wall_pre.ply"
folder=$(dirname "$pipeline")/.rockface/runs/latest/outputs
cp "$folder/cliff_fallen/blocks/1.ply" "$to/trier/cliff_trier_block.ply"
cp "$folder/cliff_seeds/blocks/1.ply" "$to/trier/block_sp1.ply"
cp "$folder/cliff_seeds/blocks/2.ply" "$to/trier/block_doublerock.ply"
chmod -R u+w "$to"
echo "$to: face.ply, cameras.json, bba_covariance.json, $number rasters in real/, and trier/"
