"""Fuses the depth maps of a COLMAP workspace with pycolmap: fuse.py OPTIONS, a JSON file."""

import json
import sys

import pycolmap

with open(sys.argv[1], encoding="utf-8") as file:
    asked = json.load(file)


def told(options, values):
    """Options with these values; one that this pycolmap does not have is a fault, not a default."""
    for name, value in values.items():
        if not hasattr(options, name):
            sys.exit(f"pycolmap {pycolmap.__version__} has no option `{name}` of {type(options).__name__}")
        setattr(options, name, value)
    return options


pycolmap.stereo_fusion(
    output_path="out/fused.ply",
    workspace_path="work",
    workspace_format="COLMAP",
    input_type="geometric",
    options=told(pycolmap.StereoFusionOptions(), asked["fusion"]),
    output_type="ply",
)
if asked["poisson"] is not None:
    pycolmap.poisson_meshing(
        input_path="out/fused.ply",
        output_path="out/meshed.ply",
        options=told(pycolmap.PoissonMeshingOptions(), asked["poisson"]),
    )
