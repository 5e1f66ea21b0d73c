"""Stands in for Agisoft's module: the calls of the documented interface that our script makes, recorded; nothing is computed."""

import json
import sys
import types
from pathlib import Path
from xml.etree import ElementTree

CALLS = []


class Chunk:
    """Takes pictures in another order than they are handed over, as a program may."""

    def __init__(self):
        self.cameras = []

    def importDepthImages(self, format=None, filenames=None, color_filenames=None, image_path="", multiplane=False):
        CALLS.append(["importDepthImages", {"filenames": filenames, "color_filenames": color_filenames, "image_path": image_path}])
        assert len(filenames) == len(color_filenames) and "{filename}" in image_path
        for picture in reversed(color_filenames):
            path = image_path.replace("{filename}", Path(picture).stem)
            self.cameras.append(types.SimpleNamespace(photo=types.SimpleNamespace(path=path), label="", transform=None, sensor=None))

    def importCameras(self, path="", format=None):
        CALLS.append(["importCameras", {"path": path, "format": format}])
        root = ElementTree.parse(path).getroot()
        sensors = {s.get("id"): float(s.find("calibration/f").text) for s in root.iter("sensor")}
        known = {c.get("label"): c for c in root.iter("camera")}
        for camera in self.cameras:
            found = known.get(camera.label)
            if found is not None:
                camera.transform = [float(word) for word in found.find("transform").text.split()]
                calibration = types.SimpleNamespace(f=sensors[found.get("sensor_id")])
                camera.sensor = types.SimpleNamespace(calibration=calibration)

    def buildModel(self, surface_type, interpolation, face_count, source_data, vertex_colors):
        CALLS.append(["buildModel", {"source_data": source_data}])

    def exportModel(self, path="", binary=True, save_texture=True, save_uv=True, save_normals=True, save_colors=True, format=None):
        CALLS.append(["exportModel", {"path": path, "format": format}])


class Document:
    def __init__(self):
        self.chunk = None

    def addChunk(self):
        self.chunk = Chunk()
        return self.chunk

    def save(self, path=None):
        CALLS.append(["save", {"path": path}])


def install():
    module = types.ModuleType("Metashape")
    module.Document = Document
    for name in ["Arbitrary", "EnabledInterpolation", "HighFaceCount", "DepthMapsData", "CamerasFormatXML", "ModelFormatPLY"]:
        setattr(module, name, name)
    sys.modules["Metashape"] = module


if __name__ == "__main__":
    import runpy

    install()
    sys.argv = sys.argv[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")
    print(json.dumps(CALLS))
