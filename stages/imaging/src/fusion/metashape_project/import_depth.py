"""Builds a mesh in Agisoft Metashape Professional from the depth maps in this folder.

Run it with Metashape's own Python (metashape.sh -r import_depth.py MESH.ply), or with a Python that has Agisoft's module.
MESH.ply is the mesh to write, fused.ply in this folder if it is left out. Coordinates stay what they are here.
"""

import json
import sys
from pathlib import Path

import Metashape

HERE = Path(__file__).resolve().parent
LARGEST_SHIFT_PX = 1e-3


def imported(chunk, images):
    """Adds the depth maps with their pictures, and calls the cameras what cameras.xml calls them."""
    work = HERE / "metashape"
    work.mkdir(exist_ok=True)
    chunk.importDepthImages(
        filenames=[str(HERE / image["depth"]) for image in images],
        color_filenames=[str(HERE / image["picture"]) for image in images],
        image_path=str(work / "imported") + "/{filename}.tif",
    )
    if len(chunk.cameras) != len(images):
        sys.exit(f"{len(images)} depth maps were handed over, but Metashape has {len(chunk.cameras)} cameras")
    labels = {image["label"] for image in images}
    for camera in chunk.cameras:
        stem = Path(camera.photo.path).stem
        if stem not in labels:
            sys.exit(f"Metashape took in a picture `{stem}` that is none of {sorted(labels)}")
        camera.label = stem


def oriented(chunk, images):
    """Gives the cameras their orientation and calibration, and checks that they have them."""
    chunk.importCameras(path=str(HERE / "cameras.xml"), format=Metashape.CamerasFormatXML)
    focal_px = {image["label"]: image["focal_px"] for image in images}
    for camera in chunk.cameras:
        if camera.transform is None:
            sys.exit(f"camera `{camera.label}` has no orientation: cameras.xml was not taken for it")
        found = camera.sensor.calibration.f
        if abs(found - focal_px[camera.label]) > LARGEST_SHIFT_PX:
            sys.exit(f"camera `{camera.label}` has f = {found} px, cameras.xml says {focal_px[camera.label]} px")


def main(mesh):
    images = json.loads((HERE / "images.json").read_text(encoding="utf-8"))["images"]
    document = Metashape.Document()
    document.save(path=str(HERE / "metashape" / "fused.psx"))
    chunk = document.addChunk()
    imported(chunk, images)
    oriented(chunk, images)
    chunk.buildModel(
        surface_type=Metashape.Arbitrary,
        interpolation=Metashape.EnabledInterpolation,
        face_count=Metashape.HighFaceCount,
        source_data=Metashape.DepthMapsData,
        vertex_colors=False,
    )
    document.save()
    chunk.exportModel(
        path=str(mesh),
        binary=True,
        save_texture=False,
        save_uv=False,
        save_normals=False,
        save_colors=False,
        format=Metashape.ModelFormatPLY,
    )
    print(f"wrote {mesh}; README.txt says how to take it back")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else HERE / "fused.ply").resolve())
